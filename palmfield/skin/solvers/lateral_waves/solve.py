"""Solver lateral_waves: exact in time, for every slab whose lateral waves have a closed form."""

import time
from dataclasses import dataclass, replace

import numpy as np

from palmfield.device import resolve
from palmfield.errors import SceneError
from palmfield.skin.base import Springs
from palmfield.skin.problem import Body, Load, Motion, SkinProblem, Slab, Spot, Traction, is_pressed
from palmfield.skin.solvers.lateral_waves.build import box_images, build_waves, check_sides, refusal_lateral_waves
from palmfield.skin.solvers.lateral_waves.march import march, timeline
from palmfield.skin.solvers.lateral_waves.resolution import SERIES_FROM, choose, is_picture, pick, relative_error
from palmfield.skin.solvers.lateral_waves.waves import at_points
from palmfield.types import Complex, Float

FINER, SAFETY = 0.2, 2.0
"""Tolerance of the run for the error estimate over that of the solution, and factor on their difference. On 23 random
slabs the error was 0.7 to 1.7 times the difference; on two with weak motion it was more."""
MOMENT_SAFETY = 4.0
"""The same factor for fewer than eight times: errors at a point do not average. It was up to 2.4 at a weak point."""
PICTURE_FINER, PICTURE_SAFETY = 0.35, 2.5
"""The same two numbers for a snapshot of many points, in which weak points have little weight. On three snapshots the
error was the same as with 0.2."""
FINEST = 1e-9
RETRIES = 3
PART = 0.5
"""Tolerance of each part of the solution over the target accuracy."""


@dataclass(frozen=True)
class Settings:
    """Options of a solution: arguments of solve_lateral_waves; still: whether the solution is static."""

    tolerance: float | None
    device: str
    threads: int | None
    still: bool = False


@dataclass(frozen=True)
class Run:
    """One solution: displacement and velocity, shape (t, n, 3), and the size of its wave set."""

    displacement: Float
    velocity: Float
    waves: int
    wavenumbers: int
    poles: float
    panels: Float | None


def solve_lateral_waves(problem: SkinProblem, *, tolerance: float | None = None, threads: int | None = None) -> Motion:
    """Return the displacement and velocity of the face of a slab at points and times; see `refusal_lateral_waves`.

    tolerance: tolerance of each part (wavenumbers, angles, depth modes, omitted short waves); it switches refinement
        off. threads: number of threads on the CPU; None uses all cores.
    A second run with a fifth of the tolerance estimates the error at up to four of the points. On a disc or box it has
    one wavenumber more. For a snapshot (fewer than eight times, more than 32 points) it has a third of the tolerance,
    200 points and one error for all.
    Raises SceneError if `refusal_lateral_waves` returns a reason, and for points or an accuracy out of range.
    """
    slab = accepted(problem)
    return _solve(slab, problem, settings_of(tolerance, problem.device, threads))


def static_lateral_waves(
    body: Body,
    load: Load,
    at: Float,
    *,
    accuracy: float = 0.05,
    device: str = "cpu",
    tolerance: float | None = None,
    threads: int | None = None,
) -> Motion:
    """Return the static displacement under the load at its last time, shape (1, n, 3).

    Arguments as for solve_lateral_waves. Raises SceneError as solve_lateral_waves, and for a base without support.
    """
    problem = SkinProblem(body, last_of(load), np.ones(1), at, accuracy, device=device)
    slab = accepted(problem)
    if slab.base == "free" or (isinstance(slab.base, Springs) and slab.base.normal_Pa_m == 0.0):
        raise SceneError(
            "solver 'lateral_waves': a slab with a free base has no static solution; give a base with support"
        )
    motion = _solve(slab, problem, settings_of(tolerance, device, threads, still=True))
    return replace(motion, times_s=load.times_s[-1:])


def last_of(load: Load) -> Load:
    """Return the load with its last value, constant from time 0 on."""
    begin = np.zeros(1)
    if isinstance(load, Spot):
        return Spot(load.fwhm_m, begin, load.peak_Pa[-1:], load.centres()[-1:], "held")
    return Traction(load.points, load.weights_m2, begin, load.pressure_Pa[-1:], "held")


def accepted(problem: SkinProblem) -> Slab:
    """Return the body. Raises SceneError if `refusal_lateral_waves` returns a reason, or for a wrong accuracy."""
    problem.refuse("lateral_waves", refusal_lateral_waves)
    assert isinstance(problem.body, Slab)
    if not 1e-7 <= problem.accuracy <= 0.5:
        raise SceneError(f"accuracy is {problem.accuracy}; give a relative error from 1e-7 to 0.5")
    return problem.body


def settings_of(tolerance: float | None, device: str, threads: int | None, still: bool = False) -> Settings:
    """Return the options as Settings. Raises SceneError for a tolerance out of range."""
    if tolerance is not None and not FINEST <= tolerance <= 0.25:
        raise SceneError(f"tolerance is {tolerance}; give {FINEST} to 0.25, or omit it")
    return Settings(tolerance, resolve(device), threads, still)


def _solve(body: Slab, problem: SkinProblem, settings: Settings) -> Motion:
    begun = time.perf_counter()
    load, requested, points = problem.load, problem.times, problem.points
    at_sides = check_sides(body, load, problem.accuracy)
    if timeline(load, requested) is None or not is_pressed(load):
        still = np.zeros((len(requested), len(points), 3))
        return problem.solved(still, still.copy(), np.zeros(3), "no load yet: the motion is 0", "lateral_waves", begun)
    part = PART * problem.accuracy if settings.tolerance is None else settings.tolerance
    result = run(body, load, requested, points, part, settings)
    picture = is_picture(len(requested), len(points)) and not settings.still
    share, safety = (PICTURE_FINER, PICTURE_SAFETY) if picture else (FINER, SAFETY)
    if not picture and len(requested) < SERIES_FROM:
        safety = MOMENT_SAFETY
    for tries in reversed(range(RETRIES)):
        chosen = pick(result.displacement)
        finer = max(share * part, FINEST)
        check = run(body, load, requested, points[chosen], finer, settings, result.panels, farther=True)
        some, fine = (result.displacement[:, chosen], result.velocity[:, chosen]), (check.displacement, check.velocity)
        pairs = (*zip(some, fine, strict=True), (some[0][..., 2:], fine[0][..., 2:]))
        errors = at_sides + safety * np.array([relative_error(one, other, picture) for one, other in pairs])
        if errors[problem.judged] <= problem.accuracy or settings.tolerance is not None or part <= FINEST or tries == 0:
            break
        part = finer
        result = run(body, load, requested, points, part, settings, check.panels)
    return problem.solved(
        result.displacement,
        result.velocity,
        errors,
        f"{safety} times the difference to a run with {share} of the tolerance, at {len(chosen)} points",
        f"lateral_waves: {result.wavenumbers} wavenumbers, {result.waves} waves, {result.poles:.0f} poles each, "
        f"tolerance {part:.2g}",
        begun,
    )


def run(
    body: Slab,
    load: Load,
    requested: Float,
    points: Float,
    tolerance: float,
    settings: Settings,
    panels: Float | None = None,
    *,
    farther: bool = False,
) -> Run:
    """Return one solution at one tolerance.

    panels: initial panels, from a coarser run; farther: whether to add one wavenumber of the body beyond the spot, so
    that the run has more wavenumbers than a run with the same or a slightly larger tolerance
    """
    line = timeline(load, requested)
    assert line is not None
    horizon = float(requested[-1] - load.times_s[0])
    resolution = choose(load, tolerance)
    waves, panels = build_waves(
        body, load, points[:, :2], horizon, resolution,
        still=settings.still, panels=panels, threads=settings.threads, farther=farther,
    )  # fmt: skip
    images = box_images(body, points[:, :2])

    def to_points(part: slice, amplitude: Complex) -> Float:
        return np.sum([sign * at_points(waves, part, amplitude, image) for image, sign in images], axis=0)

    moved = march(load, line, waves, len(requested), to_points, settings.device, settings.threads)
    poles = float(np.mean([len(m.poles) for m in waves.modes]))
    return Run(moved[:, 0], moved[:, 1], len(waves), len(waves.modes), poles, panels)
