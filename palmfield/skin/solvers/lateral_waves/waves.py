"""Sets of lateral waves that compose a load, and their sum at points.

A wave set has modes in depth and a weight for each wave. The amplitude of a wave is the transform of the load at its
wavenumber. Axial waves are J0(k r) about a centre. Plane waves are e^{ik.x}, one of each pair k, -k.

Any load is a sum of steps. So nodes that integrate the step response at all times and distances are valid for any load.
The phase of the integrand for a mode w(k) changes by dw/dk t per wavenumber: the distance that its waves travel in time
t. The panels must resolve this distance plus the distance of the points. The damping of the modes limits it.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.polynomial.legendre import leggauss, legvander
from scipy.special import j0, j1, jn_zeros

from palmfield.blas import one_blas_thread
from palmfield.errors import SceneError
from palmfield.skin.solvers.lateral_waves.modes import FaceModes
from palmfield.threads import python_threads
from palmfield.types import Complex, Float, Int

NODES = 10
MOST_PANELS = 4000
MOST_LEVELS = 24
BLOCK = 4_000_000
"""Largest number of complex phases in memory."""
GRID_FROM = 64
"""Number of points from which a search for a product grid begins."""


@dataclass(frozen=True)
class RadialRule:
    """Integral over k of f(k) as sum weights f(wavenumbers).

    wavenumbers, weights: [rad/m], shape (m,); modes: modes of the face at each wavenumber
    error: estimated error relative to the integral; panels: ends of the panels [rad/m]
    """

    wavenumbers: Float
    weights: Float
    modes: tuple[FaceModes, ...]
    error: float
    panels: Float


def compute_modes(
    modes_at: Callable[[float], FaceModes], wavenumbers: Float, threads: int | None
) -> tuple[FaceModes, ...]:
    """Return the modes at each wavenumber, computed in parallel: LAPACK releases the GIL, and its matrices are too
    small for several BLAS threads."""
    with one_blas_thread, ThreadPoolExecutor(threads or python_threads()) as pool:
        return tuple(pool.map(modes_at, wavenumbers))


def step_response(modes: FaceModes, times: Float, pace_1_s: float) -> Float:
    """Return normal displacement and velocity after a unit step of pressure, shape (2, t).

    Parts of the velocity that are faster than the load, such as echoes of a pressure wave, are omitted: a slower load
    does not excite them."""
    turned = np.outer(times, modes.poles)
    moved = np.expm1(turned) / modes.poles
    slow = modes.normal / (1.0 + np.abs(modes.poles / pace_1_s) ** 2)
    return np.stack([(moved @ modes.normal).real, (np.exp(turned) @ slow).real])


def radial_rule(
    modes_at: Callable[[float], FaceModes],
    profile: Callable[[Float], Float],
    k_end: float,
    farthest_m: float,
    horizon_s: float,
    tolerance: float,
    pace: Callable[[float], float],
    panels: Float | None = None,
    threads: int | None = None,
) -> RadialRule:
    """Return the nodes from 0 to k_end [rad/m] for loads whose transform has the size profile(k).

    farthest_m: largest distance of points from the load [m]. horizon_s: largest time after the start of the load [s].
    pace: rate of change of the load at k [1/s]. panels: ends of the first panels, from a coarser rule.
    The Legendre coefficients of each panel give the error: n Gauss nodes integrate degree 2n - 1 exactly. If the
    coefficients fall geometrically, the error is about the square of the last over the first.
    Raises SceneError if MOST_PANELS are not enough.
    """
    points, weights = leggauss(NODES)
    degrees = 2.0 * np.arange(NODES) + 1.0
    to_coefficients = 0.5 * degrees[:, None] * legvander(points, NODES - 1).T * weights
    times = horizon_s * np.concatenate([2.0 ** -np.arange(9.0), [0.75, 0.875]])
    distances = farthest_m * np.array([0.0, 0.1, 0.3, 0.6, 1.0])

    def measured(low: float, high: float, k: Float, modes: tuple[FaceModes, ...]) -> tuple:
        """Return the nodes, their modes, and the integral with its error for each quantity, time and distance."""
        half = 0.5 * (high - low)
        moved = np.stack([step_response(m, times, pace(value)) for value, m in zip(k, modes, strict=True)])
        values = (k * profile(k))[:, None, None, None] * moved[..., None] * j0(np.outer(k, distances))[:, None, None, :]
        coefficients = np.abs(np.tensordot(to_coefficients, values, axes=1))
        last = coefficients[-2:].max(axis=0)
        error = 2.0 * half * last**2 / np.maximum(coefficients.max(axis=0), 1e-300)
        return k, modes, half * np.tensordot(weights, values, axes=1), error

    if panels is None:
        edges = np.linspace(0.0, k_end, max(4, int(np.ceil(k_end * farthest_m / 10.0))) + 1)
    else:
        edges = np.append(panels[panels < 0.99 * k_end], k_end)
    waiting = list(pairwise(edges))
    done: dict[tuple[float, float], tuple] = {}
    for _ in range(MOST_LEVELS):
        k = np.array([low + 0.5 * (high - low) * (1.0 + points) for low, high in waiting])
        modes = compute_modes(modes_at, k.ravel(), threads)
        for number, ends in enumerate(waiting):
            done[ends] = measured(*ends, k[number], modes[number * NODES : (number + 1) * NODES])
        total = np.abs(sum(part[2] for part in done.values()))
        # Largest displacement and velocity over the times, at each distance
        scale = total.max(axis=1, keepdims=True)
        size = {ends: float((part[3] / scale).max()) for ends, part in done.items()}
        if sum(size.values()) < tolerance:
            break
        bad = [ends for ends, value in size.items() if value > 0.5 * tolerance / len(done)]
        if len(done) + len(bad) > MOST_PANELS:
            raise SceneError(
                f"solver 'lateral_waves': {MOST_PANELS} wavenumber panels do not resolve waves over "
                f"{horizon_s:.3g} s; use a shorter time, or a material with damping"
            )
        for ends in bad:
            del done[ends]
        waiting = [part for low, high in bad for part in ((low, (low + high) / 2), ((low + high) / 2, high))]
    ordered = sorted(done)
    return RadialRule(
        np.concatenate([done[ends][0] for ends in ordered]),
        np.concatenate([0.5 * (ends[1] - ends[0]) * weights for ends in ordered]),
        tuple(mode for ends in ordered for mode in done[ends][1]),
        sum(size.values()),
        np.array([0.0, *(ends[1] for ends in ordered)]),
    )


@dataclass(frozen=True)
class WaveSet:
    """A set of waves.

    modes: modes in depth of each group of waves. group: group of each wave, shape (n,). weights: shape (n,).
    vectors: k [rad/m], shape (n, 2), of plane waves; axial waves have (k, 0).
    centre: centre of axial waves [m], shape (2,); None for plane waves."""

    modes: tuple[FaceModes, ...]
    group: Int
    weights: Float
    vectors: Float
    centre: Float | None = None

    def __len__(self) -> int:
        return len(self.group)


def hankel(rule: RadialRule, centre: Float) -> WaveSet:
    """Return the axial waves of the infinite slab: integral of k dk / 2 pi."""
    count = len(rule.wavenumbers)
    vectors = np.stack([rule.wavenumbers, np.zeros(count)], axis=1)
    weights = rule.weights * rule.wavenumbers / (2.0 * np.pi)
    return WaveSet(rule.modes, np.arange(count, dtype=np.int32), weights, vectors, centre)


def fourier_bessel(radius_m: float, k_end: float) -> tuple[Float, Float]:
    """Return wavenumbers [rad/m] with J1(k R) = 0 up to k_end, and weights of J0(k r) for the transform of a load."""
    count = int(k_end * radius_m / np.pi) + 2
    zeros = np.concatenate([[0.0], jn_zeros(1, count)])
    zeros = zeros[zeros <= max(k_end * radius_m, zeros[1])]
    return zeros / radius_m, 1.0 / (np.pi * (radius_m * j0(zeros)) ** 2)


def polar(rule: RadialRule, angles: Int) -> WaveSet:
    """Return the plane waves of the infinite slab, with weights k dk d(angle) / 4 pi^2 (trapezoid rule in angle)."""
    group, vectors, weights = [], [], []
    for number, (k, weight, count) in enumerate(zip(rule.wavenumbers, rule.weights, angles, strict=True)):
        direction = 2.0 * np.pi * np.arange(count // 2) / count
        group.append(np.full(count // 2, number, dtype=np.int32))
        vectors.append(k * np.stack([np.cos(direction), np.sin(direction)], axis=1))
        weights.append(np.full(count // 2, weight * k / (2.0 * np.pi * count)))
    return WaveSet(rule.modes, np.concatenate(group), np.concatenate(weights), np.concatenate(vectors))


def lattice(size_m: tuple[float, float], k_end: float) -> tuple[Float, Float, Float, Int]:
    """Return vectors, weights, wavenumbers and wavenumber index of plane waves with periods 2 size_m, up to k_end."""
    steps = np.pi / np.asarray(size_m)
    reach = np.ceil(k_end / steps).astype(int)
    m, n = np.meshgrid(np.arange(reach[0] + 1), np.arange(-reach[1], reach[1] + 1), indexing="ij")
    half = (m > 0) | (n >= 0)
    vectors = np.stack([m[half], n[half]], axis=1) * steps
    vectors = vectors[np.linalg.norm(vectors, axis=1) <= k_end]
    weights = np.full(len(vectors), 1.0 / (4.0 * size_m[0] * size_m[1]))
    weights[np.all(vectors == 0.0, axis=1)] *= 0.5
    lengths = np.linalg.norm(vectors, axis=1)
    different, group = np.unique(np.round(lengths / k_end, 12), return_inverse=True)
    return vectors, weights, different * k_end, group.astype(np.int32)


def mirrored(points: Float, size_m: tuple[float, float]) -> list[tuple[Float, Float]]:
    """Return the points and their images in two walls of a box, each with signs of the vector components."""
    result = []
    for across in (False, True):
        for along in (False, True):
            image, sign = points.copy(), np.ones(3)
            for axis, turned in enumerate((across, along)):
                if turned:
                    image[:, axis] = size_m[axis] - image[:, axis]
                    sign[axis] = -1.0
            result.append((image, sign))
    return result


def at_points(waves: WaveSet, part: slice, amplitude: Complex, points: Float) -> Float:
    """Return the sum of a part of the waves at points (p, 2): displacement and velocity, shape (rows, 2, p, 3).

    amplitude: normal and lateral displacement and velocity by row and wave, shape (rows, n, 4)
    """
    rows = len(amplitude)
    weighted = amplitude * waves.weights[part, None]
    result = np.empty((rows, 2, len(points), 3))
    if waves.centre is not None:
        offset = points - waves.centre
        distance = np.linalg.norm(offset, axis=1)
        outward = offset / np.maximum(distance, 1e-300)[:, None]
        turned = np.outer(waves.vectors[part, 0], distance)
        for number in range(2):
            result[:, number, :, 2] = weighted[:, :, 2 * number].real @ j0(turned)
            radial = -weighted[:, :, 2 * number + 1].real @ j1(turned)
            result[:, number, :, :2] = radial[:, :, None] * outward
        return result
    vectors = waves.vectors[part]
    lengths = np.linalg.norm(vectors, axis=1)
    cosine = 1j * vectors / np.maximum(lengths, 1e-300)[:, None]
    columns = [
        weighted[:, :, 2 * number + (0 if axis == 2 else 1)] * (1.0 if axis == 2 else cosine[:, axis])
        for number in range(2)
        for axis in range(3)
    ]
    summed = plane_sum(vectors, np.concatenate(columns), points)
    result[...] = 2.0 * np.moveaxis(summed.reshape(2, 3, rows, len(points)), (2, 0, 3, 1), (0, 1, 2, 3))
    return result


def plane_sum(vectors: Float, values: Complex, points: Float) -> Float:
    """Return the real part of sum over n of values[:, n] e^{i k_n . x}, shape (rows, p)."""
    grid = _grid(points)
    if grid is not None:
        x, y, place_x, place_y = grid
        along, turned = np.exp(1j * np.outer(x, vectors[:, 0])), np.outer(vectors[:, 1], y)
        across = np.concatenate([np.cos(turned), np.sin(turned)])
        sums = np.empty((len(values), len(points)))
        for number, row in enumerate(values):
            left = along * row
            # A real product of twice the length needs half the work of a complex product with unused imaginary part
            sums[number] = (np.concatenate([left.real, -left.imag], axis=1) @ across)[place_x, place_y]
        return sums
    result = np.empty((len(values), len(points)))
    step = max(1, BLOCK // len(vectors))
    for start in range(0, len(points), step):
        block = slice(start, start + step)
        result[:, block] = (values @ np.exp(1j * (vectors @ points[block].T))).real
    return result


def transform(vectors: Float, values: Float, points: Float) -> Complex:
    """Return the sum over p of values[:, p] e^{-i k_n . x_p}, shape (n, rows)."""
    result = np.empty((len(vectors), len(values)), dtype=complex)
    step = max(1, BLOCK // len(points))
    for start in range(0, len(vectors), step):
        block = slice(start, start + step)
        result[block] = np.exp(-1j * (vectors[block] @ points.T)) @ values.T
    return result


def _grid(points: Float) -> tuple[np.ndarray, ...] | None:
    """Return coordinates of rows and columns of a grid, and row and column of each point; None if there is no grid."""
    if len(points) < GRID_FROM:
        return None
    scale = np.abs(points).max() or 1.0
    x, place_x = np.unique(np.round(points[:, 0] / scale, 12), return_inverse=True)
    y, place_y = np.unique(np.round(points[:, 1] / scale, 12), return_inverse=True)
    return (x * scale, y * scale, place_x, place_y) if len(x) * len(y) <= 2 * len(points) else None
