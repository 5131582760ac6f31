"""Layered disc under a Gaussian spot, fixed or moving: elements in r and z, harmonics in the angle, modes in time.

A spot of standard deviation s at distance d from the axis and angle phi is the sum over m of

    e_m exp(-(r^2 + d^2) / 2 s^2) I_m(r d / s^2) cos m(theta - phi),    e_0 = 1, e_m = 2

(Jacobi-Anger; Abramowitz & Stegun 9.6.34). Because the disc is round, the harmonics are independent (`element`). The
load of a harmonic is a few shapes in r times complex numbers e^{-i m phi(t)} in time. The shapes come from a POD over
the distances of the spot. A circle about the axis has a single shape. Each harmonic is reduced to some tens of vectors
between these shapes and the requested points (`reduced`). These models are integrated exactly between the times of the
load. A moving spot is sampled often enough that the load is linear in between.
"""

import math
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.special import ive

from palmfield.blas import one_blas_thread
from palmfield.errors import SceneError
from palmfield.skin.approximation.load_scales import motion_width
from palmfield.skin.approximation.richardson import differences
from palmfield.skin.base import Foundation, Springs
from palmfield.skin.fem.factor import factorise
from palmfield.skin.problem import ONLY_WEDGES, Body, Load, Motion, SkinProblem, Slab, Spot, spread
from palmfield.skin.reduction.reduced import Reduced
from palmfield.skin.reduction.reducer import reduce
from palmfield.skin.solvers.axisymmetric.element import DiscGrid, Line, graded
from palmfield.skin.solvers.axisymmetric.samples import REACH, Samples, band_of, principal_shapes, sample
from palmfield.threads import python_threads
from palmfield.types import Complex, Float

FINE = 1.8
"""Edge of the elements under the spot, in standard deviations; elements grow with distance from the spot."""
BAND_STEP = 1.25
"""Ratio of the bands of two compared runs, so that omitted motion above the band after a jump changes the result."""
SAFETY = np.array([2.0, 3.0, 2.0])
"""Error over difference from the finer run, by QUANTITIES, with margin. On 14 random discs the ratio was 0.2 to 1.6,
because the finer run has an error too. It was 2.2 for a sudden velocity on a sheet 300 times as soft as the next."""
CORNER_SAFETY = 3.0
"""The same on discs with a singular corner, where a higher degree leaves about half of the error: the ratio was 1.8 to
2.5 at degrees 4 to 6 on three discs, and 0.6 to 1.9 on three without."""
STATIC_SAFETY = 4.0
"""The same for a static solution, where errors at a point do not average over times."""
TIGHTER, TIGHTEST = 0.35, 2e-5
"""Tolerance of harmonics, path and reduced models of the finer run: share of the target accuracy, and lower limit."""
CORNER = 0.15
"""Width of an element at a singular corner over that of its neighbour (Szabo & Babuska 1991, ch. 10)."""
MOST_DEGREE = 9
RINGING_S = 1.2e-6
"""Time of a reduced model over number of resonant modes to the power 1.5 [s]. Models need 500 to 2000 vectors on large
discs with small losses; the prediction is right to a factor of 4."""
GRIDS, KEPT = 8, 160
"""Number of cached discs, and of cached reduced models of centred spots, for other time courses (0.1 to 10 MB)."""


def refusal_axisymmetric(body: Body, load: Load) -> str | None:
    """Return the reason why this solver cannot solve a problem, in a sentence, or None."""
    if not isinstance(body, Slab) or body.shape != "disc":
        return "solver 'axisymmetric' supports slabs of shape 'disc' only"
    if isinstance(body.base, Foundation):
        return ONLY_WEDGES
    if body.side == "absorbing":
        return "solver 'axisymmetric' supports sides fixed, free and roller, not absorbing"
    if not isinstance(load, Spot):
        return "solver 'axisymmetric' supports Spot loads only"
    return None


def solve_axisymmetric(
    problem: SkinProblem, *, degree: int | None = None, fine: float | None = None, harmonics: int | None = None
) -> Motion:
    """Return the motion of the face of a disc under a spot, on the CPU. The body must be a disc, the load a Spot.

    degree: polynomial degree p of the elements; fine: edge under the spot in standard deviations of the spot;
        harmonics: highest harmonic. None: the solver chooses.
    Raises SceneError if `refusal_axisymmetric` returns a reason, for points off the face, and values out of range.
    """
    begin = time.perf_counter()
    accuracy, judged, points = problem.accuracy, problem.judged, problem.points
    body, load = _accepted(problem)
    if degree is not None and degree < 4:
        raise SceneError(f"degree is {degree}; give 4 or more: lower ones lock")
    disc = _problem(body, load, problem.times, points, accuracy, harmonics)
    first = degree or first_degree(accuracy)
    band = disc.band_Hz
    # Both tolerances may give models of equal size; their difference would not show the error
    tight = max(TIGHTER * accuracy, TIGHTEST)
    tighter = replace(_problem(body, load, problem.times, points, tight, harmonics), beyond=True)
    safety = np.maximum(SAFETY, CORNER_SAFETY) if singular_corner(body) else SAFETY
    while True:
        wider = BAND_STEP * max(band, tighter.band_Hz)
        finer, result = _motions([(tighter, first + 1, wider), (disc, first, band)], fine)
        difference = safety * gap(result, finer, points)
        errors = difference + finer.dropped + tighter.path
        if degree is not None or errors[judged] <= accuracy or first >= MOST_DEGREE:
            break
        first, band = first + 2, BAND_STEP**2 * band
    return problem.solved(
        result.moved[0],
        result.moved[1],
        errors,
        f"{safety[judged]:g} times the difference to a run with all resolutions finer, degree {first + 1}: "
        f"{difference[judged]:.2g}; omitted harmonics: {finer.dropped[judged]:.2g}; path: {tighter.path:.2g}",
        f"axisymmetric, {result.elements} elements of degree {first} (r x z), {len(disc.numbers)} harmonics, "
        f"{len(disc.samples.times_s)} times",
        begin,
    )


def static_axisymmetric(body: Body, load: Load, at: Float, *, accuracy: float = 0.05) -> Motion:
    """Return the static displacement of the face of a disc under the last pressure of a spot; times_s is its last time.

    The velocity is 0. Arguments and errors as for `solve_axisymmetric`; also SceneError for a disc without support.
    """
    begin = time.perf_counter()
    problem = SkinProblem(body, load, load.times_s[-1:], at, accuracy)
    slab, spot = _accepted(problem)
    check_held(slab)
    now, points = problem.times, problem.points
    last = Spot(spot.fwhm_m, now, spot.peak_Pa[-1:], spot.centres()[-1:], "held")
    disc = _problem(slab, last, now, points, accuracy, None)
    tighter = _problem(slab, last, now, points, max(TIGHTER * accuracy, TIGHTEST), None)
    first = first_degree(accuracy)
    while True:
        finer, result = _motions([(tighter, first + 1, 0.0), (disc, first, 0.0)], None, _harmonic_at_rest)
        difference = STATIC_SAFETY * gap(result, finer, points)
        errors = difference + finer.dropped
        # A higher degree does not reduce the error of omitted harmonics
        if errors[0] <= accuracy or difference[0] <= 0.5 * accuracy or first >= MOST_DEGREE:
            break
        first += 2
    return problem.solved(
        result.moved[0],
        result.moved[1],
        errors,
        f"{STATIC_SAFETY} times the difference to a run with all resolutions finer, degree {first + 1}: "
        f"{difference[0]:.2g}; omitted harmonics: {finer.dropped[0]:.2g}",
        f"axisymmetric, static, {result.elements} elements of degree {first} (r x z), {len(disc.numbers)} harmonics",
        begin,
    )


def check_held(body: Slab) -> None:
    """Raise SceneError for a disc without support in the normal or the tangential direction."""
    base = body.base
    springs = base if isinstance(base, Springs) else Springs(0.0, 0.0)
    upright = base in ("bonded", "free_slip") or springs.normal_Pa_m > 0.0 or body.side == "fixed"
    along = base == "bonded" or springs.tangential_Pa_m > 0.0 or body.side in ("fixed", "roller")
    if not (upright and along):
        raise SceneError(
            f"a static solution needs a support: base {base} and side '{body.side}' leave this disc free to move; "
            "bond the base, give it Springs, or fix the side"
        )


def first_degree(accuracy: float) -> int:
    """Return an odd degree, because the next degree is then 2 to 50 times as accurate and shows the error."""
    return 5 if accuracy >= 0.005 else 7


def cost_axisymmetric(problem: SkinProblem) -> float:
    """Return the predicted time of `solve_axisymmetric` [s] on one core of a 2 GHz server; the same SceneErrors."""
    accuracy = problem.accuracy
    body, load = _accepted(problem)
    disc = _problem(body, load, problem.times, problem.points, accuracy, None)
    total = 0.0
    for more in (0, 1):
        degree = first_degree(accuracy) + more
        radial, depth, _ = _grid(body, load, disc.samples, degree, FINE)
        unknowns = 3.0 * radial.count * depth.count
        shifts = 4.0 + 2.0 * math.log10(1.0 / accuracy)
        each = shifts * 0.03 * (unknowns / 1500.0) ** 1.6 + 0.05 + 1e-5 * len(disc.samples.times_s)
        each += RINGING_S * ringing(body, BAND_STEP**more * disc.band_Hz) ** 1.5
        total += each * len(disc.numbers)
    return 0.1 + total


def ringing(body: Slab, band_Hz: float) -> float:
    """Return the expected number of shear modes of a harmonic below a frequency: Weyl's law for the cross-section."""
    count = 0.0
    for sheet in body.sheets:
        material, turns = sheet.material, 2.0 * math.pi * band_Hz
        if material.viscosity_Pa_s > 0.0:
            turns = min(turns, 1.0 / material.relaxation.viscous_time_s)
        area = (body.radius_m or 0.0) * sheet.thickness_m
        count += area * turns**2 * material.density_kg_m3 / material.shear_instant_Pa / (2.0 * math.pi)
    return count


@dataclass(frozen=True)
class _DiscProblem:
    """Data that all resolutions share.

    share: pressure of each harmonic over the peak; dropped: share of the omitted harmonics; path: mean error of the
    samples of the path; beyond: whether reduced models are larger than their tolerance needs
    """

    body: Slab
    load: Spot
    times: Float
    points: Float
    samples: Samples
    numbers: tuple[int, ...]
    share: Float
    dropped: float
    path: float
    tolerance: float
    band_Hz: float
    beyond: bool = False


class _Found(NamedTuple):
    """Displacement and velocity (2, t, n, 3), errors due to omitted harmonics (3,), and the grid in words."""

    moved: Float
    dropped: Float
    elements: str


def _problem(
    body: Slab, load: Spot, times: Float, points: Float, accuracy: float, harmonics: int | None
) -> _DiscProblem:
    samples = sample(load, times, 0.1 * accuracy)
    s = spread(load.fwhm_m)
    share = _shares(float(samples.distance_m.max()) / s, 1e-3 * accuracy)
    beyond = np.append(np.cumsum(share[::-1])[::-1][1:], 0.0)
    highest = int(np.argmax(beyond <= 0.05 * accuracy)) if harmonics is None else min(harmonics, len(share) - 1)
    # On the axis only the harmonics 0 and 1 have motion.
    central = not points[:, :2].any()
    numbers = tuple(range(min(highest, 1) + 1 if central else highest + 1))
    dropped = 0.0 if central and highest > 0 else float(beyond[highest])
    band = band_of(body, load, samples, 0.3 * accuracy)
    # Between two samples, the mean distance of a parabola from its chord is two thirds of the largest distance
    path = 0.1 * accuracy * 2.0 / 3.0 if load.law == "linear" and np.ptp(load.centres(), axis=0).any() else 0.0
    return _DiscProblem(body, load, times, points, samples, numbers, share, dropped, path, 0.1 * accuracy, band)


def _shares(ratio: float, least: float) -> Float:
    """Return the largest pressure of each harmonic >= least, for a spot of peak 1 at `ratio` standard deviations.

    It is the maximum over all distances from the axis: high harmonics are strongest outside the middle of a spot.
    """
    r = np.linspace(0.0, ratio + 8.0, 400)
    spot = np.exp(-0.5 * (r - ratio) ** 2)
    share = [float((spot * ive(0, r * ratio)).max())]
    while len(share) == 1 or share[-1] > least:
        share.append(2.0 * float((spot * ive(len(share), r * ratio)).max()))
    return np.array(share)


def _motions(
    runs: list[tuple[_DiscProblem, int, float]],
    fine: float | None,
    harmonic: Callable[[DiscGrid, _DiscProblem, int, float], tuple[Complex, Complex]] | None = None,
) -> list[_Found]:
    """Return the motions of several runs; a run is a problem, a degree of elements and a band of models [Hz]."""
    tasks, grids = [], []
    for problem, degree, band_Hz in runs:
        radial, depth, sheets = _grid(problem.body, problem.load, problem.samples, degree, fine or FINE)
        body = replace(problem.body, sheets=tuple(problem.body.sheets))
        breaks = (tuple(line.breaks.tolist()) for line in (radial, depth))
        grid = _disc(body, *breaks, tuple(sheets.tolist()), degree)
        grids.append(grid)
        tasks += [(grid, problem, m, band_Hz) for m in problem.numbers]
    # One BLAS thread, because the number affects the last bits, and other harmonics may change it
    with one_blas_thread, ThreadPoolExecutor(python_threads()) as pool:
        parts = pool.map(lambda task: (harmonic or _harmonic)(*task), tasks)
        result = [[next(parts) for _ in problem.numbers] for problem, _, _ in runs]
    return [_summed(run[0], grid, each) for run, grid, each in zip(runs, grids, result, strict=True)]


def _summed(problem: _DiscProblem, grid: DiscGrid, result: list[tuple[Complex, Complex]]) -> _Found:
    """Return the sum of the motions of the harmonics."""
    load, samples, points = problem.load, problem.samples, problem.points
    target = np.searchsorted(samples.times_s, problem.times - 1e-12 * samples.times_s[-1])
    after = problem.times >= load.times_s[0]
    moved = np.zeros((2, len(problem.times), len(points), 3))
    for m, parts in zip(problem.numbers, result, strict=True):
        mine = np.zeros_like(moved)
        for kind, part in enumerate(parts):
            mine[kind, after] = _turned(part[target[after]], m, points)
        moved += mine
    # Omitted harmonics are assumed to move like the last harmonic, in proportion to their share of the load
    last = np.array([_worst(part, whole) for part, whole in zip(quantities(mine), quantities(moved), strict=True)])
    dropped = last * problem.dropped / float(problem.share[problem.numbers[-1]])
    return _Found(moved, dropped, f"{grid.radial.elements} x {grid.depth.elements}")


def quantities(moved: Float) -> tuple[Float, Float, Float]:
    """Return displacement, velocity and normal displacement, (t, n, 3 or 1) each, from the motion (2, t, n, 3)."""
    return moved[0], moved[1], moved[0][..., 2:]


def gap(result: _Found, finer: _Found, points: Float) -> Float:
    """Return the relative differences of the QUANTITIES, (3,)."""
    upwards = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    return differences((result.moved[0], result.moved[1]), (finer.moved[0], finer.moved[1]), upwards)


def _worst(values: Float, all_values: Float) -> float:
    part, whole = (np.sqrt((x**2).sum(axis=(0, 2))) for x in (values, all_values))
    return float(np.max(np.divide(part, whole, out=np.zeros_like(whole), where=whole > 0.0)))


def _accepted(problem: SkinProblem) -> tuple[Slab, Spot]:
    """Return body and load. Raises SceneError if `refusal_axisymmetric` returns a reason, and for a wrong accuracy."""
    body, load = problem.body, problem.load
    problem.refuse("axisymmetric", refusal_axisymmetric)
    assert isinstance(body, Slab) and isinstance(load, Spot)
    if not 1e-4 <= problem.accuracy <= 0.5:
        raise SceneError(f"accuracy is {problem.accuracy}; give 1e-4 to 0.5")
    return body, load


def singular_corner(body: Slab) -> bool:
    """Return whether a fixed and a free boundary of a disc meet, where stresses are singular."""
    return body.side == "fixed" or (body.side == "free" and body.base not in ("free", "free_slip"))


def _grid(body: Slab, load: Spot, samples: Samples, degree: int, fine: float) -> tuple[Line, Line, np.ndarray]:
    """Return the elements in r, the elements in z, and the sheet of each element in z."""
    s = spread(motion_width(body, load))
    radius = float(body.radius_m or 0.0)
    reach = REACH * spread(load.fwhm_m)
    near, far = float(samples.distance_m.min()) - reach, float(samples.distance_m.max()) + reach
    # Waves leave the spot at frequencies up to c / (2 pi s); there the wavelength is 2 pi s
    longest = fine * s * 1.3

    def across(r: Float) -> Float:
        away = np.maximum(0.0, np.maximum(near - r, r - far))
        return np.minimum(fine * s + 0.3 * away, longest)

    ends_r = graded(radius, across)
    # A thin row of elements limits the error there
    if singular_corner(body):
        ends_r = np.insert(ends_r, -1, ends_r[-1] - CORNER * (ends_r[-1] - ends_r[-2]))
    radial = Line(ends_r, degree)
    tops, sheets, ends = 0.0, [], [0.0]
    for number, sheet in enumerate(body.sheets):
        above = tops
        cuts = graded(sheet.thickness_m, lambda z, above=above: fine * s + 0.4 * (z + above))
        ends.extend(tops + cuts[1:])
        sheets.extend([number] * (len(cuts) - 1))
        tops += sheet.thickness_m
    if singular_corner(body) and body.side == "free":
        ends.insert(-1, ends[-1] - CORNER * (ends[-1] - ends[-2]))
        sheets.append(sheets[-1])
    elif singular_corner(body):
        ends.insert(1, CORNER * ends[1])
        sheets.insert(0, 0)
    return radial, Line(-np.array(ends[::-1]), degree), np.array(sheets[::-1])


def _harmonic(grid: DiscGrid, problem: _DiscProblem, m: int, band_Hz: float) -> tuple[Complex, Complex]:
    """Return U, V, W of one harmonic at all samples and requested points: displacement and velocity, (t, n, 3)."""
    samples = problem.samples
    near, far = float(samples.distance_m.min()), float(samples.distance_m.max())
    radii, which = np.unique(np.hypot(*problem.points[:, :2].T), return_inverse=True)
    # A weak harmonic may have a larger relative error
    tolerance = problem.tolerance
    if m >= 2:
        tolerance = min(0.1, tolerance * float(problem.share.max() / problem.share[m]))
    spot = problem.load.fwhm_m, near, far, tuple(radii.tolist())
    # A moving spot has tens of models, which would remove those of stationary spots from the cache
    make = _small_cached if far == 0.0 else _small
    small, table, shares = make(grid, m, *spot, band_Hz, tolerance, problem.tolerance, problem.beyond)
    if shares is None:
        coordinates = np.ones((len(samples.times_s), 1))
    else:
        coordinates = CubicSpline(table, shares, axis=1)(samples.distance_m).T
    turning = samples.peak_Pa * np.exp(-1j * m * samples.angle_rad)
    moved = small.run(coordinates * turning[:, None], samples.times_s, samples.law)
    size = (len(samples.times_s), len(radii), 3)
    displacement, velocity = (part.reshape(size)[:, which] for part in moved)
    return displacement, velocity


def _small(
    grid: DiscGrid,
    m: int,
    fwhm_m: float,
    near_m: float,
    far_m: float,
    radii_m: tuple[float, ...],
    band_Hz: float,
    tolerance: float,
    shape_tolerance: float,
    beyond: bool,
) -> tuple[Reduced, Float, Float | None]:
    """Return the reduced model of a harmonic, which does not depend on pressure and angle of the spot over time.

    Also returns distances of the spot from the axis [m], and coordinates of its shapes there; None for one distance.
    """
    s = spread(fwhm_m)
    table = np.linspace(near_m, far_m, 2 + math.ceil(10.0 * (far_m - near_m) / s))

    def pressure(r: Float) -> Float:
        x = r[:, None] * table / s**2
        return (1.0 if m == 0 else 2.0) * np.exp(-0.5 * ((r[:, None] - table) / s) ** 2) * ive(m, x)

    system = grid.system(m)
    forces = system.spread.T @ grid.pressure_force(pressure)
    shares = None
    if far_m - near_m < 1e-9 * s:
        forces = forces[:, :1]
    else:
        forces, shares = principal_shapes(forces, shape_tolerance)
    reader = grid.face_reader(np.array(radii_m)) @ system.spread
    return reduce(system, forces, reader, (0.0, band_Hz), tolerance, beyond=beyond), table, shares


_small_cached = lru_cache(maxsize=KEPT)(_small)


@lru_cache(maxsize=GRIDS)
def _disc(
    body: Slab, radial: tuple[float, ...], depth: tuple[float, ...], sheets: tuple[int, ...], degree: int
) -> DiscGrid:
    """Return the grid with these breaks [m]; equal discs share one object, under which their models are cached."""
    return DiscGrid(body, Line(np.array(radial), degree), Line(np.array(depth), degree), np.array(sheets))


def _harmonic_at_rest(grid: DiscGrid, problem: _DiscProblem, m: int, _: float) -> tuple[Complex, Complex]:
    """Return the same as `_harmonic` for a static solution under the one sample: displacement, and velocity 0."""
    system, samples = grid.system(m), problem.samples
    s, away = spread(problem.load.fwhm_m), float(samples.distance_m[-1])

    def pressure(r: Float) -> Float:
        shape = np.exp(-0.5 * ((r - away) / s) ** 2) * ive(m, r * away / s**2)
        return ((1.0 if m == 0 else 2.0) * shape)[:, None]

    force = (system.spread.T @ grid.pressure_force(pressure))[:, 0]
    moved = factorise((system.elastic + sum(part.stiffness for part in system.parts)).tocsr()).solve(force)
    reader = grid.face_reader(np.hypot(*problem.points[:, :2].T)) @ system.spread
    turning = samples.peak_Pa[-1] * np.exp(-1j * m * samples.angle_rad[-1])
    displacement = np.asarray((reader @ moved).reshape(1, -1, 3) * turning)
    return displacement, np.zeros_like(displacement)


def _turned(harmonic: Complex, m: int, points: Float) -> Float:
    """Return vectors along x, y, z, (t, n, 3), from U, V, W, (t, n, 3), of a harmonic at points (n, 3)."""
    angle = np.arctan2(points[:, 1], points[:, 0])
    turned = harmonic * np.exp(1j * m * angle)[:, None]
    out, around, up = turned[..., 0].real, turned[..., 1].imag, turned[..., 2].real
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.stack([cosine * out - sine * around, sine * out + cosine * around, up], axis=-1)
