"""Default data of transducers, and a measured directivity as a polynomial."""

import numpy as np
import scipy  # loads its submodules at first use
from numpy.polynomial import polynomial

from palmfield.errors import SceneError
from palmfield.types import Estimate, Float

ANY_P0 = Estimate(
    2.53,
    1.27,
    8.5,
    "assumed",
    "published values for 10 mm transducers at 40 kHz, which depend on the supply voltage: 2.53, 3.4, 4.386 and "
    "8.02 in software of other projects, 8.5 from 120 dB at 0.3 m in a data sheet, 1.27 inferred for the UHEV1",
)
"""Peak pressure of one transducer at 1 m on its axis at full drive [Pa m], for an array without data."""

ANY_QUALITY = Estimate(
    25.0,
    12.0,
    35.0,
    "assumed",
    "range of such transducers; the flatness printed by Hasegawa & Shinoda 2018 is consistent with 17",
)
"""Quality factor of the resonance of a transducer, for an array without data."""

TABLE_MISFIT_LIMIT = 0.02
"""Largest accepted error of the fitted polynomial at the entries of a table, relative to the axis."""


def table_coefficients(table: Float) -> Float:
    """Return the quintic in sin^2(angle) nearest to a table, shape (6,), lowest power first; it is 1 on the axis.

    The fit is by least squares to the monotone cubic interpolant (PCHIP) of the table at every half degree. The table
    is mirrored at the axis so that the interpolant is smooth there.

    table: angle [deg] from 0 to 90 and amplitude relative to the axis, shape (m, 2).
    Raises SceneError if the error of the quintic at an entry exceeds TABLE_MISFIT_LIMIT.
    """
    quintic = nearest_quintic(table)
    misfit = _misfit(quintic, table)
    worst = int(np.argmax(misfit))
    if misfit[worst] > TABLE_MISFIT_LIMIT:
        raise SceneError(
            f"directivity_table: the quintic fit in sin^2 has an error of {misfit[worst]:.3f} of the value on the "
            f"axis at {table[worst, 0]:g} deg; allowed: {TABLE_MISFIT_LIMIT:g}: smooth the table"
        )
    return quintic


def table_misfit(table: Float) -> float:
    """Return the largest error of the fitted quintic at the entries of a table, relative to the axis."""
    return float(_misfit(nearest_quintic(table), table).max())


def nearest_quintic(table: Float) -> Float:
    """Return the fit of `table_coefficients` without a check of its error."""
    angle, amplitude = table.T
    smooth = scipy.interpolate.PchipInterpolator(
        np.concatenate([-angle[:0:-1], angle]), np.concatenate([amplitude[:0:-1], amplitude])
    )
    degrees = np.linspace(0.0, 90.0, 181)
    powers = polynomial.polyvander(np.sin(np.radians(degrees)) ** 2, 5)
    higher = np.linalg.lstsq(powers[:, 1:], smooth(degrees) - 1.0, rcond=None)[0]
    return np.concatenate([[1.0], higher])


def _misfit(quintic: Float, table: Float) -> Float:
    return np.abs(polynomial.polyval(np.sin(np.radians(table[:, 0])) ** 2, quintic) - table[:, 1])
