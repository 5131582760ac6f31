"""A hand's motion from a table in a file, and from a Python function."""

import csv
import importlib
import math
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from zipfile import BadZipFile, is_zipfile

import numpy as np
from numpy.typing import ArrayLike

from palmfield.errors import OutputError, SceneError
from palmfield.hand.articulated import ArticulatedHand
from palmfield.motion.keyframes import Curve, rising
from palmfield.motion.pose import HandPose, checked_pose
from palmfield.types import Float

AXES = ("x", "y", "z")
LENGTHS_m = {"m": 1.0, "mm": 1e-3}
ANGLES_deg = {"deg": 1.0, "rad": 180.0 / math.pi}
QUATERNION = ("qw", "qx", "qy", "qz")
UNREADABLE = (OSError, EOFError, ValueError, NotImplementedError, BadZipFile, zlib.error, csv.Error)
"""What open, csv, zipfile and NumPy raise for a broken file; undecodable text is a ValueError."""


def read_trajectory(path: str | Path, hand: ArticulatedHand) -> Curve:
    """The motion in a CSV or NPZ table; between samples as `Curve`, outside them standing still.

    Columns (arrays of one length in an NPZ), in any order: time_s; x_m, y_m, z_m or x_mm, y_mm, z_mm; qw, qx, qy, qz
    of any length; and for the joints that leave their rest JOINT_deg or JOINT_rad. Two or more rows.
    Raises SceneError for a file that cannot be read, a missing, unknown or doubled column, and, with line (in an NPZ:
    row) and column, for text, NaN, time that does not rise, a quaternion of length 0 and a joint out of its range.
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
            f"{file}: {places[n]}, column time_s: {times[n]:g} s comes after {times[n - 1]:g} s; let time rise"
        )
    if len(times) < 2:
        raise SceneError(f"{file}: {len(times)} rows of numbers; give two or more")
    positions = np.stack([_position(file, axis, columns) for axis in AXES], axis=1)
    missing = [name for name in QUATERNION if name not in columns]
    if missing:
        raise _missing(file, missing[0], columns)
    quaternions = np.stack([columns.pop(name) for name in QUATERNION], axis=1)
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
    given = [unit for unit in LENGTHS_m if f"{axis}_{unit}" in columns]
    if len(given) != 1:
        raise _missing(file, f"{axis}_m' or '{axis}_mm", columns) if not given else _doubled(file, axis, given)
    return LENGTHS_m[given[0]] * columns.pop(f"{axis}_{given[0]}")


def _angles(file: Path, hand: ArticulatedHand, columns: dict[str, Float], places: list[str]) -> Float:
    """Angles of all joints [deg], shape (rows, joints), from the columns that are left."""
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
    return SceneError(f"{file}: columns {both} are both given; give one of them")


def read_table(file: Path, gaps: Sequence[str] = ()) -> tuple[dict[str, Float], list[str]]:
    """Columns of numbers of a CSV file with a header, or of an NPZ file; and what to call each row in messages.

    gaps: columns in which numbers need not be finite. Raises SceneError as `read_trajectory`.
    """
    try:
        if file.suffix.lower() == ".npz":
            columns, places = _npz(file)
        elif file.suffix.lower() == ".csv":
            columns, places = _csv(file)
        else:
            raise SceneError(f"{file}: the file's kind is '{file.suffix}'; use .csv or .npz")
    except UNREADABLE as error:
        raise SceneError(
            f"{file}: cannot be read: {error or type(error).__name__}; give a CSV (UTF-8) or NPZ file"
        ) from None
    for name, values in columns.items():
        bad = np.flatnonzero(~np.isfinite(values))
        if len(bad) and name not in gaps:
            raise SceneError(f"{file}: {places[int(bad[0])]}, column {name}: {values[bad[0]]:g}; give a finite number")
    return columns, places


def _npz(file: Path) -> tuple[dict[str, Float], list[str]]:
    columns: dict[str, Float] = {}
    with file.open("rb") as data:
        if not is_zipfile(data):
            raise SceneError(f"{file}: is not an NPZ archive; write it by write_trajectory or numpy.savez")
    with np.load(file, allow_pickle=False) as archive:
        for name in archive.files:
            try:
                columns[name] = np.asarray(archive[name], dtype=np.float64)
            except ValueError:
                raise SceneError(f"{file}: column {name} is not of numbers; give numbers") from None
    shapes = {values.shape for values in columns.values()}
    if len(shapes) != 1 or len(next(iter(shapes))) != 1:
        listed = ", ".join(f"{name} {values.shape}" for name, values in columns.items())
        raise SceneError(f"{file}: arrays have shapes {listed or 'none'}; give arrays of one length, shape (rows,)")
    rows = next(iter(shapes))[0]
    return columns, [f"row {n + 1}" for n in range(rows)]


def _csv(file: Path) -> tuple[dict[str, Float], list[str]]:
    with file.open(newline="", encoding="utf-8-sig") as text:
        reader = csv.reader(text)
        header = [name.strip() for name in next(reader, [])]
        twice = [name for name in header if header.count(name) > 1]
        if not header or twice:
            fault = f"column '{twice[0]}' is there twice" if twice else "the file is empty"
            raise SceneError(f"{file}: {fault}; begin with one line of different column names")
        rows, places = [], []
        for row in reader:
            if not any(cell.strip() for cell in row):
                continue
            place = f"line {reader.line_num}"
            if len(row) != len(header):
                raise SceneError(f"{file}: {place} has {len(row)} values for {len(header)} columns; give one for each")
            rows.append([_number(file, place, name, cell) for name, cell in zip(header, row, strict=True)])
            places.append(place)
    table = np.array(rows, dtype=np.float64).reshape(-1, len(header))
    return {name: table[:, n] for n, name in enumerate(header)}, places


def _number(file: Path, place: str, column: str, cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        raise SceneError(f"{file}: {place}, column {column}: '{cell}' is not a number; give a number") from None


def write_trajectory(path: str | Path, hand: ArticulatedHand, times: ArrayLike, poses: Sequence[HandPose]) -> None:
    """Write poses at times [s], shape (n,), to a CSV or NPZ file that `read_trajectory` reads, all joints in degrees.

    Raises SceneError for what `read_trajectory` would refuse, OutputError for a file that cannot be written.
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


def write_table(file: Path, names: Sequence[str], table: Float) -> None:
    """Write columns of numbers, shape (rows, names), to a CSV or NPZ file, which `read_table` reads back unchanged.

    Raises OutputError for another kind of file and for a file that cannot be written.
    """
    if file.suffix.lower() not in (".csv", ".npz"):
        raise OutputError(f"{file}: the file's kind is '{file.suffix}'; use .csv or .npz")
    try:
        if file.suffix.lower() == ".npz":
            with file.open("wb") as data:
                # Not with allow_pickle=False, which numpy below 2.2 takes for one more array, and numbers don't need
                np.savez_compressed(data, **dict(zip(names, table.T, strict=True)))
        else:
            with file.open("w", newline="", encoding="utf-8") as text:
                writer = csv.writer(text)
                writer.writerow(names)
                writer.writerows(table.tolist())
    except OSError as error:
        raise OutputError(f"{file}: cannot be written: {error}; give a place that can be written to") from None


class Scripted:
    """A motion by a function; each of its answers is checked.

    span_s: the function's own, or from -inf to inf
    """

    def __init__(self, function: Callable[[float], HandPose], name: str, hand: ArticulatedHand | None) -> None:
        self.span_s: tuple[float, float] = getattr(function, "span_s", (-math.inf, math.inf))
        self._function = function
        self._name = name
        self._hand = hand

    def __call__(self, time_s: float) -> HandPose:
        """The pose at a time [s]. Raises SceneError, with the time, for what is not a pose or fails."""
        time = min(max(float(time_s), self.span_s[0]), self.span_s[1])
        where = f"hand motion '{self._name}' at {time:g} s"
        try:
            answer = self._function(time)
        except Exception as error:
            raise SceneError(f"{where}: {type(error).__name__}: {error}; mend the function") from error
        if isinstance(answer, tuple) and len(answer) == 3:
            answer = HandPose(*answer)
        if not isinstance(answer, HandPose):
            raise SceneError(
                f"{where}: the answer is {type(answer).__name__}; give a palmfield.motion.pose.HandPose or a tuple of "
                "position [m], quaternion (w first) and angles [deg] by joint"
            )
        return checked_pose(answer, where, self._hand)


def from_callable(function: str | Callable[[float], HandPose], hand: ArticulatedHand | None = None) -> Scripted:
    """The motion of a function of time [s] that gives a HandPose, or a tuple of its three parts.

    function: itself, or "package.module:function"; hand: whose joints and ranges its answers are checked against
    Raises SceneError where the function is not found; its answers are checked when the motion is asked.
    """
    if callable(function):
        return Scripted(function, getattr(function, "__name__", type(function).__name__), hand)
    module, _, name = function.partition(":")
    if not module or not name:
        raise SceneError(f"hand motion '{function}' is not of the form package.module:function")
    try:
        imported = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError) as error:
        raise SceneError(f"hand motion '{function}' is not found: {error}; name one that Python can import") from None
    if not callable(imported):
        raise SceneError(f"hand motion '{function}' is {type(imported).__name__}; name a function of time [s]")
    return Scripted(imported, function, hand)
