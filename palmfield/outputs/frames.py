"""Read poses of objects of a result in the world: position [m] and unit quaternion (w, x, y, z), seven numbers."""

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
    """Return the unit axes of a frame in the world as rows x, y, z, shape (3, 3)."""
    return _rotation(pose).as_matrix().T


def nearest(times_s: Float, time_s: float) -> int:
    """Return the index of the time nearest to `time_s` [s]."""
    return int(np.abs(times_s - time_s).argmin())


def drive_frames(starts_s: Float, times_s: Float) -> Int:
    """Return the indices of the drive frames at times [s]: the last frame that has begun, or the first one."""
    return np.maximum(0, np.searchsorted(starts_s, times_s + 1e-9, "right") - 1).astype(np.int32)


def drive_frame(array: xr.Dataset, time_s: float) -> int:
    """Return the index along `frame_time` of the drive of an array at a time [s]."""
    return int(drive_frames(array["frame_time"].values, np.array([time_s]))[0])


def check_time(option: str, time_s: float, first_s: float, last_s: float) -> None:
    """Raise OutputError if the time of an option is not between first_s and last_s [s]."""
    if not first_s <= time_s <= last_s:
        raise OutputError(f"{option} has value {1e3 * time_s:g} ms; allowed: {1e3 * first_s:g} to {1e3 * last_s:g} ms")


def poses_at(group: xr.Dataset | None, times_s: Float) -> Float:
    """Return the poses of an array or a body at the MuJoCo steps nearest to times [s], shape (n,) -> (n, 7).

    group: one of `instances(result, "array")` or `instances(result, "body")`; None if the result does not contain it
    If the group is None or has no steps, the poses are the identity.
    """
    if group is None or not has_records(group, "pose"):
        return np.tile(IDENTITY, (len(times_s), 1))
    steps = group["step_time"].values
    return group["pose"].values[[nearest(steps, time_s) for time_s in times_s.tolist()]]


def pose_at(group: xr.Dataset | None, time_s: float) -> Float:
    """Return `poses_at` for one time, shape (7,)."""
    return poses_at(group, np.array([time_s]))[0]


def posed(mesh: xr.Dataset, body: xr.Dataset | None, time_s: float) -> Float:
    """Return vertices of a skin or a surface [m], shape (n, 3), in the body frame at the step nearest to a time [s].

    mesh: one of `instances(result, "skin")` or `instances(result, "surface")`; body: body of the same name. Vertices
    of an articulated hand are blended linearly from its bones; those of other bodies are as at rest.
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
    """Return the result of `posed` in the world frame."""
    return to_world(posed(mesh, body, time_s), pose_at(body, time_s))


class Loudest(NamedTuple):
    """Moment of the largest ARP on a skin.

    time_s: time [s], 0 for a silent run
    place: index along `time`
    arp_Pa: the largest ARP [Pa]
    """

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
    """Group the skins by body, in the order of the scene.

    The attribute `body` of group /body of a skin names the body. A skin without this attribute has a body of its own.
    """
    skins: dict[str, list[str]] = {}
    groups = instances(result, "body")
    for name in instances(result, "skin"):
        group = groups.get(name)
        skins.setdefault(name if group is None else str(group.attrs.get("body", name)), []).append(name)
    return skins


def arrays_of(stimulus: xr.Dataset, arrays: list[str]) -> list[str]:
    """Return the names of the arrays of a stimulus: those in its attribute `arrays`, or else all arrays."""
    stored = stimulus.attrs.get("arrays")
    chosen = json.loads(stored) if isinstance(stored, str) else stored
    return arrays if chosen is None else [name for name in chosen if name in arrays]


def foci_at(stimulus: xr.Dataset, index: int) -> Float:
    """Return focal points in the world [m], shape (m, 3), at an index along `time`; shape (0, 3) in silence."""
    if not has_records(stimulus, "foci") or not bool(stimulus["sounding"].isel(time=index)):
        return np.empty((0, 3))
    return stimulus["foci"].isel(time=index).values


def _rotation(pose: Float) -> Rotation:
    # SciPy before 1.14 requires the scalar last
    return Rotation.from_quat(np.roll(pose[..., 3:], -1, axis=-1))
