"""Estimate the source level of the transducers of a real array from pressures measured with a microphone."""

import numpy as np
from numpy.typing import ArrayLike

from palmfield.acoustics import check
from palmfield.acoustics.reference import pressure64
from palmfield.errors import PalmfieldError
from palmfield.types import Air, Array


def calibrate_p0(
    points: ArrayLike, pressures_Pa: ArrayLike, array: Array, drive: ArrayLike, air: Air
) -> tuple[float, float]:
    """Return p0 of an array [Pa m] and its standard error, by least squares over measured pressure magnitudes.

    The model is |p_i| = p0 m_i + e_i, with the simulated magnitude m_i for p0 = 1. The errors e_i have equal variance,
    as from a microphone with a noise floor. Then p0 = sum(m_i |p_i|)/sum(m_i^2), and the variance is estimated from the
    residuals with n - 1 degrees of freedom. The standard error contains the scatter only, not errors common to all
    readings, such as that of the microphone calibration.

    points: positions of the microphone [m], array frame, shape (n, 3).
    pressures_Pa: magnitudes of the peak pressure there (rms times sqrt 2), shape (n,).
    array: gain and directivity are used, p0_Pa_m is not.
    drive: complex amplitudes during the measurement, shape (len(array),).
    Raises PalmfieldError for fewer than 2 points, for pressures that are negative, not finite or of another number, and
    for points without sound of the array; also the errors of `pressure64`.
    """
    where = check.points(points, np.float64)
    measured = np.asarray(pressures_Pa, dtype=float)
    if measured.shape != (len(where),) or len(where) < 2:
        raise PalmfieldError(
            f"pressures_Pa has shape {measured.shape} for {len(where)} points: give one reading per point, and at "
            "least 2"
        )
    bad = ~(np.isfinite(measured) & (measured >= 0.0))
    if bad.any():
        i = int(np.argmax(bad))
        raise PalmfieldError(f"pressures_Pa[{i}] = {measured[i]} is not 0 or more and finite: give peak magnitudes")
    model = np.abs(pressure64(where, array, drive, air)[0]) / array.p0_Pa_m
    square = float(model @ model)
    if square == 0.0:
        raise PalmfieldError(
            "the array emits no sound at these points: measure in front of the array, with a nonzero drive"
        )
    p0 = float(model @ measured) / square
    variance = float(np.sum((measured - p0 * model) ** 2)) / (len(where) - 1)
    return p0, float(np.sqrt(variance / square))
