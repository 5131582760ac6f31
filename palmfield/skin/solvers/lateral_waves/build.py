"""Choice of the waves for a slab and a load."""

import math
from dataclasses import replace

import numpy as np
from numpy.polynomial.legendre import leggauss
from scipy.special import j0

from palmfield.errors import SceneError
from palmfield.skin.approximation.load_scales import distance_to_sides, load_width, pressure_at_sides
from palmfield.skin.problem import GAUSSIAN, Body, Load, Slab, Spot, spread
from palmfield.skin.solvers.lateral_waves.march import spot_transform
from palmfield.skin.solvers.lateral_waves.modes import FaceModes, depth_problem, face_modes, still_modes
from palmfield.skin.solvers.lateral_waves.resolution import SUDDEN_1_S, Resolution
from palmfield.skin.solvers.lateral_waves.waves import (
    WaveSet,
    compute_modes,
    fourier_bessel,
    hankel,
    lattice,
    mirrored,
    polar,
    radial_rule,
    transform,
)
from palmfield.types import Float

RIM_WIDTHS = 1.6
"""Least distance of the centre of a spot from the sides, in widths; there the pressure is below 1e-3 of its peak."""
MOST_RATES = 1e7
"""Largest ratio of the fastest to the slowest rate of an overdamped wave whose poles keep their digits."""
SHORTEST = 3.0
"""Wavenumber of the shortest waves of a spot times its standard deviation."""
EVEN = 1e-6
"""Largest unevenness of a spot over a slab with rollers that moves as a column."""
AT_SIDES = 0.5
"""Largest pressure at the sides over target accuracy; the kink of the pressure at the sides is ignored."""
MODES = 0.1
"""Tolerance of the modes in depth over that of the wavenumbers; it is small, because a change of modes is a kink."""
LOOSEST = 0.03
"""Largest tolerance of the modes in depth, at wavenumbers with nearly no load."""
JUMP = 0.05
"""Factor on the tolerance of the modes after a sudden load, in the run for the error estimate. It is small because the
error of the velocity falls at best as the root of the tolerance, and sometimes is no smaller at a fifth of it."""
RINGS = 60


def refusal_lateral_waves(body: Body, load: Load) -> str | None:
    """Return the reason why solver lateral_waves cannot solve a problem, in one sentence, or None."""
    if not isinstance(body, Slab):
        return "it solves flat slabs, but this is a layer on a surface"
    if body.shape != "infinite" and body.side != "roller":
        return f"a {body.shape} with {body.side} sides has no simple lateral waves; use side='roller'"
    if body.shape == "disc" and not (isinstance(load, Spot) and is_still(load) and not load.centres().any()):
        return "on a disc it needs a stationary spot at the centre"
    for material in (sheet.material for sheet in body.sheets):
        # For waves as short as those of the load: rate of a free viscous decay times creep time
        rate = material.viscosity_Pa_s / material.density_kg_m3 * (SHORTEST / spread(load_width(load))) ** 2
        rate *= material.relaxation.viscous_time_s
        if rate > MOST_RATES:
            return (
                f"'{material.name}' has a viscosity of {material.viscosity_Pa_s:.3g} Pa s, which makes the ratio "
                f"of fastest to slowest decay rate {rate:.2g}; allowed: at most {MOST_RATES:g}: use solver 'wedges'"
            )
    if isinstance(load, Spot):
        room = float(distance_to_sides(body, load.centres()).min())
        if room < RIM_WIDTHS * load.fwhm_m and unevenness(body, load) > EVEN:
            other = "axisymmetric" if body.shape == "disc" else "wedges"
            return (
                f"the spot comes within {room:.3g} m of a side; allowed: at least {RIM_WIDTHS * load.fwhm_m:.3g} m "
                f"({RIM_WIDTHS} widths): use solver '{other}'"
            )
    return None


def unevenness(body: Slab, load: Spot) -> float:
    """Return the largest decrease of the pressure of a spot over a slab, as a share of its peak."""
    if body.shape == "infinite":
        return 1.0
    half = np.asarray(body.size_m or (body.radius_m or 0.0, 0.0)) * (0.5 if body.shape == "box" else 1.0)
    farthest = np.linalg.norm(np.abs(load.centres()) + half, axis=1).max()
    return 1.0 - float(np.exp(-GAUSSIAN * (farthest / load.fwhm_m) ** 2))


def check_sides(body: Slab, load: Load, accuracy: float) -> float:
    """Return the pressure at the sides of a slab over the peak of the spot; 0 for pressures at points.

    The wavenumbers omit this pressure. If the pressure is uniform over the slab to EVEN, its unevenness is returned.
    Raises SceneError if the result is above AT_SIDES times the target accuracy.
    """
    if not isinstance(load, Spot):
        return 0.0
    if unevenness(body, load) <= EVEN:
        return unevenness(body, load)
    share = pressure_at_sides(body, load)
    if share > AT_SIDES * accuracy:
        raise SceneError(
            f"solver 'lateral_waves': the pressure of the spot at the nearest side is {share:.2g} of its peak; "
            f"allowed: at most {AT_SIDES * accuracy:.2g} at an accuracy of {accuracy:g}: use solver 'axisymmetric' "
            "or 'wedges'"
        )
    return share


def is_still(spot: Spot) -> bool:
    centres = spot.centres()
    return bool(np.all(centres == centres[0]))


def box_images(body: Slab, points: Float) -> list[tuple[Float, Float]]:
    """Return the points of the sum of the periodic solution, (n, 2), each with signs of the vector components, (3,)."""
    if body.shape != "box" or body.size_m is None:
        return [(points, np.ones(3))]
    return mirrored(points, body.size_m)


def build_waves(
    body: Slab,
    load: Load,
    points: Float,
    horizon_s: float,
    resolution: Resolution,
    *,
    still: bool = False,
    panels: Float | None = None,
    threads: int | None = None,
    farther: bool = False,
) -> tuple[WaveSet, Float | None]:
    """Return the waves for a load on a slab, points (n, 2) and times up to horizon_s [s] after its start.

    Also returns the panels of wavenumbers of an infinite slab, with which a finer set may begin.
    still: for a static solution; farther: with one more wavenumber of a disc or box, and more modes after sudden loads
    """
    if isinstance(load, Spot):
        k_end = resolution.cut(load.fwhm_m)
        sources = load.centres()

        def profile(k: Float) -> Float:
            return spot_transform(load.fwhm_m, k)
    else:
        sources = load.points[:, :2]
        rings, sizes = ring_sizes(load.pressure_Pa * load.weights_m2, sources, nyquist(load.weights_m2))
        k_end = cut(rings, sizes, resolution.tolerance)

        def profile(k: Float) -> Float:
            return np.interp(k, rings, sizes)

    if farther and body.shape != "infinite":
        k_end += next_wavenumber(body)

    def modes_at(k: float) -> FaceModes:
        share = float(profile(np.array([k]))[0] / profile(np.zeros(1))[0])
        tolerance = MODES * min(resolution.tolerance / max(share, 1e-12), LOOSEST)
        if farther and resolution.pace_1_s > SUDDEN_1_S:
            tolerance *= JUMP
        problem = depth_problem(body, k, resolution.degrees(body, k))
        return still_modes(problem) if still else face_modes(problem, horizon_s, tolerance)

    if body.shape == "disc":
        assert isinstance(load, Spot) and body.radius_m is not None
        k, weights = fourier_bessel(body.radius_m, k_end)
        weights = weights * disc_transform(load.fwhm_m, body.radius_m, k)
        group = np.arange(len(k), dtype=np.int32)
        vectors = np.stack([k, np.zeros(len(k))], axis=1)
        return WaveSet(compute_modes(modes_at, k, threads), group, weights, vectors, np.zeros(2)), None
    if body.shape == "box":
        assert body.size_m is not None
        vectors, weights, k, group = lattice(body.size_m, k_end)
        waves = WaveSet(compute_modes(modes_at, k, threads), group, weights, vectors)
    else:
        farthest = reach(points, sources)
        rule = radial_rule(
            modes_at, profile, k_end, farthest, horizon_s, resolution.tolerance, resolution.pace, panels, threads
        )
        panels = rule.panels
        if isinstance(load, Spot) and is_still(load):
            waves = hankel(rule, sources[0])
        else:
            waves = polar(rule, resolution.angles(rule.wavenumbers, farthest))
    if isinstance(load, Spot):
        waves = replace(waves, weights=waves.weights * profile(np.linalg.norm(waves.vectors, axis=1)))
    return waves, panels


def next_wavenumber(body: Slab) -> float:
    """Return the spacing of the wavenumbers of a slab along its shortest side [rad/m]."""
    if body.shape == "disc":
        return math.pi / body.radius_m if body.radius_m else 0.0
    return math.pi / min(body.size_m) if body.size_m else 0.0


def reach(points: Float, sources: Float) -> float:
    """Return an upper bound of the distances of points from sources [m], from the box of the sources."""
    low, high = sources.min(axis=0), sources.max(axis=0)
    offsets = np.maximum(np.abs(points - low), np.abs(points - high))
    return float(np.linalg.norm(offsets, axis=1).max())


def disc_transform(fwhm_m: float, radius_m: float, k: Float) -> Float:
    """Return the integral of a centred spot times J0(k r) over the disc [m^2]; the spot ends at the rim."""
    nodes, weights = leggauss(max(200, 2 * len(k)))
    r = 0.5 * radius_m * (1.0 + nodes)
    ring = np.exp(-GAUSSIAN * (r / fwhm_m) ** 2) * 2.0 * np.pi * r * weights * 0.5 * radius_m
    return j0(np.outer(k, r)) @ ring


def nyquist(weights_m2: Float) -> float:
    """Return the wavenumber [rad/m] above which points of these areas do not determine the pressure between them."""
    return np.pi / float(np.sqrt(np.median(weights_m2)))


def ring_sizes(force: Float, points: Float, k_end: float) -> tuple[Float, Float]:
    """Return wavenumbers from 0 to k_end, and the rms over directions and times of the transform of forces (f, p)."""
    rings = np.linspace(0.0, k_end, RINGS)
    angle = np.pi * np.arange(16) / 16
    vectors = rings[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    some = force[:: max(1, len(force) // 16)]
    size = np.abs(transform(vectors.reshape(-1, 2), some, points)).reshape(RINGS, -1)
    result = np.sqrt((size**2).mean(axis=1))
    if not result.any():
        raise SceneError("traction: pressure_Pa is 0 everywhere; give a load")
    return rings, np.maximum(result, 1e-12 * result.max())


def cut(rings: Float, sizes: Float, tolerance: float) -> float:
    """Return the wavenumber above which less than `tolerance` of the load lies; the last if the load does not fall."""
    content = np.cumsum((rings * sizes**2)[::-1])[::-1]
    beyond = np.sqrt(content / content[0]) < tolerance
    return float(rings[np.argmax(beyond)] if beyond.any() else rings[-1])
