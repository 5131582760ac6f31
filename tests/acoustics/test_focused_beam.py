"""What nonlinear propagation does in a focus: the budget's figures against the KZK equation.

Our own solver, in the coordinates in which a Gaussian beam keeps its width: with u = r/w(z), zeta = atan(z/zR) and the
lens's phase taken out of every harmonic, p_n = phi_n cos(zeta) obeys

    d phi_n/d zeta = i (nabla^2/(4 n) - n u^2) phi_n + (sigma' / cos zeta) / 2 times harmonic n of d(phi^2)/d(w t)

an oscillator of its own for each harmonic, stepped exactly, and Burgers' term between (Runge-Kutta, no loss).
"""

import math

import numpy as np
import pytest
from scipy.linalg import expm

from palmfield.acoustics.nonlinear import fundamental_left
from palmfield.estimate.biases import _nonlinear

CELLS, OUTER, HARMONICS, STEPS = 120, 4.0, 20, 200
U = (np.arange(CELLS) + 0.5) * OUTER / CELLS


def laplacian() -> np.ndarray:
    h, edges = OUTER / CELLS, np.arange(CELLS + 1) * OUTER / CELLS
    up, down = edges[1:] / (U * h * h), edges[:-1] / (U * h * h)
    return np.diag(up[:-1], 1) + np.diag(down[1:], -1) - np.diag(up + down)


def harmonics_of_square_slope(phi: np.ndarray) -> np.ndarray:
    """Complex amplitudes under e^{-i n w t} of d(p^2)/d(w t), with p = Re sum phi_n e^{-i n w t}."""
    count = 4 * len(phi)
    spectrum = np.zeros((count // 2 + 1, phi.shape[1]), complex)
    spectrum[1 : len(phi) + 1] = phi.conj() / 2.0
    p = np.fft.irfft(spectrum, count, axis=0) * count
    squares = 2.0 / count * np.fft.rfft(p * p, axis=0).conj()[1 : len(phi) + 1]
    return -1j * np.arange(1, len(phi) + 1)[:, None] * squares


def at_the_focus(start: np.ndarray, gain: float, strength: float, harmonics: int = HARMONICS) -> np.ndarray:
    """phi_n(u) at the focus of what starts `gain` Rayleigh lengths before it; strength: sigma' above."""
    begin = -math.atan(gain)
    step = -begin / STEPS
    absorbing = np.diag(np.where(U > 0.75 * OUTER, 20.0 * (4.0 * U / OUTER - 3.0) ** 2, 0.0))
    on = [
        expm(0.5 * step * (1j * (laplacian() / (4 * n) - n * np.diag(U**2)) - absorbing))
        for n in range(1, harmonics + 1)
    ]
    phi = np.zeros((harmonics, CELLS), complex)
    phi[0] = start
    for k in range(STEPS):
        phi = np.array([one @ own for one, own in zip(on, phi, strict=True)])
        size = 0.5 * strength * step / math.cos(begin + (k + 0.5) * step)
        half = phi + size / 2.0 * harmonics_of_square_slope(phi)
        phi = phi + size * harmonics_of_square_slope(half)
        phi = np.array([one @ own for one, own in zip(on, phi, strict=True)])
    return phi


def on_axis(start: np.ndarray, gain: float) -> float:
    """Integral of |p| along the axis over its value at the focus and the Rayleigh length, without steepening."""
    begin = -math.atan(gain)
    on, phi = expm(-begin / STEPS * 1j * (laplacian() / 4 - np.diag(U**2))), start.astype(complex)
    zeta, values = np.linspace(begin, 0.0, STEPS + 1), [abs(phi[0])]
    for _ in range(STEPS):
        phi = on @ phi
        values.append(abs(phi[0]))
    return float(np.trapezoid(np.array(values) / np.cos(zeta), zeta))


def width(profile: np.ndarray) -> float:
    return float(np.interp(-profile[0] / 2.0, -profile[:50], U[:50]))


@pytest.mark.parametrize(
    ("beam", "gain", "sigma"),
    [("gaussian", 9.0, 0.26), ("gaussian", 9.0, 0.52), ("disc", 9.0, 0.52), ("gaussian", 20.0, 1.0)],
)
def test_what_a_focused_beam_loses_and_gains_is_that_of_the_kzk_equation(beam: str, gain: float, sigma: float) -> None:
    """An array of 16 x 16 focuses 200 mm away by about 9 Rayleigh lengths of its spot."""
    start = np.exp(-(U**2)) if beam == "gaussian" else (U < 1.0) * 1.0
    linear = np.abs(at_the_focus(start, gain, 0.0, 1)[0]) ** 2
    amplitudes = at_the_focus(start, gain, sigma / on_axis(start, gain))
    arp = (np.abs(amplitudes) ** 2).sum(axis=0)
    line = abs(amplitudes[0, 0]) ** 2 / linear[0] - 1.0
    peak, narrower = arp[0] / linear[0] - 1.0, 1.0 - width(arp) / width(linear)
    force = (arp * U).sum() / (linear * U).sum() - 1.0
    bias = _nonlinear(sigma, [])
    moved = (1.0 - fundamental_left(sigma) ** 2) / 2.0
    # The line loses half of what a plane wave of that sigma would, a disc's beam a fifth less
    assert 0.75 * moved < -line < 1.1 * moved
    assert abs(force) < 1e-3 and bias.low == 0.0
    assert 0.6 * bias.high < peak < bias.high
    told = float(bias.why.partition("on a spot that is up to ")[2].split()[0]) / 100.0
    assert 0.3 * told < narrower < 1.1 * told
