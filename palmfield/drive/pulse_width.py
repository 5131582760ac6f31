"""Pulses for target amplitudes: their widths in ticks, their phases, and frames resampled to the carrier's rate.

Hasegawa & Shinoda 2018, eq. 5 and 6. A device counts a carrier period in ticks: 640 of 25.6 MHz in that paper, 512 in
AUTD3, of which half are used (duty 0 to 1/2).
"""

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from palmfield.errors import DeviceError
from palmfield.stimulus.duty_law import duty_cycle, relative_pressure
from palmfield.types import Complex, Float, Int

HASEGAWA_TICKS = 640
AUTD3_TICKS = 512
AUTD3_LEVELS = 255

Edge = Literal["leading", "trailing", "centre"]
EDGE_TURNS: dict[Edge, float] = {"leading": 0.5, "trailing": -0.5, "centre": 0.0}
"""Phase of the first harmonic per duty, in turns, with that edge of the pulse held in place."""


def widths(amplitude: ArrayLike, ticks: int, exponent: float = 2.0) -> Int:
    """Pulse width in ticks, round(ticks d(amplitude)), shape of amplitude, int32; 0 to ticks/2.

    AUTD3 has ticks = 512 and amplitude = i/255 for an intensity byte i. Raises DeviceError as `duty_cycle`.
    """
    return np.rint(_ticks(ticks) * duty_cycle(amplitude, exponent)).astype(np.int32)


def edge_phase(duty: ArrayLike, held: Edge) -> Float:
    """Phase of the first harmonic [rad] (later is positive) relative to a pulse about time 0.

    With the leading edge at time 0 the pulse's middle is pi d later; with the trailing edge, pi d earlier.
    A drive whose amplitude changes at a held edge therefore changes its phase; subtract this, as `pulses` does.
    """
    return 2.0 * np.pi * EDGE_TURNS[held] * np.asarray(duty, float)


def pulses(drive: ArrayLike, ticks: int, *, held: Edge = "centre", exponent: float = 2.0) -> tuple[Int, Int]:
    """Return start and width of each transducer's pulse in ticks, for a target complex amplitude.

    drive: complex amplitudes, |a| <= 1, e^{-iwt}, shape (n,)
    held: fixed part of the pulse without compensation: "leading" starts every pulse where one of half a period would
        start, so that smaller amplitudes come early; "trailing" the other way; "centre" compensates. Returns start in
        0..ticks-1 and width in 0..ticks/2, shapes (n,), int32.
    Raises DeviceError for |a| > 1 or not finite, an odd or too small number of ticks, a bad exponent.
    """
    amplitude = np.asarray(drive, np.complex128)
    width = widths(np.abs(amplitude), ticks, exponent)
    middle = ticks * np.angle(amplitude) / (2.0 * np.pi)
    half = 0.25 * ticks  # half the width of the fullest pulse
    slack = half - 0.5 * width
    start = middle - 0.5 * width + {"leading": -slack, "trailing": slack, "centre": 0.0}[held]
    return np.mod(np.rint(start), ticks).astype(np.int32), width


def emitted(start: ArrayLike, width: ArrayLike, ticks: int, exponent: float = 2.0) -> Complex:
    """Complex amplitude at the carrier of pulses given in ticks, relative to half a period's; inverse of `pulses`.

    start, width: shapes (n,); Returns shape (n,). Raises DeviceError for widths outside 0 to ticks/2.
    """
    duty = np.asarray(width, float) / _ticks(ticks)
    middle = np.asarray(start, float) / ticks + 0.5 * duty
    return relative_pressure(duty, exponent) * np.exp(2j * np.pi * middle)


def waveform(start: ArrayLike, width: ArrayLike, ticks: int) -> Float:
    """One period of each pulse train, 0 or 1, one sample a tick, shape (n, ticks). For plots and checks."""
    since = np.mod(np.arange(ticks) - np.asarray(start)[..., None], ticks)
    return (since < np.asarray(width)[..., None]).astype(float)


def resample(
    frames: ArrayLike, frame_rate_Hz: float, *, carrier_Hz: float = 40e3, cutoff_Hz: float | None = None, span: int = 8
) -> NDArray[np.inexact]:
    """Resample frames from the control rate to one value a carrier period by an FIR low-pass.

    Held frames make steps in the envelope, audible at the frame rate and its multiples; Hasegawa & Shinoda 2018 smooth
    the duty in this way (their filter is not printed; this one is a Kaiser-windowed sinc, about 60 dB).

    frames: duty, amplitude or drive by frame, real or complex, shape (frames, ...)
    cutoff_Hz: -6 dB; None is half the frame rate
    span: length of the filter in frames; it delays by span/2 frames on a real device, which is taken off here
    Returns shape (frames * carrier_Hz/frame_rate_Hz, ...): row j is at j/carrier_Hz, frame k at k/frame_rate_Hz. The
        first and last frame are held beyond the ends. It may overshoot: clip a duty to 0..1/2.
    Raises DeviceError where the carrier is no whole multiple of the frame rate, or for a bad cutoff or span.
    """
    from scipy.signal import firwin, upfirdn

    values = np.asarray(frames)
    if not (frame_rate_Hz > 0.0 and abs(carrier_Hz / frame_rate_Hz - round(carrier_Hz / frame_rate_Hz)) < 1e-9):
        raise DeviceError(
            f"frame rate {frame_rate_Hz} Hz does not divide the carrier {carrier_Hz:g} Hz: use for example 2000"
        )
    if span < 2 or span % 2:
        raise DeviceError(f"span = {span} frames is not even and at least 2: use for example 8")
    cutoff = 0.5 * frame_rate_Hz if cutoff_Hz is None else cutoff_Hz
    if not 0.0 < cutoff < 0.5 * carrier_Hz:
        raise DeviceError(f"cutoff_Hz = {cutoff} is not between 0 and half the carrier: use half the frame rate")
    up = round(carrier_Hz / frame_rate_Hz)
    taps = np.zeros((span + 1) * up)
    taps[: span * up + 1] = firwin(span * up + 1, cutoff, window=("kaiser", 6.0), fs=carrier_Hz)
    # Each of the `up` phases of the filter must pass a constant unchanged, or held frames would ripple.
    taps /= np.tile(taps.reshape(span + 1, up).sum(axis=0), span + 1)
    padded = np.concatenate([np.repeat(values[:1], span, axis=0), values, np.repeat(values[-1:], span, axis=0)])
    smooth = upfirdn(taps, padded, up=up, axis=0)
    first = span * up + span * up // 2
    return smooth[first : first + len(values) * up]


def _ticks(ticks: int) -> int:
    if ticks < 2 or ticks % 2:
        raise DeviceError(f"ticks = {ticks} is not even and at least 2: use for example {AUTD3_TICKS}")
    return ticks
