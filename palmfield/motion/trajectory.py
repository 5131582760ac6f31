"""Motion of a hand from a table in a file or from a Python function."""

import importlib
import math
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from palmfield.errors import SceneError
from palmfield.hand.articulated import ArticulatedHand
from palmfield.motion.joints import FARTHEST_M
from palmfield.motion.keyframes import Curve, rising
from palmfield.motion.pose import HandPose, checked_pose
from palmfield.motion.rates import RateCourse
from palmfield.tables import pop_columns, read_table, write_table
from palmfield.types import Float

AXES = ("x", "y", "z")
LENGTHS_m = {"m": 1.0, "mm": 1e-3}
ANGLES_deg = {"deg": 1.0, "rad": 180.0 / math.pi}
QUATERNION = ("qw", "qx", "qy", "qz")


def read_trajectory(path: str | Path, hand: ArticulatedHand) -> Curve:
    """Read a motion from a CSV or NPZ table. It is interpolated by `Curve`, and at rest before and after.

    Columns (arrays of one length in an NPZ), in any order: time_s; x_m, y_m, z_m or x_mm, y_mm, z_mm; qw, qx, qy, qz of
    any length; JOINT_deg or JOINT_rad for the joints that leave their rest angle. At least two rows are required.
    Raises SceneError for a file that cannot be read and for a missing, unknown or repeated column. For text, NaN, times
    that do not increase, a quaternion of length 0 and a joint out of its range, the error also names line (NPZ: row)
    and column.
    """
    file = Path(path)
    columns, places = read_table(file)
    if "time_s" not in columns:
        raise _missing(file, "time_s", columns)
    times = columns.pop("time_s")
    late = np.flatnonzero(np.diff(times) <= 0.0)
    if len(late):
        n = int(late[0]) + 1
        raise SceneError(
            f"{file}: {places[n]}, column time_s: {times[n]:g} s comes after {times[n - 1]:g} s; allowed: rising times"
        )
    if len(times) < 2:
        raise SceneError(f"{file}: the file has {len(times)} rows of numbers; needed: two or more")
    positions = np.stack([_position(file, axis, columns) for axis in AXES], axis=1)
    far = np.flatnonzero(np.abs(positions).max(axis=1) > FARTHEST_M)
    if len(far):
        raise SceneError(
            f"{file}: {places[far[0]]}: the hand is {np.abs(positions[far[0]]).max():.3g} m away; allowed: at most "
            f"{FARTHEST_M:g} m; give metres in x_m, y_m, z_m, or millimetres in x_mm, y_mm, z_mm"
        )
    quaternions = pop_columns(file, columns, QUATERNION)
    lengths = np.linalg.norm(quaternions, axis=1)
    if np.any(lengths < 1e-6):
        raise SceneError(
            f"{file}: {places[int(np.argmin(lengths))]}, columns qw to qz: a quaternion of length {lengths.min():g}; "
            "give w, x, y, z of a rotation, such as 1, 0, 0, 0"
        )
    angles = _angles(file, hand, columns, places)
    joints = [joint.name for joint in hand.joints]
    return Curve(joints, times, positions, quaternions / lengths[:, None], angles, rest=False)


def _position(file: Path, axis: str, columns: dict[str, Float]) -> Float:
    units = [unit for unit in LENGTHS_m if f"{axis}_{unit}" in columns]
    if len(units) != 1:
        raise _missing(file, f"{axis}_m' or '{axis}_mm", columns) if not units else _doubled(file, axis, units)
    return LENGTHS_m[units[0]] * columns.pop(f"{axis}_{units[0]}")


def _angles(file: Path, hand: ArticulatedHand, columns: dict[str, Float], places: list[str]) -> Float:
    """Return angles of all joints [deg], shape (rows, joints), from the remaining columns."""
    joints = {joint.name: joint for joint in hand.joints}
    angles = np.tile([joint.rest_deg for joint in hand.joints], (len(places), 1))
    for column, values in columns.items():
        name, _, unit = column.rpartition("_")
        if name not in joints or unit not in ANGLES_deg:
            raise SceneError(
                f"{file}: column '{column}' is unknown; use time_s, x_m, y_m, z_m (or _mm), qw, qx, qy, qz and "
                f"JOINT_deg or JOINT_rad with JOINT among: {', '.join(joints)}"
            )
        if all(f"{name}_{other}" in columns for other in ANGLES_deg):
            raise _doubled(file, name, list(ANGLES_deg))
        joint, degrees = joints[name], ANGLES_deg[unit] * values
        outside = np.flatnonzero((degrees < joint.low_deg - 1e-6) | (degrees > joint.high_deg + 1e-6))
        if len(outside):
            n = int(outside[0])
            raise SceneError(
                f"{file}: {places[n]}, column {column}: {degrees[n]:g} degrees; "
                f"use {joint.low_deg:g} to {joint.high_deg:g} degrees"
            )
        angles[:, list(joints).index(name)] = degrees
    return angles


def _missing(file: Path, name: str, columns: dict[str, Float]) -> SceneError:
    return SceneError(f"{file}: column '{name}' is missing; columns left are: {', '.join(columns) or 'none'}")


def _doubled(file: Path, name: str, units: list[str]) -> SceneError:
    both = " and ".join(f"{name}_{unit}" for unit in units)
    return SceneError(f"{file}: columns {both} exclude each other; give one of them")


def write_trajectory(path: str | Path, hand: ArticulatedHand, times: ArrayLike, poses: Sequence[HandPose]) -> None:
    """Write poses at times [s], shape (n,), to a CSV or NPZ file that `read_trajectory` reads, all joints in degrees.

    Raises SceneError for data that `read_trajectory` would refuse, OutputError for a file that cannot be written.
    """
    seconds = rising(times, "hand trajectory")
    if len(poses) != len(seconds):
        raise SceneError(f"hand trajectory: {len(poses)} poses for {len(seconds)} times; give one pose for each time")
    rows = []
    for time, pose in zip(seconds, poses, strict=True):
        checked = checked_pose(pose, f"hand trajectory: at {time:g} s", hand)
        angles = [checked.angles_deg.get(joint.name, joint.rest_deg) for joint in hand.joints]
        rows.append([time, *checked.position, *checked.quaternion, *angles])
    names = ["time_s", *(f"{axis}_m" for axis in AXES), *QUATERNION, *(f"{joint.name}_deg" for joint in hand.joints)]
    write_table(Path(path), names, np.array(rows))


class Scripted:
    """A motion by a function whose results are checked.

    span_s: first and last time of the function [s], or -inf and inf
    rates: attribute of the function that gives its derivatives (`palmfield.motion.rates.HandRates`) by time [s], or
        None
    """

    def __init__(self, function: Callable[[float], HandPose], name: str, hand: ArticulatedHand | None) -> None:
        self.span_s: tuple[float, float] = getattr(function, "span_s", (-math.inf, math.inf))
        self.rates: RateCourse | None = getattr(function, "rates", None)
        self._function = function
        self._name = name
        self._hand = hand

    def __call__(self, time_s: float) -> HandPose:
        """Return the pose at a time [s]. Raises SceneError, with the time, for invalid results and for errors."""
        time = min(max(float(time_s), self.span_s[0]), self.span_s[1])
        where = f"hand motion '{self._name}' at {time:g} s"
        try:
            answer = self._function(time)
        except Exception as error:
            raise SceneError(f"{where}: {type(error).__name__}: {error}; correct the function") from error
        if isinstance(answer, tuple) and len(answer) == 3:
            answer = HandPose(*answer)
        if not isinstance(answer, HandPose):
            raise SceneError(
                f"{where}: the function returned {type(answer).__name__}; return a palmfield.motion.pose.HandPose, "
                "or a tuple of position [m], quaternion (w first) and angles [deg] by joint"
            )
        return checked_pose(answer, where, self._hand)


def from_callable(function: str | Callable[[float], HandPose], hand: ArticulatedHand | None = None) -> Scripted:
    """Return the motion that a function of time [s] describes. It returns a HandPose, or a tuple of its parts.

    function: function, or "package.module:function"; hand: hand with the allowed joints and ranges
    Raises SceneError if the function is not found; its results are checked when the motion is evaluated.
    """
    if callable(function):
        return Scripted(function, getattr(function, "__name__", type(function).__name__), hand)
    module, _, name = function.partition(":")
    if not module or not name:
        raise SceneError(f"hand motion '{function}' is not of the form package.module:function")
    try:
        imported = getattr(importlib.import_module(module), name)
    except Exception as error:  # a user's module may raise any exception
        why = f"{type(error).__name__}: {error}"
        if isinstance(error, ModuleNotFoundError):
            why = f"there is no module '{error.name}'"
        raise SceneError(
            f"hand motion '{function}' is not found: {why}; name a function that Python can import"
        ) from None
    if not callable(imported):
        raise SceneError(f"hand motion '{function}' is {type(imported).__name__}; name a function of time [s]")
    return Scripted(imported, function, hand)
