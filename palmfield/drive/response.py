"""What transducers make of a drive that changes: their resonance, and the time that their sound is under way.

A transducer near its resonance f0 of quality Q is one complex pole. Its oscillation x = Re(a e^{-iwt}), driven at the
carrier w with the complex envelope u,

    x'' + (w0/Q) x' + w0^2 x = Re(-i (w0^2/Q) u e^{-iwt}),

has an envelope that follows, up to terms of the order of 1/Q and of detuning over w0,

    da/dt = -(g - i D) a + g u,   g = pi f0/Q,   D = 2 pi (carrier - f0).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from palmfield.acoustics import check
from palmfield.acoustics.air import sound_speed
from palmfield.errors import DeviceError, SceneError
from palmfield.types import Air, Array, Complex, Float


@dataclass(frozen=True)
class Pole:
    """Resonance of the transducers, all alike or each its own.

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
    """a/u for an envelope e^{-2 pi i f t}: g/(g - i(D + 2 pi f)), shape (..., n) for frequencies of shape (...).

    Positive and negative f are the two sidebands; f = 0 is the steady state, 1 at resonance. p0 of an array is that of
    transducers at resonance; where it was measured at the carrier on detuned ones, divide drives by the response at 0.
    """
    turn = 2.0 * np.pi * np.asarray(frequency_Hz, float)[..., None]
    return np.asarray(pole.damping / (pole.rate - 1j * turn), np.complex128)


def filter_frames(
    drives: ArrayLike, dt: float, pole: Pole, *, linear: bool = False, initial: ArrayLike | None = None
) -> Complex:
    """What the transducers emit at the frames' times, exact to rounding for any dt.

    drives: complex amplitudes, shape (frames, n). Held: frame k holds from k dt to (k+1) dt. Linear: it is the value at
        k dt, with straight lines between
    dt: length of a frame [s]
    initial: emitted at t = 0, shape (n,); None is silence
    Returns emitted amplitudes at 0, dt, 2 dt, ..., shape (frames + 1, n) for held frames, (frames, n) for linear ones.
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


def pole_step(emitted: Complex, first: Complex, last: Complex, pole: Pole, time_s: float) -> Complex:
    """Emitted amplitudes after a drive that went from `first` to `last` along a line, exact, shape (n,).

    Relative to the steady response at the carrier, where p0 is measured: under a constant drive they settle to it.
    time_s: [s], above 0
    """
    decay, held, slope = pole_weights(pole.rate * time_s)
    return np.asarray(decay * emitted + held * first + slope * (last - first), np.complex128)


def emitted_at(
    times: ArrayLike, drives: ArrayLike, dt: float, pole: Pole, *, initial: ArrayLike | None = None
) -> Complex:
    """What the transducers emit at any time under held frames, exact. With `t - flight_times(...)` it is what arrives.

    times: [s], shape (q,) or (q, n), each transducer its own. Before 0 `initial` stands; after the end the last frame
    drives, dt, initial: as filter_frames
    Returns shape (q, n). Raises DeviceError as filter_frames.
    """
    commanded, _ = _frames(drives, dt, pole, initial)
    states = filter_frames(commanded, dt, pole, initial=initial)[:-1]
    moment = np.asarray(times, float)
    moment = moment[:, None] if moment.ndim == 1 else moment
    moment = np.broadcast_to(np.maximum(moment, 0.0), (len(moment), commanded.shape[1]))
    frame = np.minimum(moment // dt, len(commanded) - 1).astype(int)
    column = np.arange(commanded.shape[1])
    settled = pole.damping / pole.rate * commanded[frame, column]
    return settled + (states[frame, column] - settled) * np.exp(-pole.rate * (moment - frame * dt))


def flight_times(array: Array, point: ArrayLike, air: Air) -> Float:
    """Time that the sound of each transducer takes to a point [s], shape (n,).

    point: [m], array frame, shape (3,). Raises SceneError where it is no finite position, and for a bad array.
    """
    check.array(array)
    target = np.asarray(point, float)
    if target.shape != (3,) or not np.isfinite(target).all():
        raise SceneError(f"point {target.tolist()} is not a finite position (x, y, z): give three numbers, in metres")
    return np.linalg.norm(target - array.positions, axis=1) / sound_speed(air)


def delay_spread(array: Array, point: ArrayLike, air: Air) -> float:
    """Time between the first and the last transducer's sound of one moment at a point [s]. Errors as flight_times."""
    times = flight_times(array, point, air)
    return float(times.max() - times.min())


def ring_bound(envelope_frequency_Hz: float, pole: Pole, *, remove_delay: bool = False) -> float:
    """Bound of the relative error of taking transducers for instant: |a - H(0) u| <= bound |H(0) u|, rms over time.

    It holds for every envelope without parts above the given frequency, at each transducer, and for the pressure at any
    point where the transducers are alike. The radiation pressure, a square, is off by up to 2 bound + bound^2.

    remove_delay: compare with a drive later by a delay common to all (the mean of Re 1/rate, 0.2 ms at Q = 25), which
        a viewer or a hand does not notice
    Without it: |1 - H(f)/H(0)| = |w/(rate - iw)|, at its largest over |w| up to the given frequency; exact.
    With it: from |1 - iw/rate - e^{-iwT}| <= |w Im(1/rate)| + |w (Re(1/rate) - T)| + (wT)^2/2.
    Raises DeviceError for a frequency that is negative or not finite.
    """
    w = 2.0 * np.pi * _frequency(envelope_frequency_Hz)
    damping, detuning = pole.damping, np.abs(pole.rate.imag)
    if not remove_delay:
        with np.errstate(divide="ignore"):
            worst = np.minimum(w, (damping**2 + detuning**2) / detuning)
        return float(np.max(worst / np.hypot(damping, detuning - worst)))
    inverse = 1.0 / pole.rate
    delay = float(inverse.real.mean())
    numerator = w * np.abs(inverse.imag) + w * np.abs(inverse.real - delay) + 0.5 * (w * delay) ** 2
    denominator = np.hypot(damping, np.maximum(detuning - w, 0.0)) * np.abs(inverse)
    loudest = np.hypot(damping, detuning) / np.hypot(damping, np.maximum(detuning - w, 0.0))
    return float(np.max(np.minimum(numerator / denominator, 1.0 + loudest)))


def delay_bound(envelope_frequency_Hz: float, spread_s: float) -> float:
    """Bound of the relative error of letting the sound of all transducers arrive at once, after half-way of the spread.

    The drive of one is off by at most half the spread, so by |1 - e^{iw spread/2}| = 2 sin(w spread/4), or 2 once that
    has passed its top: rms over time for every envelope without parts above the given frequency, relative to the sum of
    the transducers' pressures, which at a focus is the pressure.

    envelope_frequency_Hz: highest frequency of the envelope; spread_s: see delay_spread [s]
    Raises DeviceError for a frequency or spread that is negative or not finite.
    """
    w = 2.0 * np.pi * _frequency(envelope_frequency_Hz)
    if not 0.0 <= spread_s < np.inf:
        raise DeviceError(f"spread_s = {spread_s} is negative or not finite: give a time from delay_spread")
    return float(2.0 * np.sin(min(0.25 * w * spread_s, 0.5 * np.pi)))


def pole_weights(z: Complex) -> tuple[Complex, Complex, Complex]:
    """e^{-z}; 1 - e^{-z}; and 1 - (1 - e^{-z})/z, the weight of a ramp over a step; each without cancellation."""
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
        raise DeviceError(f"drives[{check.first_bad(commanded)}] is not finite: remove or mend it")
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


def _frequency(value: float) -> float:
    if not 0.0 <= value < np.inf:
        raise DeviceError(f"envelope_frequency_Hz = {value} is negative or not finite: give a frequency of 0 or more")
    return value
