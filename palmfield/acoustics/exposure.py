"""Sound level at a listener: levels, A-weighting, and the audible by-product of modulated ultrasound.

Levels are those of a free field, without the listener. Sources: IEC 61672-1 (A-weighting); Westervelt 1963 and
Berktay 1965 (sound of modulated ultrasound in air); Morse and Ingard 1968 (sound of a force on a small body).
"""

import math

import numpy as np

from palmfield.acoustics.air import absorption_Np_m, density, sound_speed
from palmfield.acoustics.nonlinear import NONLINEARITY
from palmfield.acoustics.reference import directivity
from palmfield.errors import PalmfieldError
from palmfield.types import Air, Array, Complex, Float

REFERENCE_PA = 20e-6
PUBLIC_DB, OCCUPATIONAL_DB = 100.0, 110.0
"""Levels above which users are warned: interim guidelines for the 25 to 50 kHz bands, for the public and at work."""
WORKING_DAY_S = 8 * 3600.0
A_POLES_HZ = 20.598997, 107.65265, 737.86223, 12194.217
ANGLES = np.linspace(0.0, 0.5 * np.pi, 361)


def level_dB(rms_Pa: float) -> float:
    """Return the sound pressure level re 20 uPa; -inf in silence."""
    return 20.0 * math.log10(rms_Pa / REFERENCE_PA) if rms_Pa > 0.0 else -math.inf


def a_weighting_dB(frequency_Hz: Float) -> Float:
    """Return the A-weighting at a frequency; -inf at 0 Hz."""
    low, second, third, high = (pole**2 for pole in A_POLES_HZ)
    square = np.asarray(frequency_Hz, float) ** 2
    gain = high * square**2 / ((square + low) * (square + high) * np.sqrt((square + second) * (square + third)))
    with np.errstate(divide="ignore"):
        return 20.0 * np.log10(gain) + 2.0


def dose_dB(mean_square_Pa2: float, duration_s: float) -> float:
    """Return the level of equal energy over a working day of 8 h; mean_square_Pa2: mean over duration_s."""
    return level_dB(math.sqrt(mean_square_Pa2 * duration_s / WORKING_DAY_S))


def ball_points(middle: Float, radius_m: float, spacing_m: float) -> Float:
    """Return the points of a grid in a ball, including its centre [m], shape (n, 3)."""
    steps = np.arange(-math.floor(radius_m / spacing_m), math.floor(radius_m / spacing_m) + 1) * spacing_m
    grid = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    return np.asarray(middle, float) + grid[np.linalg.norm(grid, axis=1) <= radius_m * (1.0 + 1e-9)]


def radiated_power_W(array: Array, drive: Complex, air: Air) -> float:
    """Return the sum of the sound powers of all transducers, each as if it were alone.

    drive: complex amplitude relative to full drive, shape (n,). The power is the integral of |p|^2/(2 rho c) over the
    half space in front. Raises PalmfieldError for another shape.
    """
    if drive.shape != (len(array),):
        raise PalmfieldError(f"a drive has shape {drive.shape}: give shape ({len(array)},)")
    beam = directivity(array, 2.0 * math.pi * array.frequency_Hz / sound_speed(air), np.cos(ANGLES))
    solid = 2.0 * math.pi * float(np.trapezoid(beam**2 * np.sin(ANGLES), ANGLES))
    gain = np.ones(len(array)) if array.gain is None else np.abs(array.gain)
    squares = float(np.sum(np.abs(drive * gain) ** 2))
    return squares * array.p0_Pa_m**2 * solid / (2.0 * density(air) * sound_speed(air))


def demodulated_Pa(power_W: float, length_m: float, distance_m: float, frequency_Hz: Float, air: Air) -> Float:
    """Return the peak pressure of the audible sound of ultrasound with fully modulated intensity, shape (k,).

    power_W: power of the ultrasound; length_m: length of the beam; frequency_Hz: frequency of the modulation, shape
    (k,). Westervelt's source is modelled as a point, for wavelengths longer than the beam; for others use `beam_share`.
    """
    w = 2.0 * math.pi * np.asarray(frequency_Hz, float)
    return NONLINEARITY * w**2 * power_W * length_m / (4.0 * math.pi * sound_speed(air) ** 3 * distance_m)


def beam_share(frequency_Hz: Float, along_m: float, aside_m: float, air: Air, carrier_Hz: float) -> Float:
    """Return the factor on `demodulated_Pa`, whose source is a point, for the length of a beam, shape (k,).

    Westervelt's sources are along the beam, decay as exp(-2 alpha x) and have the phase k x. The factor is their sum at
    a listener over that of a point source of length 1/(2 alpha) at the same distance from the beam.
    along_m, aside_m: position of the listener, along the beam from its beginning, and distance from the axis.
    """
    alpha = absorption_Np_m(air, carrier_Hz)
    k = 2.0 * math.pi * np.asarray(frequency_Hz, float) / sound_speed(air)
    # 12 steps per wavelength at the highest frequency, until the sources have decayed to e^-9
    step = min(4e-3, 2.0 * math.pi / (12.0 * max(float(k.max(initial=0.0)), 1e-9)))
    x = (np.arange(math.ceil(4.5 / (alpha * step))) + 0.5) * step
    far = np.hypot(along_m - x, aside_m)
    weight = np.exp(-2.0 * alpha * x) / far * step
    sums = np.array([abs(np.sum(weight * np.exp(1j * one * (x + far)))) for one in k])
    return sums * 2.0 * alpha * aside_m


def force_sound_Pa(force_N: float, distance_m: float, frequency_Hz: Float, air: Air) -> Float:
    """Return the peak pressure of the sound of an oscillating force on a small body, in the direction of the force.

    The source is a dipole with its near field; frequency_Hz: shape (k,)
    """
    k = 2.0 * math.pi * np.asarray(frequency_Hz, float) / sound_speed(air)
    return force_N * np.sqrt(k**2 + 1.0 / distance_m**2) / (4.0 * math.pi * distance_m)
