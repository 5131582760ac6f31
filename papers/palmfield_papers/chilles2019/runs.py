"""Compute motions of the face of the slab per pascal, cached by their inputs."""

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from palmfield.instruments import SurfaceMotion, of_motion
from palmfield.skin import Motion, solve
from palmfield.skin.solver_choice import Name
from palmfield.types import Float
from palmfield_papers.chilles2019.setup import (
    CIRCLE_RADIUS_M,
    RADIUS_M,
    RECORD_S,
    STIMULUS_S,
    Case,
    Stimulus,
    load_of,
    slab_of,
)

RATE_HZ, ENDLESS_RATE_HZ, JUMP_RATE_HZ, JUMP_S = 32e3, 8e3, 128e3, 2e-3
"""Sampling rates of traces, and rates and duration of denser samples near start and end of the stimulus.

Pressure waves, which are hardly damped, return to the centre from a rim, but not on the infinite slab.
"""
QUICK_CIRCLE_RATE_HZ = 16e3
"""Rate of traces under the moving spot in quick runs."""
MAP_RATE_HZ = 8e3
LOSSLESS: dict[str, Any] = {"degree": 5}
"""Resolution for the printed characteristic time. Without losses all modes ring, and finer runs take many minutes.

The error includes the effect of this resolution.
"""
LOSSLESS_ACCURACY, LOSSLESS_QUICK = 0.02, 0.1
ANGLES = 12
"""Number of points on each circle, with the first on the x axis. The rms varies slowly with angle."""
GROUP = 241
"""Largest number of points of a disc that are solved together. More points need over 4 GB of memory."""
OBSERVERS = {"step": (0.0, 0.0), "stm": (CIRCLE_RADIUS_M, 0.0)}


@dataclass(frozen=True)
class Run:
    """Motion of points of the face per pascal of peak pressure.

    error: relative error of the displacement, by the solver
    """

    motion: SurfaceMotion
    error: float


def trace_times(case: Case, stimulus: Stimulus) -> Float:
    """Return the times of a trace [s], denser near jumps of the load, where velocities jump too."""
    rate = ENDLESS_RATE_HZ if case.side == "infinite" else RATE_HZ
    if case.quick and stimulus == "stm":
        rate = min(rate, QUICK_CIRCLE_RATE_HZ)
    near = np.arange(round(JUMP_S * JUMP_RATE_HZ) + 1) / JUMP_RATE_HZ
    before = STIMULUS_S - np.arange(5) / JUMP_RATE_HZ
    even = np.arange(round(RECORD_S * rate) + 1) / rate
    return np.unique(np.round(np.concatenate([even, near, before, STIMULUS_S + near]), 9))


def map_times() -> Float:
    return np.arange(round(RECORD_S * MAP_RATE_HZ) + 1) / MAP_RATE_HZ


def by_differences(motion: Motion) -> Motion:
    """Replace velocities by central differences of displacements, at evenly spaced times.

    After a jump of the load, velocities of the solver contain oscillations at kilohertz, which the times of a map do
    not resolve. The integral of these velocities would drift. Sums of differences do not drift.
    """
    return replace(motion, velocity_m_s=np.gradient(motion.displacement_m, motion.times_s, axis=0))


def _solved(case: Case, stimulus: Stimulus, times_s: Float, at_m: Float, accuracy: float) -> Motion:
    solver: Name = "lateral_waves" if case.side == "infinite" else "axisymmetric"
    lossless = case.material == "tau_printed" and case.side != "infinite"
    pinned = LOSSLESS if lossless else {}
    if lossless:
        accuracy = max(accuracy, LOSSLESS_QUICK if case.quick else LOSSLESS_ACCURACY)
    # Time 0 is rest, which needs no solution
    motion = solve(
        slab_of(case), load_of(stimulus, case.fwhm_m, case.circle_m), times_s[1:], at_m,
        solver=solver, accuracy=accuracy, device=case.device, **pinned,
    )  # fmt: skip
    still = np.zeros((1, len(at_m), 3))
    return replace(
        motion,
        times_s=times_s,
        displacement_m=np.concatenate([still, motion.displacement_m]),
        velocity_m_s=np.concatenate([still, motion.velocity_m_s]),
    )


def at_observer(case: Case, stimulus: Stimulus) -> Run:
    """Return the motion at the point of the traces in the paper: the centre, or (10 mm, 0) under the moving spot."""
    return _at_observer(replace(case, level_Pa=1.0), stimulus)


@cache
def _at_observer(case: Case, stimulus: Stimulus) -> Run:
    place = np.array([OBSERVERS["stm" if stimulus == "stm" else "step"]])
    motion = _solved(case, stimulus, trace_times(case, stimulus), place, case.accuracy)
    return Run(of_motion(motion, slab_of(case)), motion.displacement_error)


def along_radius(case: Case, stimulus: Stimulus) -> Run:
    """Return the motion of points on the x axis, 1 mm apart from centre to rim, under a spot in the centre."""
    return _along_radius(replace(case, level_Pa=1.0), stimulus)


@cache
def _along_radius(case: Case, stimulus: Stimulus) -> Run:
    fixed = case.side == "fixed"
    radii = np.arange(round(1e3 * RADIUS_M) + (0 if fixed else 1)) * 1e-3
    at = np.column_stack([radii, np.zeros_like(radii)])
    # The error is that of the worst point, and near a fixed rim motion is small: with twice the error of a quick
    # run the map within 30 mm changes by 0.1 % for a fifth of the time
    motion = _solved(case, stimulus, map_times(), at, (4.0 if case.quick else 2.0) * case.accuracy)
    if fixed:
        rim = np.zeros((len(motion.times_s), 1, 3))
        motion = replace(
            motion,
            points=np.concatenate([motion.points, [[RADIUS_M, 0.0, 0.0]]]),
            displacement_m=np.concatenate([motion.displacement_m, rim], axis=1),
            velocity_m_s=np.concatenate([motion.velocity_m_s, rim], axis=1),
        )
    return Run(of_motion(by_differences(motion), slab_of(case)), motion.displacement_error)


def on_circles(case: Case) -> Run:
    """Return the motion of the centre and of circles under the moving spot.

    Each of `circle_radii` has ANGLES points.
    """
    return _on_circles(replace(case, level_Pa=1.0))


def circle_radii(quick: bool) -> Float:
    """Return radii [m] from near the centre to near the rim, finer near the path.

    21 mm is the first radius beyond 20 mm on a grid of 1 mm. On this grid, row C21c searches the maximum.
    """
    path = (
        np.arange(2.0, 21.0, 2.0) if quick else np.concatenate([[2.0, 4.0], np.arange(5.0, 15.5), [16.0, 18.0, 20.0]])
    )
    return 1e-3 * np.concatenate([path, [21.0], np.arange(24.0, 57.0, 4.0)])


@cache
def _on_circles(case: Case) -> Run:
    angles = 2.0 * np.pi * np.arange(ANGLES) / ANGLES
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    points = np.concatenate([[[0.0, 0.0]], (circle_radii(case.quick)[:, None, None] * circle).reshape(-1, 2)])
    times = map_times()
    group = len(points) if case.side == "infinite" else GROUP
    parts = [
        _solved(case, "stm", times, points[first : first + group], (4.0 if case.quick else 2.0) * case.accuracy)
        for first in range(0, len(points), group)
    ]
    whole = replace(
        parts[0],
        points=np.concatenate([part.points for part in parts]),
        displacement_m=np.concatenate([part.displacement_m for part in parts], axis=1),
        velocity_m_s=np.concatenate([part.velocity_m_s for part in parts], axis=1),
    )
    return Run(of_motion(by_differences(whole), slab_of(case)), max(part.displacement_error for part in parts))
