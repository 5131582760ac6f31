"""Poses of a result's objects in the world: seven numbers, position [m] and unit quaternion (w, x, y, z)."""

import json
from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation

from palmfield.errors import OutputError
from palmfield.hand.blend import blended, bone_shifts
from palmfield.outputs.motion import pieces
from palmfield.outputs.schema import has_records, instances
from palmfield.types import Float, Int

IDENTITY = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


def to_world(points: Float, pose: Float) -> Float:
    """Transform points [m], shape (n, 3), from the frame at `pose` (shape (7,)) to the world."""
    return _rotation(pose).apply(points) + pose[:3]


def to_local(points: Float, pose: Float) -> Float:
    """Transform world points [m], shape (n, 3), to the frame at `pose` (shape (7,))."""
    return _rotation(pose).inv().apply(points - pose[:3])


def axes(pose: Float) -> Float:
    """Rows x, y, z: the frame's unit axes in the world, shape (3, 3)."""
    return _rotation(pose).as_matrix().T


def nearest(times_s: Float, time_s: float) -> int:
    """Return the index of the time nearest to `time_s` [s]."""
    return int(np.abs(times_s - time_s).argmin())


def drive_frames(starts_s: Float, times_s: Float) -> Int:
    """Return indices of the drive frames that hold at times [s]: the last begun; the first before all."""
    return np.maximum(0, np.searchsorted(starts_s, times_s + 1e-9, "right") - 1).astype(np.int32)


def drive_frame(array: xr.Dataset, time_s: float) -> int:
    """Return the index along `frame_time` of the drive of an array that holds at a time [s]."""
    return int(drive_frames(array["frame_time"].values, np.array([time_s]))[0])


def check_time(option: str, time_s: float, first_s: float, last_s: float) -> None:
    """Raises OutputError for a time in an option outside the record, with its ends [s]."""
    if not first_s <= time_s <= last_s:
        raise OutputError(f"{option} has value {1e3 * time_s:g} ms; allowed: {1e3 * first_s:g} to {1e3 * last_s:g} ms")


def poses_at(group: xr.Dataset | None, times_s: Float) -> Float:
    """Poses of an array or a body at the MuJoCo steps nearest to times [s], shape (n,) -> (n, 7).

    group: one of `instances(result, "array")` or `instances(result, "body")`; the identity if it is None (not in the
    result) or has no steps
    """
    if group is None or not has_records(group, "pose"):
        return np.tile(IDENTITY, (len(times_s), 1))
    steps = group["step_time"].values
    return group["pose"].values[[nearest(steps, time_s) for time_s in times_s.tolist()]]


def pose_at(group: xr.Dataset | None, time_s: float) -> Float:
    """As `poses_at`, for one time, shape (7,)."""
    return poses_at(group, np.array([time_s]))[0]


def posed(mesh: xr.Dataset, body: xr.Dataset | None, time_s: float) -> Float:
    """Vertices of a skin or a surface [m], shape (n, 3), in the body frame at the step nearest to a time [s].

    mesh: one of `instances(result, "skin")` or `instances(result, "surface")`; body: of the same name. An articulated
    hand's vertices are blended linearly from its bones; those of any other body are as at rest.
    """
    rest: Float = mesh["rest_position"].values
    if body is None or not has_records(body, "bone_pose") or "bone_index" not in mesh:
        return rest
    poses = body["bone_pose"].isel(step_time=nearest(body["step_time"].values, time_s)).values
    rotations = _rotation(poses).as_matrix()
    shifts = bone_shifts(body["bone_rest"].values, poses[:, :3], rotations)
    weights = mesh["bone_weight"].values.astype(np.float64)
    shift, matrix = blended(mesh["bone_index"].values, weights, shifts, rotations)
    return np.einsum("nij,nj->ni", matrix, rest) + shift


def in_world(mesh: xr.Dataset, body: xr.Dataset | None, time_s: float) -> Float:
    """As `posed`, in the world."""
    return to_world(posed(mesh, body, time_s), pose_at(body, time_s))


class Loudest(NamedTuple):
    """Moment of the largest ARP on a skin. time_s: [s], 0 for a silent run; place: index along `time`; arp_Pa: [Pa]"""

    time_s: float
    place: int
    arp_Pa: float


def loudest(skin: xr.Dataset) -> Loudest:
    """Return the moment of the largest ARP on a skin; for an interrupted run, from its ARP over time."""
    times: Float = skin["time"].values if "time" in skin.coords else np.zeros(0)
    if has_records(skin, "loudest_arp"):
        time_s = float(skin["loudest_time"])
        index = nearest(times, time_s) if len(times) else 0
        return Loudest(time_s, index, float(skin["loudest_arp"].values.max()))
    best = Loudest(0.0, 0, 0.0)
    if has_records(skin, "arp"):
        for place, values in pieces(skin, "arp"):
            index = int(values.max(axis=1).argmax())
            if values[index].max() > best.arp_Pa:
                best = Loudest(float(times[place][index]), place.start + index, float(values[index].max()))
    return best


def bodies(result: xr.DataTree) -> dict[str, list[str]]:
    """Group skins by body, in the order of the scene.

    A body is named by the attribute `body` of its skins' groups /body; a skin without one has a body of its own.
    """
    skins: dict[str, list[str]] = {}
    groups = instances(result, "body")
    for name in instances(result, "skin"):
        group = groups.get(name)
        skins.setdefault(name if group is None else str(group.attrs.get("body", name)), []).append(name)
    return skins


def arrays_of(stimulus: xr.Dataset, arrays: list[str]) -> list[str]:
    """Return names of the arrays that a stimulus drives: those of its attribute `arrays`, else all."""
    given = stimulus.attrs.get("arrays")
    chosen = json.loads(given) if isinstance(given, str) else given
    return arrays if chosen is None else [name for name in chosen if name in arrays]


def foci_at(stimulus: xr.Dataset, index: int) -> Float:
    """Return focal points in the world [m], shape (m, 3), at an index along `time`; shape (0, 3) in silence."""
    if not has_records(stimulus, "foci") or not bool(stimulus["sounding"].isel(time=index)):
        return np.empty((0, 3))
    return stimulus["foci"].isel(time=index).values


def _rotation(pose: Float) -> Rotation:
    # SciPy before 1.14 has the scalar last only
    return Rotation.from_quat(np.roll(pose[..., 3:], -1, axis=-1))
