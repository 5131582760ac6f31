"""Short polynomials for the field kernels, fitted at Chebyshev nodes, which comes close to the minimax fit."""

import functools
from collections.abc import Callable

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial, polynomial
from scipy.special import j1

from palmfield.errors import SceneError
from palmfield.types import Float

DIRECTIVITY_ERROR = 2e-6
"""Largest error of the directivity's fit that is accepted, relative to its value on the axis."""

ATTENUATION_REACH_Np = 0.25
"""Absorption times distance up to which the cubic of `attenuation` holds, with a relative error of 1.4e-6."""


def fit(function: Callable[[Float], Float], degree: int, high: float) -> Float:
    """Coefficients, lowest power first, shape (degree + 1,), of the interpolant at the Chebyshev nodes of [0, high]."""
    coefficients = np.zeros(degree + 1)
    fitted = Chebyshev.interpolate(function, degree, domain=[0.0, high]).convert(kind=Polynomial).coef
    coefficients[: len(fitted)] = fitted  # `convert` drops trailing zeros
    return coefficients


def piston(x: Float) -> Float:
    """2 J1(x)/x, and its limit 1 at x = 0 (far-field directivity of a baffled piston, x = k b sin(angle))."""
    # Below 1e-8 it is 1 to the last digit
    safe = np.maximum(np.abs(x), 1e-8)
    return 2.0 * j1(safe) / safe


@functools.cache
def directivity(kb: float) -> tuple[Float, Float]:
    """Coefficients, lowest power first, of the piston's directivity in s = sin^2(angle) and of its derivative.

    kb: wavenumber times piston radius [rad]
    Returns arrays of shape (6,) and (5,); exactly 1 and 0 for kb = 0, a point source.
    Raises SceneError when a quintic is not good enough, which is above kb of about 4.5.
    """
    if kb == 0.0:
        return np.eye(6)[0], np.zeros(5)
    quintic = fit(lambda s: piston(kb * np.sqrt(s)), 5, 1.0)
    s = np.linspace(0.0, 1.0, 501)
    error = float(np.abs(polynomial.polyval(s, quintic) - piston(kb * np.sqrt(s))).max())
    if not error <= DIRECTIVITY_ERROR:
        raise SceneError(
            f"piston of k*radius = {kb:.3g} is too large for the directivity model (at most about 4.5): "
            "lower piston_radius_m or frequency_Hz"
        )
    return quintic, quintic[1:] * np.arange(1, 6)


def attenuation(absorption_Np_m: float) -> Float:
    """Coefficients of exp(-absorption d) in d [m], lowest power first, shape (4,), up to ATTENUATION_REACH_Np."""
    cubic = fit(lambda x: np.exp(-x), 3, ATTENUATION_REACH_Np)
    return cubic * absorption_Np_m ** np.arange(4)


@functools.cache
def sine_cosine() -> tuple[Float, Float]:
    """Coefficients in f^2, for |f| <= 1/2, of sin(2 pi f)/f and cos(2 pi f), shape (6,) each."""
    sine = fit(lambda q: 2.0 * np.pi * np.sinc(2.0 * np.sqrt(q)), 5, 0.25)
    cosine = fit(lambda q: np.cos(2.0 * np.pi * np.sqrt(q)), 5, 0.25)
    return sine, cosine
