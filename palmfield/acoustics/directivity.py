"""Say what a form of directivity is: how loud a transducer is off its axis, and the polynomial that kernels read."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval

from palmfield.acoustics.polynomials import fit
from palmfield.acoustics.transducer import table_coefficients
from palmfield.errors import SceneError
from palmfield.types import Array, Float

EXACT = 23
"""Degree of the polynomial for the level of a form in float64: exact to the last digits for a piston up to kb 4.5."""


class Directivity:
    """A form: amplitude relative to the axis, of s = sin^2(angle off the axis) and kb = wavenumber times radius.

    A form defines `level`. Kernels read `polynomial`, which a form other than a smooth curve may replace.

    name: its file in `palmfield.acoustics.directivities`, in key `directivity` and in `palmfield.types.Array`.
    misfit: largest accepted distance of the quintic of the kernels from `level`, relative to the axis.
    sized: whether `level` depends on kb, so that key `piston_radius_m` has an effect.
    near: largest error of the far field times (distance/radius)^2; of a piston over angles to 85 degrees and for k b up
        to 3.3, the usual transducer (`scripts/bench/rayleigh.py`, docs/bench/peers.md). Larger pistons have a
        null, where the sound is weak.
    """

    name: str
    misfit: float = 1e-4
    sized: bool = False
    near: float = 0.45

    def level(self, s: Float, kb: float) -> Float:
        """Amplitude relative to the axis at s = sin^2(angle), of its shape, float64."""
        raise NotImplementedError

    def slope(self, s: Float, kb: float) -> Float:
        """Derivative of `level` with respect to s."""
        return np.asarray(polyval(s, polyder(self.polynomial(kb, EXACT))))

    def polynomial(self, kb: float, degree: int = 5) -> Float:
        """`level` as a polynomial in s, lowest power first, shape (degree + 1,).

        Raises SceneError when it is further from `level` than `misfit`.
        """
        return _fitted(self, kb, degree)

    def of(self, array: Array) -> Array:
        """The array with this directivity."""
        return replace(array, directivity=self.name, directivity_table=None)

    def words(self, array: Array) -> str:
        """Description of such transducers in the plan."""
        return f"directivity {self.name}"


class Measured(Directivity):
    """A table of angles [deg] and amplitudes, shape (m, 2): its quintic is the model, at any wavenumber."""

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
    even = np.ptp(level) == 0.0  # then 1 to the last digit, which interpolation would lose
    polynomial = np.eye(degree + 1)[0] if even else fit(lambda s: form.level(s, kb), degree, 1.0)
    error = float(np.abs(polyval(s, polynomial) - level).max())
    if not error <= form.misfit:
        raise SceneError(
            f"directivity '{form.name}' at k*radius {kb:.3g}: the error of the kernels' polynomial is {error:.2g} "
            f"of the value on the axis; allowed: {form.misfit:g}: lower piston_radius_m or frequency_Hz"
        )
    polynomial.setflags(write=False)
    return polynomial
