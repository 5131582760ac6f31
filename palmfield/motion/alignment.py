"""Pose of a tracker relative to an array. A fingertip touches known points of the array."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from scipy.spatial.transform import Rotation

from palmfield.errors import SceneError, fault_of
from palmfield.files import MOST_SETTINGS_BYTES, read_bytes, reading, write_text
from palmfield.tables import pop_columns, read_table
from palmfield.transforms import Transform
from palmfield.types import Float

COLUMNS = tuple(f"{frame}_{axis}_m" for frame in ("array", "tracker") for axis in "xyz")
FEWEST = 3
LEAST_SPREAD_M = 0.02
"""Smallest extent of the points perpendicular to their best line; if it is smaller, the rotation is undetermined."""
LARGEST_MISS_M = 0.02
"""Largest misfit of the points; if it is larger, the touched points are not the points in the table."""
TOUCH_SD_M = 1e-3
"""Standard deviation of a touch per axis that is assumed if there are too few points to estimate it."""
MIRRORED = 1.0 / 3.0
"""Ratio of misfits above which the axes are mirrored: before, and after a swap or a reversal of axes."""
ABOVE_M = 0.2
Place = tuple[float, float, float]


class Alignment(BaseModel):
    """Pose of the tracker frame relative to the array frame: x_array = turn(x_tracker) + position_m.

    position_m: origin of the tracker frame [m]
    quaternion: rotation, w first
    points: number of touches
    rms_m: rms misfit of the touches [m]
    touch_sd_m: standard deviation of a touch per axis, from the misfit of 4 points or more; otherwise TOUCH_SD_M
    turn_sd_rad: standard deviation of the rotation about its least certain axis
    sd_m: standard deviation, over all axes, of a point 0.2 m above the touched points
    off_plane_m: extent of the points perpendicular to their best plane; None in older files
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    format: Literal["palmfield tracker alignment"] = "palmfield tracker alignment"
    version: Literal[1] = 1
    position_m: Place
    quaternion: tuple[float, float, float, float]
    points: Annotated[int, Field(ge=FEWEST)]
    rms_m: Annotated[float, Field(ge=0)]
    touch_sd_m: Annotated[float, Field(ge=0)]
    turn_sd_rad: Annotated[float, Field(ge=0)]
    sd_m: Annotated[float, Field(ge=0)]
    off_plane_m: Annotated[float, Field(ge=0)] | None = None

    @property
    def transform(self) -> Transform:
        """Transform from the tracker frame to the array frame."""
        turn = Rotation.from_quat(self.quaternion, scalar_first=True).as_matrix()
        return Transform(np.array(self.position_m), turn)

    def __str__(self) -> str:
        x, y, z = (1e3 * value for value in self.position_m)
        turn = np.degrees(Rotation.from_quat(self.quaternion, scalar_first=True).magnitude())
        source = (
            "from the residuals"
            if self.points > FEWEST
            else "assumed for three points, whose residuals carry little information"
        )
        flat = self.off_plane_m is not None and self.off_plane_m < LEAST_SPREAD_M
        warning = (
            "\n"
            "the points lie in one plane, so left-handed axes of the tracker fit equally well: touch one more "
            f"point, {1e3 * LEAST_SPREAD_M:g} mm or more away from it"
        )
        return (
            f"the tracker's origin is at ({x:.1f}, {y:.1f}, {z:.1f}) mm in the array frame, rotated by {turn:.1f} "
            "degrees\n"
            f"{self.points} points, residual {1e3 * self.rms_m:.2f} mm rms; error of a touch "
            f"{1e3 * self.touch_sd_m:.2f} mm per axis ({source})\n"
            f"uncertainty (sd): {np.degrees(self.turn_sd_rad):.2f} degrees, and {1e3 * self.sd_m:.2f} mm at "
            f"{1e3 * ABOVE_M:.0f} mm above the points{warning if flat else ''}"
        )


@dataclass(frozen=True)
class Touches:
    """Touched points in the array frame and in the tracker frame [m], shapes (n, 3)."""

    array: Float
    tracker: Float


def read_touches(path: str | Path) -> Touches:
    """Read touches from a CSV or NPZ table with COLUMNS. Raises SceneError for an invalid file."""
    file = Path(path)
    columns, _ = read_table(file)
    table = pop_columns(file, columns, COLUMNS)
    return Touches(table[:, :3], table[:, 3:])


def align(touches: Touches) -> Alignment:
    """Fit rotation and shift from the tracker points to the array points, by least squares (Kabsch 1976).

    Raises SceneError for fewer than three points, points on a line, and points that do not fit. Raises SceneError also
    for mirrored axes: the points fit far better if two tracker axes are swapped or one is reversed. This is detected
    only for points that are not in one plane.
    """
    count = len(touches.array)
    if count < FEWEST:
        raise SceneError(f"{count} points were touched; needed: {FEWEST} or more that are not on one line")
    for name, points in (("array", touches.array), ("tracker", touches.tracker)):
        spread = _spread(points)
        if spread < LEAST_SPREAD_M:
            raise SceneError(
                f"the {count} points of the {name} lie within {1e3 * spread:.2g} mm of a line; give points "
                f"{1e3 * LEAST_SPREAD_M:g} mm or more away from it, because the rotation about the line is "
                "undetermined"
            )
    middle, tracked = touches.array.mean(axis=0), touches.tracker.mean(axis=0)
    turn = Rotation.align_vectors(touches.array - middle, touches.tracker - tracked)[0]
    position = middle - turn.apply(tracked)
    rest = touches.array - (turn.apply(touches.tracker) + position)
    rms = float(np.sqrt(np.mean((rest**2).sum(axis=1))))
    _refuse_mirrored(touches, rms)
    if rms > LARGEST_MISS_M:
        raise SceneError(
            f"the points are {1e3 * rms:.1f} mm from their positions (rms); allowed: {1e3 * LARGEST_MISS_M:g} mm: "
            "check their order and the unit of the tracker"
        )
    # Three coordinates per point minus six fitted parameters
    free = 3 * count - 6
    touch = TOUCH_SD_M if count == FEWEST else float(np.sqrt((rest**2).sum() / free))
    around = touches.array - middle
    inertia = np.eye(3) * (around**2).sum() - around.T @ around
    turns = touch**2 * np.linalg.inv(inertia)
    normal = np.linalg.svd(around)[2][2]
    off_plane = float(np.ptp(around @ normal))
    arm = _cross(ABOVE_M * normal)
    place = touch**2 / count * np.eye(3) + arm @ turns @ arm.T
    return Alignment(
        position_m=tuple(position.tolist()),
        quaternion=tuple(turn.as_quat(scalar_first=True).tolist()),
        points=count,
        rms_m=rms,
        touch_sd_m=touch,
        turn_sd_rad=float(np.sqrt(np.linalg.eigvalsh(turns)[-1])),
        sd_m=float(np.sqrt(np.trace(place))),
        off_plane_m=off_plane,
    )


def read_alignment(path: str | Path) -> Alignment:
    """Read the alignment from a JSON file. Raises SceneError for a file that cannot be read or has other content."""
    file = Path(path)
    with reading(file, SceneError, "a file of `palmfield track align`"):
        data = read_bytes(file, MOST_SETTINGS_BYTES)
    try:
        made = Alignment.model_validate_json(data)
    except ValidationError as error:
        raise SceneError(f"{file}: {fault_of(error)}; give a file of `palmfield track align`") from None
    length = float(np.linalg.norm(made.quaternion))
    if abs(length - 1.0) > 1e-6:
        raise SceneError(f"{file}: quaternion has length {length:g}; give one of length 1, w first")
    return made


def write_alignment(path: str | Path, alignment: Alignment) -> None:
    """Write an alignment for `read_alignment`. Raises OutputError if it cannot be written."""
    write_text(path, alignment.model_dump_json(indent=1) + "\n")


def _refuse_mirrored(touches: Touches, rms: float) -> None:
    """Raise SceneError for mirrored axes.

    If several swaps or reversals fit equally well, name the one with least rotation.
    """
    around, tracked = (points - points.mean(axis=0) for points in (touches.array, touches.tracker))
    fits = []
    for first, second in ((0, 1), (0, 2), (1, 2), (0, 0), (1, 1), (2, 2)):
        change = np.eye(3)
        change[[first, second]] = change[[second, first]] if first != second else -change[[first, second]]
        turn, residual = Rotation.align_vectors(around, tracked @ change)
        what = f"{'xyz'[first]} and {'xyz'[second]} swapped" if first != second else f"{'xyz'[first]} reversed"
        fits.append((float(turn.magnitude()), float(residual) / np.sqrt(len(around)), what))
    _, best, what = min(fits)
    if rms > 3.0 * TOUCH_SD_M and best < MIRRORED * rms:
        raise SceneError(
            f"the points are {1e3 * rms:.1f} mm from their positions (rms), and {1e3 * best:.1f} mm with {what}: "
            "the axes of the tracker are left-handed; allowed: right-handed axes: swap or reverse them in the "
            "program that writes the points"
        )


def _spread(points: Float) -> float:
    """Return the extent of the points perpendicular to their best line [m]."""
    around = points - points.mean(axis=0)
    across = around @ np.linalg.svd(around, full_matrices=True)[2][1:].T
    return float(np.linalg.norm(np.ptp(across, axis=0)))


def _cross(vector: Float) -> Float:
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
