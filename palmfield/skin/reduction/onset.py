"""What the whole layer's substeps make of a load that begins: their error over the spectrum of its onset.

A load that starts at once holds all frequencies, falling as 1 / f; the main one says nothing of it. The scheme's exact
answer by frequency (palmfield.skin.fem.solver) is taken on a small model, so that some hundred of them cost one real
factorisation.
"""

import math

import numpy as np

from palmfield.skin.fem.assembly import SkinSystem
from palmfield.skin.fem.solver import discrete_weights
from palmfield.skin.reduction.dynamic_stiffness import DynamicStiffness
from palmfield.skin.reduction.krylov import Krylov
from palmfield.types import Float

WINDOW_S = 0.05
"""After the onset, over which its error counts [s]."""
VECTORS = 48
"""Of the small model: three times what a point of a layer needs to 1 % up to some hundred Hz."""
FREQUENCIES = 400
SAFETY = 1.5
"""On discs of two materials, at once and with a ramp, the substeps erred by 1.0 to 1.3 times the spectrum's figure."""
BEYOND = 8.0
"""Highest frequency looked at, over that of half the step rate."""


def onset_error(system: SkinSystem, force: Float, read: Float, step_s: float, ramp_s: float) -> float:
    """Relative error that substeps make in the motion of a point, L2 over WINDOW_S after a load's onset.

    force: of the load, shape (n,) [N]; read: of the point, shape (n,); step_s: substep [s]
    ramp_s: of the raised cosine with which the load begins [s]; 0 is at once
    What is faster than half the step rate the steps miss altogether.
    """
    nyquist = 0.5 / step_s
    krylov = Krylov(DynamicStiffness(system, system.elimination_order()), math.pi * nyquist, force[:, None])
    while krylov.order < VECTORS and krylov.grow():
        pass
    pushed, seen = krylov.vectors.T @ force, krylov.vectors.T @ read
    matrices = np.array(krylov.projected)
    edges = np.geomspace(1.0 / WINDOW_S, BEYOND * nyquist, FREQUENCIES + 1)
    middle, width = np.sqrt(edges[1:] * edges[:-1]), np.diff(edges)
    slow = middle < 0.95 * nyquist
    exact = _answers(matrices, krylov.dynamics.weights(-2j * math.pi * middle), pushed, seen)
    rows = [discrete_weights(system, f, step_s) for f in middle[slow]]
    scheme = np.zeros_like(exact)
    weights = np.array([[inertia, rate, 1.0, *scales] for inertia, rate, scales in rows])
    scheme[slow] = _answers(matrices, weights, pushed, seen)
    # Of the raised cosine's slope, half a sine
    turns = 2.0 * middle * ramp_s
    near_one = np.abs(turns - 1.0) < 1e-6
    ramp = np.where(
        near_one, 0.25 * math.pi, np.cos(0.5 * math.pi * turns) / (1.0 - np.where(near_one, 0.0, turns) ** 2)
    )
    # Both signs of the frequency, of a step's spectrum 1 / (2 pi f)
    energy = 2.0 * (ramp / (2.0 * math.pi * middle)) ** 2 * width
    # The push that stays is what the answer is measured by
    stays = float(np.abs(exact[0]) ** 2 * WINDOW_S)
    return SAFETY * math.sqrt(float(energy @ np.abs(scheme - exact) ** 2) / stays)


def _answers(matrices: Float, weights: np.ndarray, pushed: Float, seen: Float) -> np.ndarray:
    """Motion of the point at each row of weights (k, 3 + p), shape (k,)."""
    return (
        np.linalg.solve(np.tensordot(weights, matrices, axes=1), pushed.astype(complex)[None, :, None])[..., 0] @ seen
    )
