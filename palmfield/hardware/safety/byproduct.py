"""Estimate the audible sound due to ultrasound of varying intensity."""

import math
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from palmfield.acoustics.air import absorption_Np_m, sound_speed
from palmfield.acoustics.exposure import a_weighting_dB, beam_share, demodulated_Pa, force_sound_Pa, level_dB
from palmfield.types import Air, Complex, Float

RATE_HZ, COUNT = 16384, 4096
"""Sampling rate and number of samples of the intensity: 0.25 s, for sound up to 8 kHz."""
LOWEST_HZ = 20.0
ROUND_OFF = 1e-9
"""Fraction of the mean power below which changes are ignored."""


class Byproduct(NamedTuple):
    """A-weighted levels of sound generated in the air along the beam, by the force on the hand, and by both; -inf: none

    strongest_Hz: frequency of the loudest line, 0 in silence
    """

    air_dBA: float
    force_dBA: float
    strongest_Hz: float

    @property
    def level_dBA(self) -> float:
        """Level of both; their energies are added."""
        power = 10.0 ** (self.air_dBA / 10.0) + 10.0 ** (self.force_dBA / 10.0)
        return 10.0 * math.log10(power) if power > 0.0 else -math.inf


def lines(values: Float) -> tuple[Float, Float]:
    """Return frequencies [Hz] and peak amplitudes of spectral lines with the energy of samples at RATE_HZ, (k,)."""
    window = np.hanning(len(values) + 1)[:-1]
    spectrum = np.fft.rfft((values - values.mean()) * window)
    frequencies = np.fft.rfftfreq(len(values), 1.0 / RATE_HZ)
    peaks = 2.0 * np.abs(spectrum) / (len(values) * math.sqrt(float(np.mean(window**2))))
    audible = frequencies >= LOWEST_HZ
    return np.asarray(frequencies[audible], float), peaks[audible]


def rung(pressures: Complex, carrier_Hz: float, quality: float) -> Complex:
    """Return the response of transducers with one resonance to a pressure that changes in steps at RATE_HZ, shape (k,).

    One pole, as `palmfield.drive.transducer_response`: exact for values that are constant between samples.
    """
    decay = math.exp(-math.pi * carrier_Hz / (quality * RATE_HZ))
    return np.asarray(lfilter([1.0 - decay], [1.0, -decay], pressures, zi=[decay * pressures[0]])[0])


def byproduct(
    powers_W: Float, distance_m: float, air: Air, carrier_Hz: float, along_m: float | None = None
) -> Byproduct:
    """Return the audible by-product of ultrasound with a power over time, at RATE_HZ, shape (k,), as if all of it were
    modulated.

    The beam is as long as absorption allows, and the force on a hand that stops all of it is 2 P/c: both are upper
    estimates. distance_m: distance of the listener from the beam; along_m: position along the beam from its beginning,
    None for a beam that is a point
    """
    if np.ptp(powers_W) <= ROUND_OFF * powers_W.mean():
        return Byproduct(-math.inf, -math.inf, 0.0)
    frequencies, peaks = lines(powers_W)
    beam_m = 0.5 / absorption_Np_m(air, carrier_Hz)
    air_Pa = np.array([
        float(demodulated_Pa(power, beam_m, distance_m, f, air)) for f, power in zip(frequencies, peaks, strict=True)
    ])  # fmt: skip
    if along_m is not None:
        air_Pa *= beam_share(frequencies, along_m, distance_m, air, carrier_Hz)
    unit_Pa = force_sound_Pa(1.0, distance_m, frequencies, air)
    weights = 10.0 ** (a_weighting_dB(frequencies) / 20.0)
    air_Pa, force_Pa = weights * air_Pa, weights * unit_Pa * peaks * 2.0 / sound_speed(air)
    both = air_Pa**2 + force_Pa**2
    strongest = float(frequencies[both.argmax()]) if both.max() > 0.0 else 0.0
    return Byproduct(_level(air_Pa), _level(force_Pa), strongest)


def _level(peaks_Pa: Float) -> float:
    return level_dB(math.sqrt(0.5 * float(np.sum(peaks_Pa**2))))
