"""Choose the radial wavenumbers: Gauss panels are halved until the step response of the slab is integrated accurately.

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
from scipy.special import j0

from palmfield.blas import one_blas_thread
from palmfield.errors import SceneError
from palmfield.skin.solvers.lateral_waves.modes import FaceModes
from palmfield.threads import python_threads
from palmfield.types import Float

NODES = 10
MOST_PANELS = 4000
MOST_LEVELS = 24


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
