# Schema 1: for the old recorder, and deleted with it.
"""Poses in results: seven numbers, position [m] and unit quaternion (w, x, y, z)."""

from typing import Literal

import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation

from palmfield.hand.blend import blended, bone_shifts
from palmfield.types import Float

Mesh = Literal["surface", "skin"]
VERTICES = {"surface": "surface_vertices", "skin": "skin_position"}
IDENTITY = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


def to_world(points: Float, pose: Float) -> Float:
    """Points [m], shape (n, 3), of the frame at `pose` (shape (7,)), in the world."""
    return _rotation(pose).apply(points) + pose[:3]


def to_local(points: Float, pose: Float) -> Float:
    """World points [m], shape (n, 3), in the frame at `pose` (shape (7,))."""
    return _rotation(pose).inv().apply(points - pose[:3])


def axes(pose: Float) -> Float:
    """Rows x, y, z: the frame's unit axes in the world, shape (3, 3)."""
    return _rotation(pose).as_matrix().T


def body_pose_at(ds: xr.Dataset, time_s: float) -> Float:
    """Pose of the body at the MuJoCo step nearest to `time_s` [s]; the identity where the result has no steps."""
    if ds.sizes.get("step_time", 0) == 0 or "body_pose" not in ds:
        return IDENTITY
    return ds["body_pose"].values[int(np.abs(ds["step_time"].values - time_s).argmin())]


def posed(ds: xr.Dataset, mesh: Mesh, time_s: float) -> Float:
    """Vertices of the surface or the skin [m], shape (n, 3), in the body frame at the step nearest to a time [s].

    An articulated hand's are blended linearly from its bones; any other body's are as at rest.
    """
    rest: Float = ds[VERTICES[mesh]].values
    if not has_records(ds, "bone_pose") or f"{mesh}_bone" not in ds:
        return rest
    poses = ds["bone_pose"].values[int(np.abs(ds["step_time"].values - time_s).argmin())]
    turns = Rotation.from_quat(poses[:, 3:], scalar_first=True).as_matrix()
    shifts = bone_shifts(ds["bone_rest"].values, poses[:, :3], turns)
    shares = ds[f"{mesh}_share"].values.astype(np.float64)
    shift, turn = blended(ds[f"{mesh}_bone"].values, shares, shifts, turns)
    return np.einsum("nij,nj->ni", turn, rest) + shift


def has_records(ds: xr.Dataset, name: str) -> bool:
    """Whether the result holds at least one value of a variable (a run cut off early may lack it)."""
    return name in ds and ds[name].size > 0


def loudest(ds: xr.Dataset) -> tuple[int, float]:
    """Index along `time` and time [s] of the largest ARP on the skin; (0, 0.0) where the result has none."""
    if not has_records(ds, "arp"):
        return 0, 0.0
    index = int(ds["arp"].values.max(axis=1).argmax())
    return index, float(ds["time"].values[index])


def _rotation(pose: Float) -> Rotation:
    return Rotation.from_quat(np.roll(pose[3:], -1))
