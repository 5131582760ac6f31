"""Rounding of a drive to the phases and amplitudes of a device, and the resulting error."""

import numpy as np
from numpy.typing import ArrayLike

from palmfield.errors import DeviceError
from palmfield.types import Complex, Float, Int

FULL = 1.0 + 1e-9
"""Largest accepted |a|: full drive plus rounding."""


def phase_codes(drive: ArrayLike, steps: int) -> Int:
    """Return the nearest of `steps` equal phase steps, round(steps arg(a)/2 pi) mod steps, shape of drive, int32.

    Phases are rounded, not floored: a focus gives phases such as -1e-17, for which a floor gives steps - 1. A larger
    code is a later wave (e^{-iwt}). Raises DeviceError for a drive that is not finite and for steps < 1.
    """
    amplitudes = _checked(drive)
    _at_least_one(steps, "phase_steps")
    return np.mod(np.rint(steps * np.angle(amplitudes) / (2.0 * np.pi)), steps).astype(np.int32)


def amplitude_codes(drive: ArrayLike, steps: int) -> Int:
    """Return the nearest of the levels 0, 1/steps, ..., 1 of |a|, as 0..steps, shape of drive, int32.

    1 step means off or full; 255 steps are 8 bits. Raises DeviceError for |a| > 1 or not finite, and for steps < 1.
    """
    amplitudes = _checked(drive)
    _at_least_one(steps, "amplitude_steps")
    return np.rint(steps * np.abs(amplitudes)).astype(np.int32)


def quantise(drive: ArrayLike, *, phase_steps: int | None = None, amplitude_steps: int | None = None) -> Complex:
    """Return a drive with phases and amplitudes rounded to those of a device.

    drive: complex amplitudes, |a| <= 1, any shape
    phase_steps: phase steps in a turn, 32 on a SonicSurface, 256 on AUTD3; None: phases are not rounded
    amplitude_steps: levels above 0, equal in amplitude (for pulse widths see pulse_width); None: no rounding
    Returns complex amplitudes, same shape. Raises DeviceError as the functions above.
    """
    amplitudes = _checked(drive)
    magnitude, phase = np.abs(amplitudes), np.angle(amplitudes)
    if phase_steps is not None:
        phase = 2.0 * np.pi * phase_codes(amplitudes, phase_steps) / phase_steps
    if amplitude_steps is not None:
        magnitude = amplitude_codes(amplitudes, amplitude_steps) / amplitude_steps
    return magnitude * np.exp(1j * phase)


def phase_loss(steps: int) -> float:
    """Return the expected focal pressure with rounded phases over that without: sin(pi/N)/(pi/N) for N steps.

    It is the mean of the cosine of an error that is uniform over +-pi/N, a good model for the phases of a focus. The
    rest of the sound is scattered. Raises DeviceError for steps < 1.
    """
    _at_least_one(steps, "phase_steps")
    return float(np.sinc(1.0 / steps))


def _checked(drive: ArrayLike) -> Complex:
    amplitudes = np.asarray(drive, np.complex128)
    magnitude: Float = np.abs(amplitudes)
    if not np.all(magnitude <= FULL):
        worst = np.max(np.where(np.isnan(magnitude), np.inf, magnitude))
        raise DeviceError(
            f"drive amplitude {worst:.4g} is above 1 (full drive) or not finite: scale the drive to |a| <= 1"
        )
    return amplitudes


def _at_least_one(value: int, name: str) -> None:
    if value < 1:
        raise DeviceError(f"{name} = {value} is below 1: give a whole number of steps")
