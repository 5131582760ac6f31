"""Short polynomials for the field kernels, fitted at Chebyshev nodes, which is close to the minimax fit."""

import functools
from collections.abc import Callable

import numpy as np
import scipy  # loads its submodules at first use
from numpy.polynomial import Chebyshev, Polynomial

from palmfield.types import Float

ATTENUATION_REACH_Np = 0.25
"""Largest absorption times distance for the cubic of `attenuation`; its relative error is then 1.4e-6."""


def fit(function: Callable[[Float], Float], degree: int, high: float) -> Float:
    """Return coefficients, lowest power first, (degree + 1,), of the interpolant at Chebyshev nodes of [0, high]."""
    coefficients = np.zeros(degree + 1)
    fitted = Chebyshev.interpolate(function, degree, domain=[0.0, high]).convert(kind=Polynomial).coef
    coefficients[: len(fitted)] = fitted  # `convert` removes trailing zeros
    return coefficients


def piston(x: Float) -> Float:
    """Return 2 J1(x)/x, 1 at x = 0: the far-field directivity of a baffled piston, x = k b sin(angle)."""
    # Below 1e-8 it is 1 to the last digit
    safe = np.maximum(np.abs(x), 1e-8)
    return 2.0 * scipy.special.j1(safe) / safe


def attenuation(absorption_Np_m: float) -> Float:
    """Return coefficients of exp(-absorption d) in d [m], lowest power first, (4,), up to ATTENUATION_REACH_Np."""
    cubic = fit(lambda x: np.exp(-x), 3, ATTENUATION_REACH_Np)
    return cubic * absorption_Np_m ** np.arange(4)


@functools.cache
def sine_cosine() -> tuple[Float, Float]:
    """Return coefficients in f^2, for |f| <= 1/2, of sin(2 pi f)/f and cos(2 pi f), shape (6,) each."""
    sine = fit(lambda q: 2.0 * np.pi * np.sinc(2.0 * np.sqrt(q)), 5, 0.25)
    cosine = fit(lambda q: np.cos(2.0 * np.pi * np.sqrt(q)), 5, 0.25)
    return sine, cosine
