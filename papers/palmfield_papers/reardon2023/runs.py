"""Run the slab, with results cached by inputs, and compute quantities for all answers."""

import math
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
from numpy.typing import NDArray

from palmfield.metrics import energy_density
from palmfield.skin import Spot
from palmfield.skin.solvers.lateral_waves.fields import PeriodicSlab, WalledDisc
from palmfield.types import Float, Float32
from palmfield_papers.reardon2023.configuration import PASCAL, Course, Plate, RADIUS_m

COARSE, QUICK, FULL, FINER = range(4)
"""Levels of resolution. Answers are computed at QUICK or FULL, and their errors from COARSE or FINER."""
TOLERANCE = {COARSE: 5e-2, QUICK: 2e-2, FULL: 1e-2, FINER: 3e-3}
"""Tolerance of the truncation of short waves."""
MODES = {COARSE: 2e-2, QUICK: 2e-2, FULL: 1e-2, FINER: 3e-3}
"""Tolerance of the modes in depth, which is the same for COARSE and QUICK."""
FRONTS = {COARSE: 0.7, QUICK: 1.0, FULL: 1.6}
"""Speed of the fastest waves of periodic image loads that must not arrive, relative to the shear speed.

On a free slab, the fastest waves have twice the shear speed and little energy. On a bonded slab no wave is faster than
shear waves.
"""
PERIODS_m = {COARSE: (0.35, 0.7), QUICK: (0.35, 0.7), FULL: (0.4, 0.8)}
"""Periods of lattices. Each lattice contains the waves of the previous one.

In very long runs, waves of image loads arrive.
"""
LOSSY_Pa_s, PERIOD_OF_LOSSY_m = 1.0, 0.5
"""Loss from which a smaller period is used in quick runs of bonded slabs, and this period.

With 0.5 m instead of 0.8 m, passes at 2, 7 and 11 m/s change by at most 0.1 % of the largest velocity.
"""
OTHER_PERIOD, WIDEST_m = 1.5, 1.2
"""Factor of the period in FINER relative to FULL, and the largest period. The error then includes the period."""
SPACING_m = {COARSE: 4e-3, QUICK: 3e-3, FULL: 1.5e-3, FINER: 1e-3}
"""Largest distance of the focus between two samples [m]."""
LONGEST_s = {COARSE: 5e-4, QUICK: 4e-4, FULL: 2.5e-4, FINER: 2e-4}
"""Longest time between two samples of a straight run [s]. Spectra then reach 1 kHz."""
DEPTH_m_s = {COARSE: 11.0, QUICK: 11.0, FULL: 11.0, FINER: 20.0}
"""Speed for which modes in depth are resolved, for any focus. At 20 m/s, a value of 11 changes energies by 1e-4."""
GRID_m = 1e-3
BLOCK = 64
"""Number of rows of a map whose energy is computed together."""


@dataclass(frozen=True)
class Motion:
    """Result of a run.

    It has the normal velocity of the face [m/s], shape (t, n, n), at times [s] and positions [m]. Outside the slab it
    is 0.
    """

    times_s: Float
    places_m: Float
    velocity: Float32

    def energy(self) -> Float:
        """Return the energy density of `palmfield.metrics` over the samples [m^2/s^2], shape (n, n)."""
        parts = range(0, len(self.places_m), BLOCK)
        return np.concatenate([energy_density(self.times_s, self.velocity[:, n : n + BLOCK]) for n in parts])

    def largest(self, first: int = 0) -> float:
        """Return the largest magnitude from a sample onwards [m/s]."""
        return float(np.abs(self.velocity[first:]).max())


def period_for(plate: Plate, seconds: float, level: int) -> float:
    """Return the period of the lattice for a run of some duration [m]."""
    if level == FINER:
        return min(OTHER_PERIOD * period_for(plate, seconds, FULL), WIDEST_m)
    if level < FULL and plate.back == "bonded" and plate.viscosity_Pa_s >= LOSSY_Pa_s:
        return PERIOD_OF_LOSSY_m
    needed_m = 0.22 + plate.shear_speed_m_s * (FRONTS[level] if plate.back == "free" else 1.0) * seconds
    return next((period for period in PERIODS_m[level] if period >= needed_m - 1e-9), PERIODS_m[level][-1])


@lru_cache(maxsize=8)
def endless(plate: Plate, period_m: float, level: int) -> PeriodicSlab:
    """Return the waves of the infinite slab."""
    return PeriodicSlab(
        plate.slab,
        plate.fwhm_m,
        period_m=period_m,
        tolerance=TOLERANCE[level],
        horizon_s=0.1,
        speed_m_s=DEPTH_m_s[level],
        modes_tolerance=MODES[level],
    )


@lru_cache(maxsize=4)
def walled(plate: Plate, level: int) -> WalledDisc:
    """Return the waves of the slab within its rim."""
    return WalledDisc(
        plate.slab,
        plate.fwhm_m,
        tolerance=TOLERANCE[level],
        horizon_s=0.1,
        speed_m_s=DEPTH_m_s[level],
        modes_tolerance=MODES[level],
    )


def sampled(course: Course) -> tuple[Float, Spot, float]:
    """Return sample times [s] without the start, the moving spot (width 1 m), and the end of its path [s]."""
    corners = np.array(course.corners)
    way = np.vstack([corners, *[corners[1:]] * (course.turns - 1)])
    arcs = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1))]) / course.speed_m_s
    end = float(arcs[-1])
    step = end / course.steps
    times = np.asarray(
        step * np.arange(course.skipped + 1, course.steps + 1 + round(course.still_after_s / step)), dtype=float
    )
    if course.rate_Hz is None:
        places = np.stack([np.interp(arcs, arcs, way[:, n]) for n in range(2)], axis=1)
        load = Spot(1.0, arcs, np.full(len(arcs), PASCAL), places)
    else:
        ticks = np.arange(math.ceil(end * course.rate_Hz - 1e-9)) / course.rate_Hz
        places = np.stack([np.interp(ticks, arcs, way[:, n]) for n in range(2)], axis=1)
        load = Spot(1.0, ticks, np.full(len(ticks), PASCAL), places, "held")
    return times, load, end


def focus_at(course: Course, seconds: float) -> Float:
    """Return the position of a continuously moving focus [m], shape (2,)."""
    corners = np.array(course.corners)
    arcs = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    way = seconds * course.speed_m_s
    way = way % arcs[-1] if course.turns > 1 else way
    return np.array([np.interp(way, arcs, corners[:, n]) for n in range(2)])


def run(plate: Plate, course: Course, level: int, device: str, times_s: Float | None = None) -> Motion:
    """Return the motion at the samples of the course, or at other times [s]. It is large, so it is not cached."""
    times, spot = _requested(plate, course, times_s)
    if plate.rim == "reflecting":
        disc = walled(plate, level)
        places = disc.places(GRID_m)
        velocity = disc.normal_velocity(spot, times, spacing_m=GRID_m, device=device)
    else:
        slab, cells = _lattice(plate, float(times[-1]), level)
        places = slab.places(RADIUS_m, cells)
        velocity = slab.normal_velocity(spot, times, half_m=RADIUS_m, cells=cells, device=device)
    velocity[:, _off(places)] = 0.0
    return Motion(times, places, velocity)


def line_run(plate: Plate, course: Course, level: int, device: str, snapshot: int) -> tuple[Motion, Float32]:
    """Return the motion of an infinite slab at one sample, and along y = 0 at all samples, shape (t, n)."""
    times, spot = _requested(plate, course, None)
    slab, cells = _lattice(plate, float(times[-1]), level)
    places = slab.places(RADIUS_m, cells)
    chosen = np.array([snapshot], dtype=np.int32)
    line, velocity = slab.line_and_maps(spot, times, chosen, half_m=RADIUS_m, cells=cells, device=device)
    velocity[:, _off(places)] = 0.0
    return Motion(times, places, velocity), line


def _requested(plate: Plate, course: Course, times_s: Float | None) -> tuple[Float, Spot]:
    """Return the times of the result, and the spot with the width of the plate."""
    times, load, end = sampled(course)
    ends, peaks, centres = load.times_s, load.peak_Pa, load.centres()
    if course.still_after_s > 0.0:
        if course.rate_Hz is not None:
            raise ValueError("a focus that is held between moves cannot be followed by silence")
        # A line to level 0 within a microsecond
        ends = np.append(ends, end + 1e-6)
        peaks, centres = np.append(peaks, 0.0), np.vstack([centres, centres[-1:]])
    return times if times_s is None else times_s, Spot(plate.fwhm_m, ends, peaks, centres, load.law)


def _lattice(plate: Plate, seconds: float, level: int) -> tuple[PeriodicSlab, int]:
    period = period_for(plate, seconds, level)
    return endless(plate, period, level), round(period / GRID_m)


def _off(places: Float) -> NDArray[np.bool_]:
    """Return which points of the square are outside the slab."""
    return np.asarray(np.hypot(*np.meshgrid(places, places, indexing="ij")) > RADIUS_m * (1.0 + 1e-9))


@dataclass(frozen=True)
class Straight:
    """Quantities of a straight run along +x. Maps are at places_m along both axes [m], shape (n, n).

    length_m: length of the path, which is centred
    energy: energy density of the whole run
    at_12_cm, at_seven_eighths: snapshots of the normal velocity when the focus is there
    largest: largest magnitude in the second half of the path
    end_s: end of the path [s]
    track: velocity at times_s, at grid points of the middle half of the path, shape (t, k)
    """

    length_m: float
    places_m: Float
    energy: Float
    at_12_cm: Float
    at_seven_eighths: Float
    largest: float
    end_s: float
    times_s: Float
    track: Float

    def focus_x(self, share: float) -> float:
        """Return the position of the focus after a fraction of the path [m]."""
        return self.length_m * (share - 0.5)


def straight_course(speed_m_s: float, length_m: float, level: int) -> Course:
    """Return a path from -x to +x through the centre, with samples at most 0.5 ms apart."""
    steps = max(length_m / SPACING_m[level], length_m / speed_m_s / LONGEST_s[level])
    half = 0.5 * length_m
    # 12 of 16 cm and 17.5 of 20 cm are among these samples
    return Course(((-half, 0.0), (half, 0.0)), speed_m_s, 40 * math.ceil(steps / 40.0))


@cache
def straight(plate: Plate, speed_m_s: float, length_m: float, level: int, device: str) -> Straight:
    """Return a straight run, cached."""
    course = straight_course(speed_m_s, length_m, level)
    motion = run(plate, course, level, device)
    end = length_m / speed_m_s
    middle = np.abs(motion.places_m) <= 0.25 * length_m * (1.0 + 1e-9)
    row = int(np.abs(motion.places_m).argmin())

    def at(way: float) -> Float:
        return motion.velocity[int(np.abs(motion.times_s - way / speed_m_s).argmin())].astype(float)

    return Straight(
        length_m, motion.places_m, motion.energy(), at(0.12), at(0.875 * length_m), motion.largest(course.steps // 2),
        end, motion.times_s, motion.velocity[:, middle, row].astype(float),
    )  # fmt: skip
