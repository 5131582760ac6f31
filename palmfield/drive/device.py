"""What a device can play, and what comes out when it is asked for more."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from palmfield.drive import sonicsurface
from palmfield.errors import DeviceError
from palmfield.types import Complex


@dataclass(frozen=True)
class Device:
    """Limits of a device.

    max_frame_rate_Hz: frames that reach it a second, inf for none
    amplitude: whether each transducer takes any amplitude, or only off and full
    """

    name: str
    max_frame_rate_Hz: float
    amplitude: Literal["continuous", "on_off"]
    description: str


DEVICES = {
    "ideal": Device("ideal", math.inf, "continuous", "plays every amplitude and phase at once and without rounding"),
    "sonicsurface": Device(
        "sonicsurface",
        sonicsurface.FRAME_RATE_HZ,
        "on_off",
        "SonicSurface, 256 emitters at 230400 baud: 32 phases, off or full (50 % duty), 89.3 frames/s",
    ),
}


def play(device: Device, amplitudes: ArrayLike) -> Complex:
    """What the device emits when asked for `amplitudes`.

    amplitudes: complex amplitude of each transducer relative to full drive, e^{-iwt}, shape (n,), in address order
    Returns the same shape: unchanged from the ideal device, through the bytes and the board's state machine for a
    SonicSurface.
    Raises DeviceError for what the device cannot play, and for a device that is not in DEVICES.
    """
    if device.name == "ideal":
        return np.array(amplitudes, dtype=np.complex128)
    if device.name == "sonicsurface":
        return sonicsurface.decode(sonicsurface.encode(amplitudes))[-1]
    raise DeviceError(f"device '{device.name}' is not known; use one of {', '.join(DEVICES)}")


def check(
    device: Device, *, frame_rate_Hz: float, points_per_turn: float | None = None, modulated: bool, element: str
) -> None:
    """Refuse a stimulus that the device cannot play.

    frame_rate_Hz: drive frames a second that the stimulus needs, 0 when it stands still
    points_per_turn: points on each turn of a closed path at that rate, None when there is no path
    modulated: whether the amplitude takes values between 0 and full
    element: what the scene calls the stimulus, for the message
    Raises DeviceError that says what the scene needs and what the device gives.
    """
    needs_amplitude = modulated and device.amplitude == "on_off"
    too_fast = frame_rate_Hz > device.max_frame_rate_Hz
    if not needs_amplitude and not too_fast:
        return
    amplitude = "continuous amplitude at " if needs_amplitude else ""
    needs = f"stimulus '{element}' needs {amplitude}{frame_rate_Hz:.4g} frames/s"
    gives = f"{device.name} gives {'on/off' if device.amplitude == 'on_off' else 'any'} amplitude"
    gives += f" at {device.max_frame_rate_Hz:.1f} frames/s"
    if points_per_turn is not None and too_fast:
        needs += f" ({points_per_turn:.4g} points a turn)"
        gives += f", {points_per_turn * device.max_frame_rate_Hz / frame_rate_Hz:.2g} points a turn"
    mends = ["device ideal"]
    if needs_amplitude:
        gives += f", so on/off AM up to {device.max_frame_rate_Hz / 2:.1f} Hz"
        mends.append("modulation none")
    if too_fast:
        mends.append(f"at most {math.floor(device.max_frame_rate_Hz)} frames/s")
    raise DeviceError(f"{needs}; {gives}: use {' or '.join(mends)}")
