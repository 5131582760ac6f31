"""Rows R10, R11, R13 and R14: a letter Z, zigzags, squares and circles."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import map_coordinates

from palmfield.metrics import co_rotating_average, mse, ssim
from palmfield.stimulus import line, zigzagged
from palmfield.types import Float
from palmfield_papers.answer import Answer, Setting
from palmfield_papers.reardon2023.configuration import Course, FWHM_m, Plate, RADIUS_m, first_number, plate_of
from palmfield_papers.reardon2023.resolution import answered, level_of
from palmfield_papers.reardon2023.runs import COARSE, FINER, FULL, QUICK, GRID_m, SPACING_m, run

ZIGZAG_m = 0.16
ACROSS_m_s = 2.5
CORNER_m = 0.006
MARGIN_m = 0.003
TURNS = 5
"""Number of turns before the evaluated window of squares and circles, and number of turns in it."""
SEGMENTS = {COARSE: 24, QUICK: 32, FULL: 64, FINER: 96}
"""Number of segments of a circle, by level of resolution. With 32 segments the radius deviates by at most 0.5 %."""
ANGLES = 256
"""Number of angles on a circle at which maps are averaged."""
RING_STEP_m = 5e-4
RIDGE_m = 0.003
"""Largest change of the radius of the ridge of a spiral between two angles [m]."""
SPIRAL_TURNS = 3


def _steps(way: float, level: int, multiple: int = 1) -> int:
    return multiple * math.ceil(way / SPACING_m[level] / multiple)


# R10


def z_course(side: float, speed: float, level: int) -> Course:
    """Return a letter Z in a square: along the top, down the diagonal, along the bottom. side: of the square"""
    half = 0.5 * side
    corners = ((-half, half), (half, half), (-half, -half), (half, -half))
    return Course(corners, speed, _steps(side * (2.0 + math.sqrt(2.0)), level))


def design(course: Course, places: Float, fwhm: float = FWHM_m) -> Float:
    """Return the mean pressure of the spot over time, (n, n): a sum of Gaussians along the path at steps of 0.5 mm."""
    corners = np.array(course.corners)
    arcs = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    way = (np.arange(math.ceil(arcs[-1] / 5e-4)) + 0.5) / math.ceil(arcs[-1] / 5e-4) * arcs[-1]
    x, y = (np.interp(way, arcs, corners[:, n]) for n in range(2))
    along = [np.exp(-4.0 * math.log(2.0) * ((places[:, None] - part) / fwhm) ** 2) for part in (x, y)]
    return np.asarray(along[0] @ along[1].T / len(way))


@dataclass(frozen=True)
class Drawn:
    """Energy density [m^2/s^2] or rms velocity [m/s] of a figure, at positions [m] along both axes, shape (n, n)."""

    places_m: Float
    values: Float


@cache
def z_energy(plate: Plate, side: float, speed: float, level: int, device: str) -> Drawn:
    """Return the energy density of the Z, in the window of [metrics.mse]."""
    motion = run(plate, z_course(side, speed, level), level, device)
    shown = np.abs(motion.places_m) <= side * (1.0 + 1e-9)
    return Drawn(motion.places_m[shown], motion.energy()[np.ix_(shown, shown)])


def likeness(setting: Setting, level: int, speed: float, **changes: Any) -> tuple[float, float]:
    """Return MSE and SSIM of a letter Z relative to its design."""
    side = 0.01 * first_number(setting, "reardon_z_size")
    plate = plate_of(setting, **changes)
    drawn = z_energy(plate, side, speed, level, setting.device)
    target = design(z_course(side, speed, level), drawn.places_m, plate.fwhm_m)
    return mse(drawn.values, target), ssim(drawn.values, target)


def _both(setting: Setting, **changes: Any) -> dict[str, float]:
    level = level_of(setting)
    named = {3.0: "M 0.6", 5.0: "M 1", 7.0: "M 1.4"}
    found = {name: likeness(setting, level, speed, **changes) for speed, name in named.items()}
    return {f"{what} at {name}": one[n] for n, what in enumerate(("MSE", "SSIM")) for name, one in found.items()}


def _mse(**changes: Any) -> Callable[[Setting], Answer]:
    def number(setting: Setting, level: int) -> float:
        return likeness(setting, level, 7.0, **changes)[0] / likeness(setting, level, 3.0, **changes)[0]

    return lambda setting: answered(
        number, setting, changes=changes, margin=lambda v: v - 1.0, shown=_both(setting, **changes)
    )


def _ssim(**changes: Any) -> Callable[[Setting], Answer]:
    def number(setting: Setting, level: int) -> float:
        return likeness(setting, level, 7.0, **changes)[1] - likeness(setting, level, 3.0, **changes)[1]

    return lambda setting: answered(
        number, setting, changes=changes, margin=lambda v: -v, shown=_both(setting, **changes)
    )


# R11


def zigzag_corners(length: float, width: float, along: float, across: float) -> tuple[tuple[float, float], ...]:
    """Return the corners of strokes from the lower edge, centred [m].

    along, across: speeds along and across the length
    """
    path = zigzagged(line(length), width, width / across * along)
    return tuple((float(x), float(y)) for x, y in path.points)


def zigzag_course(width: float, along: float, level: int) -> Course:
    """Return the path of 16 cm of a zigzag."""
    speed = math.hypot(along, ACROSS_m_s)
    return Course(zigzag_corners(ZIGZAG_m, width, along, ACROSS_m_s), speed, _steps(ZIGZAG_m / along * speed, level))


@cache
def zigzag_rms(plate: Plate, width: float, along: float, level: int, device: str) -> Drawn:
    """Return the rms velocity of a zigzag from its start to its end."""
    motion = run(plate, zigzag_course(width, along, level), level, device)
    return Drawn(motion.places_m, np.sqrt(motion.energy()))


def corner_ratio(drawn: Drawn, corners: Float, chosen: Float) -> float | None:
    """Return [metrics.corner_energy]; None without corners.

    It is the largest rms velocity near the chosen corners, divided by the median elsewhere.
    """
    if len(chosen) == 0:
        return None
    x, y = np.meshgrid(drawn.places_m, drawn.places_m, indexing="ij")
    near = np.min([np.hypot(x - a, y - b) for a, b in chosen], axis=0) <= CORNER_m
    arcs = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    way = np.arange(0.0, arcs[-1], 1e-3)
    on = np.stack([np.interp(way, arcs, corners[:, n]) for n in range(2)], axis=1)
    away = np.min([np.hypot(*(on - corner).T) for corner in chosen], axis=0) > CORNER_m
    along = RegularGridInterpolator((drawn.places_m, drawn.places_m), drawn.values)(on[away])
    return float(drawn.values[near].max() / np.median(along))


def corners_at(setting: Setting, level: int, along: float, *, every: bool = False, **changes: Any) -> float | None:
    """Return the corner ratio at a speed along the path. every: whether to include the first and the last turn"""
    width = 0.01 * first_number(setting, "reardon_zigzag")
    drawn = zigzag_rms(plate_of(setting, **changes), width, along, level, setting.device)
    corners = np.array(zigzag_corners(ZIGZAG_m, width, along, ACROSS_m_s))
    turns = corners[1:-1]
    return corner_ratio(drawn, corners, turns if every else turns[1:-1])


def _corner_number(setting: Setting, level: int) -> float:
    found = [corners_at(setting, level, along) for along in (5.0, 6.0)]
    return min(one for one in found if one is not None)


def corner_answer(setting: Setting) -> Answer:
    """Return the answer of entry R11f."""
    level = level_of(setting)
    shown = {}
    for along in (3.0, 4.0, 5.0, 6.0):
        for every, what in ((False, "inner turns"), (True, "all turns")):
            one = corners_at(setting, level, along, every=every)
            if one is not None:
                shown[f"{along:g} m/s, {what}"] = one
    if corners_at(setting, level, 5.0) is None or corners_at(setting, level, 6.0) is None:
        note = "16 cm of this zigzag have only the first and the last turn"
        return Answer(None, note=note, shown=shown)
    return answered(_corner_number, setting, margin=lambda v: v - 1.0, note="the lesser of 5 and 6 m/s", shown=shown)


# R13


def square_course(side: float, speed: float, level: int) -> Course:
    """Return ten turns round a square."""
    half = 0.5 * side
    corners = ((-half, -half), (half, -half), (half, half), (-half, half), (-half, -half))
    steps = TURNS * _steps(4.0 * side, level, 4)
    return Course(corners, speed, 2 * steps, turns=2 * TURNS, skipped=steps)


@cache
def square_rms(plate: Plate, side: float, speed: float, level: int, device: str) -> Drawn:
    """Return the rms velocity over the last five of ten turns."""
    motion = run(plate, square_course(side, speed, level), level, device)
    return Drawn(motion.places_m, np.sqrt(motion.energy()))


def inside_mm(drawn: Drawn, side: float) -> float:
    """Return the distance of the largest rms velocity from a square path [mm], positive inside."""
    row, column = np.unravel_index(drawn.values.argmax(), drawn.values.shape)
    x, y = abs(drawn.places_m[row]), abs(drawn.places_m[column])
    half = 0.5 * side
    outside = math.hypot(max(x - half, 0.0), max(y - half, 0.0))
    return 1e3 * (-outside if outside > 0.0 else min(half - x, half - y))


def interior_maxima(drawn: Drawn, side: float) -> int:
    """Return [metrics.interior_maximum]: number of local maxima at least 3 mm inside a square."""
    values = drawn.values
    middle = values[1:-1, 1:-1]
    around = [
        values[1 + i : len(values) - 1 + i, 1 + j : len(values) - 1 + j]
        for i in (-1, 0, 1)
        for j in (-1, 0, 1)
        if i or j
    ]
    largest = (middle > np.max(around, axis=0)).nonzero()
    x, y = (drawn.places_m[1:-1][part] for part in largest)
    return int((np.maximum(np.abs(x), np.abs(y)) <= 0.5 * side - MARGIN_m + 1e-9).sum())


def _of_square(setting: Setting, level: int, speed: float, **changes: Any) -> Drawn:
    return square_rms(plate_of(setting, **changes), 0.03, speed, level, setting.device)


def _place(**changes: Any) -> Callable[[Setting], Answer]:
    def number(setting: Setting, level: int) -> float:
        return inside_mm(_of_square(setting, level, 8.0, **changes), 0.03)

    return lambda setting: answered(
        number, setting, changes=changes, margin=lambda v: v - 3.0, resolution=0.5e3 * GRID_m
    )


def _maxima(**changes: Any) -> Callable[[Setting], Answer]:
    def number(setting: Setting, level: int) -> float:
        return float(min(interior_maxima(_of_square(setting, level, v, **changes), 0.03) for v in (9.0, 10.0)))

    def answer(setting: Setting) -> Answer:
        shown = {
            f"{v:g} m/s": float(interior_maxima(_of_square(setting, level_of(setting), v, **changes), 0.03))
            for v in (8.0, 9.0, 10.0)
        }
        return answered(number, setting, changes=changes, margin=lambda v: v - 1.0, shown=shown)

    return answer


# R14


@dataclass(frozen=True)
class Circled:
    """Rms velocity and mean in the rotating frame of a circle.

    radii_m: shape (r,)
    ring: mean over angle of the rms velocity [m/s], shape (r,)
    spiral: mean velocity in the frame of the focus [m/s], by radius and by angle behind the focus (ANGLES per turn),
        (r, a)
    map: rms velocity on the grid
    """

    radii_m: Float
    ring: Float
    spiral: Float
    map: Drawn


def circle_course(radius: float, speed: float, level: int) -> Course:
    """Return ten turns round a circle, counter-clockwise."""
    count = SEGMENTS[level]
    angle = 2.0 * math.pi * np.arange(count + 1) / count
    corners = tuple((radius * math.cos(a), radius * math.sin(a)) for a in angle[:-1])
    around = (*corners, corners[0])
    # The chords are shorter than the arcs; the focus is slower by the same factor, so that a turn has the same duration
    chord = count * math.sin(math.pi / count) / math.pi
    return Course(around, speed * chord, 2 * TURNS * count, turns=2 * TURNS, skipped=TURNS * count)


@cache
def circled(plate: Plate, radius: float, speed: float, level: int, device: str) -> Circled:
    """Return the maps of a circle over the last five of ten turns."""
    motion = run(plate, circle_course(radius, speed, level), level, device)
    rms = np.sqrt(motion.energy())
    radii = np.asarray(RING_STEP_m * np.arange(int(RADIUS_m / RING_STEP_m) + 1), dtype=float)
    angle = 2.0 * math.pi * np.arange(ANGLES) / ANGLES
    step = motion.places_m[1] - motion.places_m[0]
    at = (np.stack([np.outer(radii, np.cos(angle)), np.outer(radii, np.sin(angle))]) - motion.places_m[0]) / step
    ring = map_coordinates(rms, at, order=1).mean(axis=1)
    polar = np.stack([map_coordinates(one, at, order=1) for one in motion.velocity]).astype(float)
    turn_Hz = speed / (2.0 * math.pi * radius)
    behind = -2.0 * math.pi * np.arange(ANGLES) / ANGLES
    spiral = co_rotating_average(motion.times_s, polar, turn_Hz, behind)
    return Circled(radii, ring, spiral, Drawn(motion.places_m, rms))


def ring_radius(one: Circled, path: float) -> float:
    """Return [metrics.circle_maps].ring [m]: radius, not beyond the path, of the largest mean over angle."""
    inside = one.radii_m <= path * (1.0 + 1e-9)
    return float(one.radii_m[inside][one.ring[inside].argmax()])


def quiet_radius(one: Circled, path: float, level: float) -> float:
    """Return [metrics.circle_maps].quiescent_disc [m].

    It is the largest radius up to which the mean is below a fraction of the ring; 0 if the centre is above it.
    """
    inside = one.radii_m <= path * (1.0 + 1e-9)
    loud = np.flatnonzero(one.ring >= level * one.ring[inside].max())
    return float(one.radii_m[max(loud[0] - 1, 0)])


def spiral_length(one: Circled, path: float) -> float:
    """Return [metrics.circle_maps].spiral_wake [m]: arc length behind the focus along which the ridge is above 10 %.

    The ridge begins at the largest magnitude that is at most one spot width behind the focus and 3 mm from the path,
    because the centre of a moving dent has no velocity. From angle to angle, it follows the largest magnitude within 3
    mm of radius. It ends at the rim of the slab or after three turns. The result is 0 if no magnitude reaches 10 %.
    """
    size = np.abs(one.spiral)
    most = float(size.max())
    reach = round(RIDGE_m / RING_STEP_m)
    here = int(np.argmin(np.abs(one.radii_m - path)))
    count = size.shape[1]
    near = math.ceil(FWHM_m / (2.0 * math.pi * path) * count)
    begin = int(size[here - reach : here + reach + 1, : near + 1].max(axis=0).argmax())
    for n in range(begin, SPIRAL_TURNS * count):
        low = max(0, here - reach)
        here = low + int(size[low : here + reach + 1, n % count].argmax())
        if size[here, n % count] < 0.1 * most or here >= len(one.radii_m) - 1:
            return 2.0 * math.pi * path * n / count if n > begin else 0.0
    return 2.0 * math.pi * path * SPIRAL_TURNS


def path_radius(setting: Setting) -> float:
    """Return the radius of the circle [m]."""
    return 0.01 * first_number(setting, "reardon_circle")


def _circle(setting: Setting, level: int, speed: float, **changes: Any) -> Circled:
    return circled(plate_of(setting, **changes), path_radius(setting), speed, level, setting.device)


def rings_mm(setting: Setting, level: int, **changes: Any) -> list[float]:
    """Return the radius of the ring at 5, 7 and 10 m/s [mm]."""
    return [1e3 * ring_radius(_circle(setting, level, v, **changes), path_radius(setting)) for v in (5.0, 7.0, 10.0)]


def _shrinks(**changes: Any) -> Callable[[Setting], Answer]:
    def number(setting: Setting, level: int) -> float:
        return float(-np.diff(rings_mm(setting, level, **changes)).max())

    def answer(setting: Setting) -> Answer:
        of = rings_mm(setting, level_of(setting), **changes)
        shown = {f"{v:g} m/s [mm]": one for v, one in zip((5.0, 7.0, 10.0), of, strict=True)}
        note = "the least decrease from one speed to the next [mm]; no decrease is none"
        # Radii have a resolution of 0.5 mm: a constant radius does not count as decreasing
        return answered(
            number, setting, changes=changes, margin=lambda v: v - 0.5 * 1e3 * RING_STEP_m, note=note, shown=shown,
            resolution=1e3 * RING_STEP_m,
        )  # fmt: skip

    return answer


def _quiet(**changes: Any) -> Callable[[Setting], Answer]:
    def number(setting: Setting, level: int) -> float:
        path = path_radius(setting)
        share = 0.01 * first_number(setting, "reardon_quiet")
        return quiet_radius(_circle(setting, level, 10.0, **changes), path, share) / path

    def answer(setting: Setting) -> Answer:
        one = _circle(setting, level_of(setting), 10.0, **changes)
        shown = {
            "in the middle, over the ring": float(
                one.ring[0] / one.ring[: round(path_radius(setting) / RING_STEP_m) + 1].max()
            )
        }
        resolution = 0.5 * RING_STEP_m / path_radius(setting)
        return answered(number, setting, changes=changes, shown=shown, resolution=resolution)

    return answer


def spirals_m(setting: Setting, level: int, **changes: Any) -> dict[float, float]:
    """Return the length of the spiral wake by speed [m]."""
    path = path_radius(setting)
    return {v: spiral_length(_circle(setting, level, v, **changes), path) for v in (3.0, 5.0, 7.0, 10.0)}


def _spiral(**changes: Any) -> Callable[[Setting], Answer]:
    def number(setting: Setting, level: int) -> float:
        of = spirals_m(setting, level, **changes)
        least = 2.0 * math.pi * path_radius(setting) / ANGLES
        return min(of[5.0], of[7.0], of[10.0]) / max(of[3.0], least)

    def answer(setting: Setting) -> Answer:
        shown = {f"{v:g} m/s [cm]": 100.0 * one for v, one in spirals_m(setting, level_of(setting), **changes).items()}
        return answered(
            number, setting, changes=changes, margin=lambda v: v - 1.0, note="the least of 5, 7 and 10 m/s", shown=shown
        )

    return answer


VARIED = {
    "R10a": _mse, "R10b": _ssim, "R13c": _place, "R13d": _maxima, "R14a": _shrinks, "R14b": _quiet, "R14c": _spiral,
}  # fmt: skip
"""Answers for slabs with changed fields, to find causes."""
ANSWERS = {**{name: make() for name, make in VARIED.items()}, "R11f": corner_answer}
