# Schema 1: for the old recorder, and deleted with it.
"""Names, dimensions, types and units of everything that a run writes."""

from typing import NamedTuple

import numpy as np
import xarray as xr

from palmfield.errors import OutputError


class Variable(NamedTuple):
    """What one variable of a result must look like."""

    dims: tuple[str, ...]
    dtype: str
    units: str
    long_name: str


SCHEMA: dict[str, Variable] = {
    "skin_position": Variable(("vertex", "xyz"), "float64", "m", "rest position of the skin patch in the body frame"),
    "skin_faces": Variable(("face", "corner"), "int32", "1", "triangles of the skin patch, counter-clockwise outside"),
    "skin_depth": Variable(("vertex",), "float64", "m", "thickness of the skin layer"),
    "skin_pressure": Variable(("vertex",), "float32", "Pa", "peak pressure amplitude on the skin patch when loudest"),
    "surface_vertices": Variable(("surface_vertex", "xyz"), "float64", "m", "whole surface in the body frame"),
    "surface_faces": Variable(
        ("surface_face", "corner"), "int32", "1", "triangles of the whole surface, counter-clockwise outside"
    ),
    "surface_arp": Variable(
        ("surface_vertex",), "float32", "Pa", "acoustic radiation pressure on the whole surface when loudest"
    ),
    "surface_pressure": Variable(
        ("surface_vertex",), "float32", "Pa", "peak pressure amplitude on the whole surface when loudest"
    ),
    "transducer_position": Variable(("transducer", "xyz"), "float64", "m", "transducers in the array frame"),
    "array_pose": Variable(("pose7",), "float64", "m, 1", "array frame in the world: position, then quaternion wxyz"),
    "frame_time": Variable(("frame",), "float64", "s", "start of each drive frame"),
    "drive_amplitude": Variable(("frame", "transducer"), "float32", "1", "drive amplitude, 1 is full drive"),
    "drive_phase": Variable(("frame", "transducer"), "float32", "rad", "drive phase, a delay is positive"),
    "time": Variable(("time",), "float64", "s", "time of the skin substeps"),
    "normal_displacement": Variable(
        ("time", "vertex"), "float32", "m", "displacement of the skin along its outward normal"
    ),
    "normal_velocity": Variable(("time", "vertex"), "float32", "m/s", "velocity of the skin along its outward normal"),
    "arp": Variable(
        ("time", "vertex"), "float32", "Pa", "acoustic radiation pressure on the skin, positive into the surface"
    ),
    "focus": Variable(("time", "xyz"), "float64", "m", "focus in the world frame"),
    "step_time": Variable(("step_time",), "float64", "s", "time of the MuJoCo steps"),
    "body_pose": Variable(
        ("step_time", "pose7"), "float64", "m, 1", "body frame in the world: position, then quaternion wxyz"
    ),
    "skin_bone": Variable(("vertex", "influence"), "int32", "1", "bones that carry each skin vertex"),
    "skin_share": Variable(("vertex", "influence"), "float32", "1", "share of each of those bones"),
    "surface_bone": Variable(("surface_vertex", "influence"), "int32", "1", "bones that carry each surface vertex"),
    "surface_share": Variable(("surface_vertex", "influence"), "float32", "1", "share of each of those bones"),
    "bone_rest": Variable(("bone", "xyz"), "float64", "m", "origins of the bones at rest in the body frame"),
    "bone_pose": Variable(
        ("step_time", "bone", "pose7"), "float64", "m, 1", "bones in the body frame: position, then quaternion wxyz"
    ),
    "obstacle_vertices": Variable(
        ("obstacle_vertex", "xyz"), "float64", "m", "what else casts shadows, in the body frame when loudest"
    ),
    "obstacle_faces": Variable(("obstacle_face", "corner"), "int32", "1", "triangles of what else casts shadows"),
    "arp_force": Variable(("step_time", "xyz"), "float64", "N", "total acoustic radiation force in the world frame"),
}
OPTIONAL = frozenset(name for name in SCHEMA if "bone" in name or "share" in name or "obstacle" in name)
"""Only where the scene has them: an articulated hand's bones, and what stands in the sound's way."""
LABELS: dict[str, tuple[list[str], str]] = {
    "xyz": (["x", "y", "z"], "Cartesian component"),
    "corner": (["0", "1", "2"], "corner of a triangle"),
    "pose7": (["x", "y", "z", "qw", "qx", "qy", "qz"], "component of a pose"),
}
RECORDS = ("time", "frame", "step_time")
RECORD_TIME = {"time": "time", "frame": "frame_time", "step_time": "step_time"}


def dataset(**arrays: np.ndarray) -> xr.Dataset:
    """Label arrays with the dimensions, units and long names of SCHEMA.

    arrays: any of SCHEMA's names; dtype, number of dimensions and lengths must fit it. A variable along `time`, `frame`
    or `step_time` needs that dimension's time (`time`, `frame_time`, `step_time`) beside it.
    Raises OutputError for an unknown name, another dtype, or shapes that do not fit each other.
    """
    sizes: dict[str, int] = {name: len(labels) for name, (labels, _) in LABELS.items()}
    source = dict.fromkeys(sizes, "the schema")
    variables: dict[str, xr.Variable] = {}
    for name, given in arrays.items():
        array = np.asarray(given)
        _check(name, array, sizes, source)
        wanted = SCHEMA[name]
        variables[name] = xr.Variable(wanted.dims, array, {"units": wanted.units, "long_name": wanted.long_name})
    used = {str(dim) for variable in variables.values() for dim in variable.dims}
    for dim in used & RECORD_TIME.keys():
        if RECORD_TIME[dim] not in variables:
            raise OutputError(f"variables along '{dim}' came without their time; give '{RECORD_TIME[dim]}' with them")
    for dim in used & LABELS.keys():
        labels, long_name = LABELS[dim]
        variables[dim] = xr.Variable((dim,), labels, {"units": "1", "long_name": long_name})
    coords = {name: v for name, v in variables.items() if name in LABELS or name in RECORD_TIME.values()}
    return xr.Dataset({name: v for name, v in variables.items() if name not in coords}, coords)


def _check(name: str, array: np.ndarray, sizes: dict[str, int], source: dict[str, str]) -> None:
    """Hold one array against SCHEMA and the lengths seen so far; adds its own lengths to `sizes` and `source`."""
    if name not in SCHEMA:
        raise OutputError(f"result variable '{name}' is unknown; known are {', '.join(SCHEMA)}")
    wanted = SCHEMA[name]
    if array.dtype != np.dtype(wanted.dtype):
        raise OutputError(f"'{name}' has dtype {array.dtype}, allowed is {wanted.dtype}; convert it with .astype")
    if array.ndim != len(wanted.dims):
        raise OutputError(f"'{name}' has shape {array.shape}, allowed is ({', '.join(wanted.dims)}); reshape it")
    for dim, length in zip(wanted.dims, array.shape, strict=True):
        if sizes.setdefault(dim, length) != length:
            raise OutputError(
                f"'{name}' has {length} along '{dim}' where {source[dim]} has {sizes[dim]}; give both the same length"
            )
        source.setdefault(dim, f"'{name}'")
