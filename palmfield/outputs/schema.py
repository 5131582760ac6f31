"""Schema 2 of a result: its groups and variables, with dimensions, types, units, signs and frames.

A result is a tree. Its root contains the three time axes. Every instance of the scene has its own groups, named
KIND/INSTANCE: `/skin/palm`, `/array/left`. Later versions add variables and do not change existing ones.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias
from urllib.parse import quote, unquote

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from palmfield.errors import OutputError

SCHEMA_VERSION = 2
CONVENTIONS = "CF-1.11"

Arrays: TypeAlias = Mapping[str, Mapping[str, ArrayLike]]
"""Plain arrays by group and variable. The group is "/" or a path from `group`."""
Checked: TypeAlias = dict[str, dict[str, NDArray[Any]]]
"""Arrays by group and variable, converted to the types of the schema."""
Attributes: TypeAlias = Mapping[str, Mapping[str, Any]]
"""Attributes of groups, by group."""


class Variable(NamedTuple):
    """Required properties of one variable of a result.

    dims: dimensions; units: UDUNITS, empty for names; about: a short name, and details after ",", ";" or ":"
    frame: the frame in which a vector, position or pose is given; sign: what a positive value means
    """

    dims: tuple[str, ...]
    dtype: str
    units: str
    about: str
    frame: str = ""
    sign: str = ""

    @property
    def words(self) -> tuple[str, str]:
        """Return the short name and the details of `about`."""
        parts = re.split(r"[,;:] (?![^(]*\))", self.about, maxsplit=1)
        return parts[0], parts[1] if len(parts) > 1 else ""

    @property
    def attributes(self) -> dict[str, str]:
        """Return the attributes of the netCDF variable.

        long_name is the short name for plots; comment contains the details.
        """
        long_name, comment = self.words
        pairs = {
            "units": self.units, "long_name": long_name, "comment": comment, "frame": self.frame, "sign": self.sign,
        }  # fmt: skip
        filled = {name: text for name, text in pairs.items() if text}
        # Positions and quaternions have no common unit, so `component_units` gives one for each component
        return filled | ({"component_units": "m m m 1 1 1 1"} if self.dims[-1:] == ("pose7",) else {})


_BODY = "body frame at rest (before bones move)"
_WORLD = "world"
_INTO = "positive values push into the surface"
_POSE = "maps points of the frame to the outer frame: x_outer = R x + position"


def _mesh(what: str) -> dict[str, Variable]:
    """Return the variables that a skin and the surface of its body share."""
    return {
        "rest_position": Variable(("vertex", "xyz"), "float64", "m", f"vertices at rest, of the {what}", _BODY),
        "face": Variable(
            ("triangle", "corner"), "int32", "1", f"triangles, of the {what}, counter-clockwise from outside; first 0"
        ),
        "bone_index": Variable(
            ("vertex", "influence"), "int32", "1", "bones that carry each vertex: places along bone in /body; first 0"
        ),
        "bone_weight": Variable(
            ("vertex", "influence"), "float32", "1", "share of each of those bones; the shares of a vertex add up to 1"
        ),
        "loudest_time": Variable((), "float64", "s", "time of the largest ARP on the skin, from the start of the run"),
        "loudest_arp": Variable(
            ("vertex",), "float32", "Pa", f"ARP at the loudest moment, on the {what} at loudest_time", sign=_INTO
        ),
        "loudest_pressure": Variable(
            ("vertex",),
            "float32",
            "Pa",
            f"sound pressure at the loudest moment, peak amplitude on the {what} at loudest_time",
        ),
    }


ROOT: dict[str, Variable] = {
    "time": Variable(("time",), "float64", "s", "ends of the skin substeps, from the start of the run"),
    "step_time": Variable(("step_time",), "float64", "s", "starts of the MuJoCo steps, from the start of the run"),
    "frame_time": Variable(("frame_time",), "float64", "s", "starts of the drive frames, from the start of the run"),
}
GROUPS: dict[str, dict[str, Variable]] = {
    "skin": _mesh("skin patch")
    | {
        "rest_normal": Variable(
            ("vertex", "xyz"), "float64", "1", "unit normals of the skin at rest", _BODY, "positive points outward"
        ),
        "depth": Variable(("vertex",), "float64", "m", "thickness of the skin layer, along the inward normal"),
        "displacement": Variable(
            ("time", "vertex", "xyz"), "float32", "m", "displacement, from where the body carries the skin", _BODY,
            "positive along the axes; its dot product with rest_normal is positive outward, so a push is negative",
        ),
        "normal_displacement": Variable(
            ("time", "vertex"), "float32", "m", "normal displacement, along the outward normal at rest",
            sign="positive outward: a push is negative",
        ),
        "velocity": Variable(
            ("time", "vertex", "xyz"), "float32", "m s-1", "velocity, of the displacement", _BODY,
            "as for displacement",
        ),
        "motion_displacement": Variable(
            ("step_time", "vertex", "xyz"), "float32", "m",
            "displacement by the motion of the body, from its acceleration alone; not part of displacement", _BODY,
            "as for displacement",
        ),
        "arp": Variable(
            ("time", "vertex"), "float32", "Pa", "radiation pressure (ARP), acoustic, on the skin patch", sign=_INTO
        ),
        "pressure": Variable(
            ("time", "vertex"), "float32", "Pa", "sound pressure, peak amplitude on the skin patch"
        ),
        "afferent_class": Variable(("afferent",), "str", "", "class of each afferent: sa1, ra1 or pc"),
        "afferent_position": Variable(
            ("afferent", "xyz"), "float64", "m", "points of the skin above the afferents, at rest", _BODY
        ),
        "afferent_motion": Variable(
            ("time", "afferent"), "float32", "m",
            "motion at the endings of the afferents, as displacement of a probe of 1 mm radius with the same effect",
            sign=_INTO,
        ),
    },
    "surface": _mesh("whole surface of the body of the skin")
    | {
        "obstacle_position": Variable(
            ("obstacle_vertex", "xyz"), "float64", "m",
            "vertices of obstacles, bodies without skin that cast shadows, at loudest_time", _WORLD,
        ),
        "obstacle_face": Variable(
            ("obstacle_triangle", "corner"), "int32", "1", "triangles of obstacles, as face"
        ),
        "face_arp": Variable(
            ("step_time", "triangle"), "float32", "Pa",
            "ARP on each triangle, mean over triangle and step; the sum of ARP times area times inward normal is the "
            "force",
            sign=_INTO,
        ),
    },
    "array": {
        "transducer_position": Variable(("transducer", "xyz"), "float64", "m", "transducers", "frame of this array"),
        "transducer_direction": Variable(
            ("transducer", "xyz"), "float64", "1", "directions of emission, of length 1", "frame of this array"
        ),
        "transducer_p0": Variable(
            ("transducer",), "float64", "Pa m",
            "peak pressure at 1 m, on the axis of each at full drive, without absorption; 0 for a dead transducer",
        ),
        "transducer_phase": Variable(
            ("transducer",), "float64", "rad", "phase of the sound, of each against its drive",
            sign="positive is a delay (time factor e^{-i w t})",
        ),
        "piston_radius": Variable((), "float64", "m", "piston radius, of the directivity; 0 is a point"),
        "off_axis_angle": Variable(
            ("off_axis",), "float64", "degree", "angles of a measured directivity, which replaces that of the piston"
        ),
        "off_axis_level": Variable(("off_axis",), "float64", "1", "measured directivity, relative to the axis"),
        "drive_amplitude": Variable(
            ("frame_time", "transducer"), "float32", "1", "amplitude of the drive, 1 is full drive"
        ),
        "drive_phase": Variable(
            ("frame_time", "transducer"), "float32", "rad", "phase of the drive",
            sign="positive is a delay (time factor e^{-i w t})",
        ),
        "pose": Variable(
            ("step_time", "pose7"), "float64", "1", "array frame: position, then unit quaternion (w, x, y, z)", _WORLD,
            _POSE,
        ),
    },
    "stimulus": {
        "foci": Variable(
            ("time", "focus", "xyz"), "float64", "m", "focal points; also while the stimulus is silent",
            _WORLD,
        ),
        "sounding": Variable(("time",), "bool", "1", "whether the stimulus sounds"),
    },
    "body": {
        "bone": Variable(("bone",), "str", "", "names of the bones"),
        "pose": Variable(
            ("step_time", "pose7"), "float64", "1", "body frame: position, then unit quaternion (w, x, y, z)", _WORLD,
            _POSE,
        ),
        "bone_pose": Variable(
            ("step_time", "bone", "pose7"), "float64", "1", "bones: position, then unit quaternion (w, x, y, z)",
            "body frame", _POSE,
        ),
        "bone_rest": Variable(("bone", "xyz"), "float64", "m", "origins of the bones at rest", _BODY),
    },
    "forces": {
        "bone": Variable(("bone",), "str", "", "names of the bones"),
        "force": Variable(
            ("step_time", "xyz"), "float64", "N", "force of the sound on the whole body, mean over the step", _WORLD,
            "acts on the body",
        ),
        "torque": Variable(
            ("step_time", "xyz"), "float64", "N m", "torque of the sound, about the origin of the body, mean over the "
                                                    "step",
            _WORLD, "acts on the body",
        ),
        "bone_force": Variable(
            ("step_time", "bone", "xyz"), "float64", "N", "force of the sound on each bone, mean over the step", _WORLD,
            "acts on the bone",
        ),
        "bone_torque": Variable(
            ("step_time", "bone", "xyz"), "float64", "N m",
            "torque of the sound on each bone, about the origin of the bone, mean over the step", _WORLD, "acts on "
                                                                                                          "the bone",
        ),
    },
    "sensors": {
        "channel": Variable(("channel",), "str", "", "names of the channels of the sensor"),
        "channel_units": Variable(("channel",), "str", "", "units of the channels of the sensor"),
        "value": Variable(
            ("step_time", "channel"), "float64", "1", "values of the sensor, each channel in its unit of channel_units"
        ),
    },
    "mujoco": {
        "pose": Variable(
            ("step_time", "mujoco_body", "pose7"), "float64", "1",
            "all MuJoCo bodies: position, then unit quaternion (w, x, y, z)", _WORLD, _POSE,
        ),
        "body_name": Variable(("mujoco_body",), "str", "", "names of the bodies; the first is the world"),
        "body_parent": Variable(("mujoco_body",), "int32", "1", "parent of each body; first 0"),
        "body_frame": Variable(
            ("mujoco_body", "pose7"), "float64", "1", "body frames, while all joints are at joint_reference",
            "parent body", _POSE,
        ),
        "body_mass": Variable(("mujoco_body",), "float64", "kg", "masses"),
        "body_inertia": Variable(
            ("mujoco_body", "xyz"), "float64", "kg m2", "moments of inertia, about the axes of body_inertial_frame",
            "principal axes",
        ),
        "body_inertial_frame": Variable(
            ("mujoco_body", "pose7"), "float64", "1", "centre of mass and principal axes", "body", _POSE
        ),
        "body_held": Variable(("mujoco_body",), "bool", "1", "whether a body is fixed in the world"),
        "body_placed": Variable(("mujoco_body",), "bool", "1", "whether a body is mocap, positioned from outside"),
        "geom_name": Variable(("geom",), "str", "", "names of the geoms"),
        "geom_body": Variable(("geom",), "int32", "1", "the body of each; first 0"),
        "geom_type": Variable(("geom",), "str", "", "sphere, capsule, box and so on"),
        "geom_size": Variable(("geom", "xyz"), "float64", "m", "half lengths, as in MuJoCo by type", "geom"),
        "geom_frame": Variable(("geom", "pose7"), "float64", "1", "pose of each geom", "body", _POSE),
        "geom_rgba": Variable(("geom", "channel"), "float64", "1", "colour and opacity"),
        "geom_collides": Variable(("geom",), "bool", "1", "whether the geom can be in contact"),
        "geom_friction": Variable(("geom",), "float64", "1", "coefficient of sliding friction"),
        "geom_mesh": Variable(("geom",), "int32", "1", "the mesh of each, -1 for none; first 0"),
        "mesh_vertex": Variable(("mesh_vertex_number", "xyz"), "float64", "m", "vertices of all meshes", "geom"),
        "mesh_vertex_owner": Variable(("mesh_vertex_number",), "int32", "1", "the mesh of each vertex; first 0"),
        "mesh_face": Variable(("mesh_triangle", "corner"), "int32", "1", "triangles; the first vertex of each mesh is "
                                                                         "0"),
        "mesh_face_owner": Variable(("mesh_triangle",), "int32", "1", "the mesh of each triangle; first 0"),
        "joint_name": Variable(("joint",), "str", "", "names of the joints"),
        "joint_type": Variable(("joint",), "str", "", "free, ball, slide or hinge"),
        "joint_body": Variable(("joint",), "int32", "1", "body of each joint, moved by it; first 0"),
        "joint_position": Variable(("joint", "xyz"), "float64", "m", "anchors", "body"),
        "joint_axis": Variable(("joint", "xyz"), "float64", "1", "unit axes of slides and hinges", "body"),
        "joint_range": Variable(("joint", "end"), "float64", "1", "ends of the range: m of a slide, rad of others"),
        "joint_limited": Variable(("joint",), "bool", "1", "whether the range is enforced"),
        "joint_reference": Variable(("joint",), "float64", "1", "position of the joint in body_frame: m or rad"),
    },
}  # fmt: skip
"""Variables by kind of group. Empty variables of /mujoco are omitted.

Variables along `bone` and `influence` exist only for bodies with bones, obstacles only if the scene has some, and
motion_displacement only with key inertia. An interrupted run lacks the variables of the loudest moment.
"""
LABELS: dict[str, tuple[tuple[str, ...], str]] = {
    "xyz": (("x", "y", "z"), "Cartesian component"),
    "corner": (("0", "1", "2"), "corner of a triangle"),
    "pose7": (("x", "y", "z", "qw", "qx", "qy", "qz"), "component of a pose"),
}
"""Coordinates in the root, which name the components."""
MUJOCO_SCENE = "scene"
"""Name of the only instance of group /mujoco."""
PLACES = "rest_position"
"""Name of the coordinate that numbers vertices."""
RECORDS = ("time", "step_time", "frame_time")
"""Dimensions that grow during a run."""


def group(kind: str, instance: str) -> str:
    """Return the path of the group of an instance, such as /skin/palm; forbidden characters are percent-encoded.

    Raises OutputError for a kind that is not in GROUPS and for an empty name.
    """
    if kind not in GROUPS or not instance:
        raise OutputError(f"there is no group for '{kind}' '{instance}'; give a name and one of {', '.join(GROUPS)}")
    name = quote(instance, safe=" !#$&'()*+,;=:@[]~")
    return f"/{kind}/{name.replace('.', '%2E') if name.strip('.') == '' else name}"


def kind_and_instance(path: str) -> tuple[str, str]:
    """Return kind and instance of the path of a group. Raises OutputError for a path that `group` cannot return."""
    parts = path.split("/")
    if len(parts) != 3 or parts[0] or parts[1] not in GROUPS or not parts[2]:
        allowed = ", ".join(f"/{kind}/NAME" for kind in GROUPS)
        raise OutputError(f"a result has no group '{path}'; allowed are '/' and {allowed}")
    return parts[1], unquote(parts[2])


def ordered(paths: Iterable[str]) -> list[str]:
    """Return paths of groups without repeats, in the order of GROUPS, and within a kind in the order of the scene."""
    kinds = list(GROUPS)
    return sorted(dict.fromkeys(paths), key=lambda path: -1 if path == "/" else kinds.index(kind_and_instance(path)[0]))


def variables_of(path: str) -> dict[str, Variable]:
    """Return the variables of a group in the schema. Raises OutputError for an invalid group."""
    return ROOT if path == "/" else GROUPS[kind_and_instance(path)[0]]


def check(arrays: Arrays, sizes: dict[tuple[str, str], int]) -> Checked:
    """Check data against the schema; return them as arrays, copied only if necessary.

    arrays: arrays by group and variable. Arrays along `time`, `step_time` or `frame_time` need these times in the root
    ("/")
    sizes: lengths by (group, dimension) of earlier arrays; new lengths are added, except of record dimensions
    Raises OutputError for unknown groups and variables, wrong types, and inconsistent shapes.
    """
    records = {name: len(np.atleast_1d(array)) for name, array in arrays.get("/", {}).items()}
    checked: Checked = {}
    for path, variables in arrays.items():
        schema = variables_of(path)
        checked[path] = {}
        for name, values in variables.items():
            if name not in schema:
                raise OutputError(f"variable '{name}' of group '{path}' is unknown; known are {', '.join(schema)}")
            array = np.asarray(values)
            _check_one(f"{path.rstrip('/')}/{name}", path, schema[name], array, sizes, records)
            checked[path][name] = array
    return checked


def _check_one(
    name: str,
    path: str,
    allowed: Variable,
    array: NDArray[Any],
    sizes: dict[tuple[str, str], int],
    records: dict[str, int],
) -> None:
    if array.dtype != np.dtype(allowed.dtype) and not (allowed.dtype == "str" and array.dtype.kind == "U"):
        raise OutputError(f"'{name}' has type {array.dtype}, allowed is {allowed.dtype}; convert it with .astype")
    if array.ndim != len(allowed.dims):
        raise OutputError(f"'{name}' has shape {array.shape}, allowed is ({', '.join(allowed.dims)}); reshape it")
    for dim, length in zip(allowed.dims, array.shape, strict=True):
        if dim in RECORDS:
            if dim not in records:
                raise OutputError(f"'{name}' has no times; give '{dim}' of group '/' with it")
            expected = records[dim]
        elif dim in LABELS:
            expected = len(LABELS[dim][0])
        else:
            expected = sizes.setdefault((path, dim), length)
            if length == 0:
                raise OutputError(f"'{name}' has length 0 along '{dim}'; omit it")
        if length != expected:
            raise OutputError(
                f"'{name}' has length {length} along '{dim}', but the result has {expected}; give arrays of equal "
                "length"
            )


def tree(arrays: Arrays, attributes: Attributes | None = None) -> xr.DataTree:
    """Return a result in memory. Raises the OutputError of `check`.

    arrays: arrays by group and variable; attributes: attributes of groups; those of "/" are of the whole result
    """
    checked = check(arrays, {})
    root = {name: xr.Variable((name,), np.array(names), {"long_name": what}) for name, (names, what) in LABELS.items()}
    datasets = {}
    paths = ordered(["/", *checked, *(attributes or {})])
    for path in paths:
        schema = variables_of(path)
        made = {name: xr.Variable(schema[name].dims, array, schema[name].attributes) for name, array in
                checked.get(path, {}).items()}  # fmt: skip
        one = xr.Dataset(made | root if path == "/" else made, attrs=dict((attributes or {}).get(path, {})))
        datasets[path] = one.set_coords(PLACES) if PLACES in one else one
    datasets["/"].attrs = root_attributes() | datasets["/"].attrs
    return xr.DataTree.from_dict(datasets)


def root_attributes() -> dict[str, Any]:
    """Return the attributes that every result has."""
    return {
        "Conventions": CONVENTIONS,
        "schema_version": SCHEMA_VERSION,
        "title": "palmfield: sound of ultrasonic arrays on skin, and motion of the skin",
    }


def instances(result: xr.DataTree, kind: str) -> dict[str, xr.Dataset]:
    """Return the groups of one kind by instance, in the order of the scene, each with the coordinates of the root."""
    if kind not in result.children:
        return {}
    return {unquote(name): node.to_dataset() for name, node in result.children[kind].children.items()}


def has_records(ds: xr.Dataset | xr.DataTree, *names: str) -> bool:
    """Return whether a group has at least one record of each variable. An interrupted run may lack records."""
    return all(name in ds and ds[name].size > 0 for name in names)


def sensor_channels(names: Sequence[str], units: Sequence[str]) -> dict[str, NDArray[Any]]:
    """Return the static variables of a group /sensors/NAME: names and units of its channels."""
    return {"channel": np.array(names), "channel_units": np.array(units)}
