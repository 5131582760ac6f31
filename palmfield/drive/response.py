"""Response of transducers to a changing drive: their resonance.

A transducer near its resonance f0 of quality Q is one complex pole. Its oscillation x = Re(a e^{-iwt}), driven at the
carrier w with the complex envelope u, satisfies

    x'' + (w0/Q) x' + w0^2 x = Re(-i (w0^2/Q) u e^{-iwt}).

Up to terms of the order of 1/Q and of detuning over w0, the equation of its envelope is

    da/dt = -(g - i D) a + g u,   g = pi f0/Q,   D = 2 pi (carrier - f0).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from palmfield.acoustics import check
from palmfield.errors import DeviceError
from palmfield.types import Complex, Float


@dataclass(frozen=True)
class Pole:
    """Resonance of the transducers, one for all or one for each.

    f0_Hz: resonance frequency, a number or shape (n,)
    Q: quality, a number or shape (n,); about 25 for 40 kHz transducers of 10 mm
    carrier_Hz: frequency at which they are driven
    Raises DeviceError for values that are not positive and finite.
    """

    f0_Hz: float | Float = 40e3
    Q: float | Float = 25.0
    carrier_Hz: float = 40e3

    def __post_init__(self) -> None:
        for name in ("f0_Hz", "Q", "carrier_Hz"):
            values = np.atleast_1d(getattr(self, name))
            good = (values > 0.0) & np.isfinite(values)
            if not good.all():
                raise DeviceError(f"{name} = {values[~good][0]} is not positive and finite: give a number above 0")
        if np.size(self.f0_Hz) != np.size(self.Q) and 1 not in (np.size(self.f0_Hz), np.size(self.Q)):
            raise DeviceError(
                f"f0_Hz has {np.size(self.f0_Hz)} values and Q {np.size(self.Q)}: give one or the same number"
            )

    @property
    def damping(self) -> Float:
        """g = pi f0/Q [1/s], shape (n,) or (1,): the envelope settles as e^{-gt}."""
        return np.atleast_1d(np.pi * np.asarray(self.f0_Hz, float) / np.asarray(self.Q, float))

    @property
    def rate(self) -> Complex:
        """g - iD [1/s], shape (n,) or (1,)."""
        detuning = 2.0 * np.pi * (self.carrier_Hz - np.atleast_1d(np.asarray(self.f0_Hz, float)))
        return self.damping - 1j * detuning


def envelope_response(frequency_Hz: ArrayLike, pole: Pole) -> Complex:
    """Return a/u for an envelope e^{-2 pi i f t}: g/(g - i(D + 2 pi f)), shape (..., n) for frequencies of shape (...).

    Positive and negative f are the two sidebands. f = 0 is the steady state; at resonance its response is 1. p0 of an
    array applies to transducers at resonance. If p0 was measured off resonance, divide drives by the response at 0.
    """
    turn = 2.0 * np.pi * np.asarray(frequency_Hz, float)[..., None]
    return np.asarray(pole.damping / (pole.rate - 1j * turn), np.complex128)


def filter_frames(
    drives: ArrayLike, dt: float, pole: Pole, *, linear: bool = False, initial: ArrayLike | None = None
) -> Complex:
    """Return the emission of the transducers at the times of frames, exact to rounding for any dt.

    drives: complex amplitudes, shape (frames, n). linear: False: frame k is constant from k dt to (k+1) dt; True: it is
        the value at k dt, with straight lines between the frames
    dt: length of a frame [s]
    initial: emission at t = 0, shape (n,); None: silence
    Returns emitted amplitudes at 0, dt, 2 dt, ..., shape (frames + 1, n) for held frames, (frames, n) if linear.
    Raises DeviceError for another shape, values that are not finite, and dt not above 0.
    """
    commanded, start = _frames(drives, dt, pole, initial)
    decay, held, slope = pole_weights(pole.rate * dt)
    gain = pole.damping / pole.rate
    count = len(commanded) - 1 if linear else len(commanded)
    emitted = np.empty((count + 1, commanded.shape[1]), np.complex128)
    emitted[0] = start
    for k in range(count):
        emitted[k + 1] = decay * emitted[k] + gain * held * commanded[k]
        if linear:
            emitted[k + 1] += gain * slope * (commanded[k + 1] - commanded[k])
    return emitted


def pole_weights(z: Complex) -> tuple[Complex, Complex, Complex]:
    """Return e^{-z}, 1 - e^{-z}, and 1 - (1 - e^{-z})/z (weight of a ramp over a step), without cancellation."""
    held = -np.expm1(-z)
    small = np.abs(z) < 1e-3
    safe = np.where(small, 1.0, z)
    series = z / 2.0 - z**2 / 6.0 + z**3 / 24.0 - z**4 / 120.0
    return np.exp(-z), held, np.where(small, series, 1.0 - held / safe)


def _frames(drives: ArrayLike, dt: float, pole: Pole, initial: ArrayLike | None) -> tuple[Complex, Complex]:
    commanded = np.asarray(drives, np.complex128)
    if commanded.ndim != 2 or len(commanded) == 0:
        raise DeviceError(f"drives have shape {commanded.shape}: give (frames, transducers), at least one frame")
    if not np.isfinite(commanded).all():
        raise DeviceError(f"drives[{check.first_bad(commanded)}] is not finite: remove or correct it")
    if not 0.0 < dt < np.inf:
        raise DeviceError(f"dt = {dt} is not positive and finite: give the length of a frame in seconds")
    if len(pole.rate) not in (1, commanded.shape[1]):
        raise DeviceError(
            f"the pole has {len(pole.rate)} transducers and the drives {commanded.shape[1]}: give one for each"
        )
    start = np.zeros(commanded.shape[1], np.complex128) if initial is None else np.asarray(initial, np.complex128)
    if start.shape != commanded.shape[1:]:
        raise DeviceError(f"initial has shape {start.shape} for {commanded.shape[1]} transducers: give one value each")
    return commanded, start
