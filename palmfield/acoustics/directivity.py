"""Forms of directivity: amplitude of a transducer off its axis, and the polynomial for the kernels."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval

from palmfield.acoustics.polynomials import fit
from palmfield.acoustics.transducer import table_coefficients
from palmfield.errors import SceneError
from palmfield.types import Array, Float

EXACT = 23
"""Degree of the polynomial in float64, with an error near rounding for a piston up to kb 4.5."""


class Directivity:
    """A form: amplitude relative to the axis, as a function of s = sin^2(angle off the axis) and kb = wavenumber times
    radius. A form defines `level`; kernels use `polynomial`, which a form may override.

    name: name of the file in `palmfield.acoustics.directivities`, in key `directivity` and `palmfield.types.Array`.
    misfit: largest accepted error of the quintic of the kernels, relative to the axis.
    sized: whether `level` depends on kb, so that key `piston_radius_m` has an effect.
    near: largest error of the far field times (distance/radius)^2, for a piston at angles up to 85 degrees and k b up
        to 3.3 (`scripts/bench/rayleigh.py`, docs/bench/peers.md). Larger pistons have a null, where sound is weak.
    """

    name: str
    misfit: float = 1e-4
    sized: bool = False
    near: float = 0.45

    def level(self, s: Float, kb: float) -> Float:
        """Return the amplitude relative to the axis at s = sin^2(angle), in the shape of s, float64."""
        raise NotImplementedError

    def slope(self, s: Float, kb: float) -> Float:
        """Return the derivative of `level` with respect to s."""
        return np.asarray(polyval(s, polyder(self.polynomial(kb, EXACT))))

    def polynomial(self, kb: float, degree: int = 5) -> Float:
        """Return `level` as a polynomial in s, lowest power first, shape (degree + 1,).

        Raises SceneError if its error exceeds `misfit`.
        """
        return _fitted(self, kb, degree)

    def of(self, array: Array) -> Array:
        """Return the array with this directivity."""
        return replace(array, directivity=self.name, directivity_table=None)

    def words(self, array: Array) -> str:
        """Return the description of such transducers for the plan."""
        return f"directivity {self.name}"


class Measured(Directivity):
    """A table of angles [deg] and amplitudes, shape (m, 2), modelled by a quintic at any wavenumber."""

    def __init__(self, name: str, table: Float):
        self.name, self.table = name, table

    def level(self, s: Float, kb: float) -> Float:
        return np.asarray(polyval(s, self.polynomial(kb)))

    def polynomial(self, kb: float, degree: int = 5) -> Float:
        return np.pad(_of_table(self), (0, degree - 5))

    def of(self, array: Array) -> Array:
        return replace(array, directivity_table=self.table)

    def words(self, array: Array) -> str:
        return "measured directivity"


@lru_cache(maxsize=64)
def _of_table(form: Measured) -> Float:
    return table_coefficients(form.table)


@lru_cache(maxsize=256)
def _fitted(form: Directivity, kb: float, degree: int) -> Float:
    s = np.linspace(0.0, 1.0, 501)
    level = form.level(s, kb)
    even = np.ptp(level) == 0.0  # then the value is exactly 1; interpolation would change it by rounding
    polynomial = np.eye(degree + 1)[0] if even else fit(lambda s: form.level(s, kb), degree, 1.0)
    error = float(np.abs(polyval(s, polynomial) - level).max())
    if not error <= form.misfit:
        raise SceneError(
            f"directivity '{form.name}' at k*radius {kb:.3g}: the error of the kernels' polynomial is {error:.2g} "
            f"of the value on the axis; allowed: {form.misfit:g}: lower piston_radius_m or frequency_Hz"
        )
    polynomial.setflags(write=False)
    return polynomial
