"""Rigid sphere in a plane wave: the exact solution."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import eval_legendre, spherical_jn, spherical_yn

from palmfield.types import Complex, Int


def series_terms(ka: float) -> tuple[Int, Complex]:
    """Orders n and (2n + 1) i^n i/((ka)^2 h_n'(ka))."""
    n = np.arange(int(ka + 4.0 * ka ** (1.0 / 3.0) + 12.0), dtype=np.int32)
    slope = spherical_jn(n, ka, derivative=True) + 1j * spherical_yn(n, ka, derivative=True)
    return n, (2 * n + 1) * 1j**n * 1j / (ka**2 * slope)


def surface_pressure(ka: float, cosine: ArrayLike) -> Complex:
    """Total pressure on a rigid fixed sphere in the wave exp(ikz), e^{-iwt}; cosine: of the angle from +z.

    p = sum (2n+1) i^n P_n [j_n - j_n'/h_n' h_n](ka), by the Wronskian (2n+1) i^n P_n i/((ka)^2 h_n') (Morse & Ingard,
    Theoretical Acoustics, section 8.2).
    """
    n, terms = series_terms(ka)
    return np.stack([eval_legendre(i, np.asarray(cosine, dtype=float)) for i in n], axis=-1) @ terms
