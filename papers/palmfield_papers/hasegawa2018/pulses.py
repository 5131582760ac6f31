"""Pulses of the units of the paper: their trains, and the duty cycle smoothed to the carrier rate."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from palmfield.drive.boards.autd2018 import CARRIER_HZ, PACKET_RATE_HZ
from palmfield.drive.pulse_width import HASEGAWA_TICKS
from palmfield.errors import DeviceError
from palmfield.types import Float


def duty_course(packet_widths: ArrayLike) -> Float:
    """Return the duty in each carrier period, shape (20 k,), for the pulse widths of k packets, in ticks.

    Units smooth the 2 kHz input by an FIR low-pass; see `resample`.
    """
    duty = np.asarray(packet_widths, float) / HASEGAWA_TICKS
    return np.clip(resample(duty, PACKET_RATE_HZ, carrier_Hz=CARRIER_HZ), 0.0, 0.5).astype(np.float64)


def waveform(start: ArrayLike, width: ArrayLike, ticks: int) -> Float:
    """Return one period of each pulse train, 0 or 1, one sample per tick, shape (n, ticks). For plots and checks."""
    since = np.mod(np.arange(ticks) - np.asarray(start)[..., None], ticks)
    return (since < np.asarray(width)[..., None]).astype(float)


def resample(
    frames: ArrayLike, frame_rate_Hz: float, *, carrier_Hz: float = 40e3, cutoff_Hz: float | None = None, span: int = 8
) -> NDArray[np.inexact]:
    """Resample frames from the control rate to one value per carrier period by an FIR low-pass.

    Constant frames cause steps in the envelope, which are audible at multiples of the frame rate. Hasegawa & Shinoda
    2018 smooth the duty cycle in this way. They do not print their filter; this one is a Kaiser-windowed sinc with
    about 60 dB attenuation.

    frames: duty, amplitude or drive by frame, real or complex, shape (frames, ...)
    cutoff_Hz: frequency with -6 dB; None is half the frame rate
    span: length of the filter in frames; its delay of span/2 frames on a real device is removed here
    Returns shape (frames * carrier_Hz/frame_rate_Hz, ...): row j is at j/carrier_Hz, frame k at k/frame_rate_Hz. The
        first and last frame are continued beyond the ends. The result may overshoot: clip a duty to 0..1/2.
    Raises DeviceError if the carrier is not a whole multiple of the frame rate, and for an invalid cutoff or span.
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
    # Each of the `up` phases of the filter must pass a constant unchanged; otherwise constant frames would ripple
    taps /= np.tile(taps.reshape(span + 1, up).sum(axis=0), span + 1)
    padded = np.concatenate([np.repeat(values[:1], span, axis=0), values, np.repeat(values[-1:], span, axis=0)])
    smooth = upfirdn(taps, padded, up=up, axis=0)
    first = span * up + span * up // 2
    return smooth[first : first + len(values) * up]
