"""Resonance and quality of the transducers, from a slow sweep of the carrier, with a microphone at several places."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from palmfield.acoustics import check
from palmfield.acoustics.reference import pressure64
from palmfield.drive.response import Pole, envelope_response
from palmfield.errors import PalmfieldError
from palmfield.types import Air, Array, Complex, Float

LIMITS_HZ = 20e3, 80e3
FEWEST = 8
DELAY_SD_S = 6e-6
"""Prior standard deviation of delays from place to place: 2 mm of path [s]."""
NOISE = 0.01
"""Noise of readings, relative to the loudest reading of a place; it determines the weight of the prior of delays."""


@dataclass(frozen=True)
class SweepFit:
    """Result of the fit: resonance_Hz and quality of all transducers together, with standard errors from the scatter
    over places.

    misfit: rms residual, relative to the rms reading. If transducers differ in resonance, the quality is too low,
    because it is the quality of their sum.
    """

    resonance_Hz: float
    resonance_sd_Hz: float
    quality: float
    quality_sd: float
    misfit: float


def fit_sweep(
    array: Array, air: Air, drive: ArrayLike, at: ArrayLike, frequencies_Hz: ArrayLike, pressures_Pa: ArrayLike
) -> SweepFit:
    """Fit one pole for all transducers, and a free factor for each place, by least squares over complex pressures.

    p(m, f) = C_m e^{i 2 pi f t_m} P(f; f0, Q) S_m(f). S_m is the sum of the sound of the transducers at this frequency
    with the phases of the drive; P = g/(g - i 2 pi (f - f0)), g = pi f0/Q; t_m is the delay of recorder and place.
    Places are also fitted separately. Errors are those of the mean over places, because disturbances (echoes,
    interference) differ between places.

    drive: complex amplitudes, the same at all frequencies, shape (n,); at: places of the microphone, array frame [m],
    shape (m, 3), at least 8; frequencies_Hz: shape (q,), at least 5; pressures_Pa: complex (a delay is +phase), (m, q)
    Raises PalmfieldError for fewer places or frequencies, invalid shapes, numbers that are not finite, and for a
    resonance outside the sweep.
    """
    where = check.points(np.asarray(at, float), np.float64)
    f, measured = np.asarray(frequencies_Hz, float), np.asarray(pressures_Pa, np.complex128)
    if measured.shape != (len(where), len(f)) or len(where) < FEWEST or len(f) < 5:
        raise PalmfieldError(
            f"{len(where)} positions, {len(f)} frequencies and readings of shape {measured.shape}; needed: at least "
            f"{FEWEST} positions and 5 frequencies, and a reading for each pair"
        )
    if not np.isfinite(measured).all() or not np.all((f >= LIMITS_HZ[0]) & (f <= LIMITS_HZ[1])):
        raise PalmfieldError(f"readings are not finite, or frequencies outside {LIMITS_HZ[0]:g} to {LIMITS_HZ[1]:g} Hz")
    emitted = np.asarray(drive, np.complex128)
    sound = np.column_stack([pressure64(where, replace(array, frequency_Hz=float(x)), emitted, air)[0] for x in f])
    start = float(f[np.argmax(np.abs(measured).mean(axis=0))])
    each = np.array([_pole(sound[m : m + 1], f, measured[m : m + 1], start)[:2] for m in range(len(where))])
    resonance, quality, misfit = _pole(sound, f, measured, start)
    if not f.min() < resonance < f.max():
        raise PalmfieldError(
            f"the fitted resonance of {resonance:.0f} Hz is outside the sweep ({f.min():.0f} to {f.max():.0f} "
            "Hz): sweep to both sides of the resonance"
        )
    errors = np.std(each, axis=0, ddof=1) / math.sqrt(len(where))
    return SweepFit(resonance, float(errors[0]), quality, float(errors[1]), misfit)


def _pole(sound: Complex, f: Float, measured: Complex, start: float) -> tuple[float, float, float]:
    """Return resonance [Hz], quality, and relative rms of the residual, with the best factor for each place."""
    scale = np.abs(measured).max(axis=1, keepdims=True)
    places = len(measured)

    def rest(unknown: Float) -> Complex:
        late = np.exp(2j * math.pi * DELAY_SD_S * unknown[2:, None] * (f - start))
        model = sound * late * response_at(f, start + 100.0 * unknown[0], math.exp(unknown[1]))
        factor = (model.conj() * measured).sum(axis=1) / (np.abs(model) ** 2).sum(axis=1)
        return np.asarray(measured - factor[:, None] * model)

    def residual(unknown: Float) -> Float:
        noise = rest(unknown) / scale / NOISE
        return np.concatenate([noise.real.ravel(), noise.imag.ravel(), unknown[2:]])

    # Q from 5 to 200: the range of real transducers
    low, high = [-50.0, math.log(5.0)], [50.0, math.log(200.0)]
    solution = least_squares(
        residual, [0.0, math.log(25.0)] + [0.0] * places, bounds=(low + [-np.inf] * places, high + [np.inf] * places)
    )
    misfit = float(np.sqrt((np.abs(rest(solution.x)) ** 2).sum() / (np.abs(measured) ** 2).sum()))
    return start + 100.0 * float(solution.x[0]), math.exp(float(solution.x[1])), misfit


def response_at(frequencies_Hz: Float, resonance_Hz: float, quality: float) -> Complex:
    """Return the response of transducers to a steady carrier, relative to that at resonance, shape (q,)."""
    return envelope_response(frequencies_Hz - resonance_Hz, Pole(resonance_Hz, quality, resonance_Hz))[:, 0]
