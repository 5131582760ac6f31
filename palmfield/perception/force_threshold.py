"""Level above the only threshold measured in mid-air: the force of a stationary focus with AM on the palm.

The force is computed from the acoustic radiation pressure (ARP); the motion of the skin is not used.
"""

import math
from dataclasses import dataclass

import numpy as np

from palmfield.config import StimulusConfig
from palmfield.errors import OutputError
from palmfield.stimulus.modulation import period_s
from palmfield.stimulus.schedule import factors_at, main_frequencies
from palmfield.types import Float, Float32, Int

SAMPLES = 64
"""Number of samples in a period of the modulation, from which the power of its sine is computed."""
PUREST = 0.9
"""A modulation counts as a sine if its line has at least this share of the power: pressure AM of depth 1 has 0.94, a
square wave 0.81."""
NEAR_Hz = 1.0
SPLIT = 8
"""Number of parts of each triangle edge in the sum of the ARP: triangles at the rim are only partly in the disc."""


@dataclass(frozen=True)
class ForceObserver:
    """Detection threshold of the radiation force at one frequency.

    frequency_Hz: frequency of the modulation [Hz]; threshold_N: peak amplitude of the force at threshold [N]
    area_m2: disc about the highest ARP over which the force is summed [m^2]; mean_N: mean force measured [N]
    source, why, spread_dB, spread_of: as in `palmfield.perception.observers.Observer`
    """

    name: str
    frequency_Hz: float
    threshold_N: float
    area_m2: float
    mean_N: float
    source: str
    why: str
    spread_dB: float
    spread_of: str


FORCE_OBSERVER = ForceObserver(
    name="hasegawa_2018",
    frequency_Hz=200.0,
    threshold_N=0.4e-3,
    area_m2=144e-6,
    mean_N=10e-3,
    source="K. Hasegawa and H. Shinoda 2018: stationary focus on the palm, force of 10 mN plus a sine, Hann "
    "window of 1 s, shown twice; method of limits, 12 people. The lowest threshold is near 200 Hz, at beta 0.02 "
    "of 20 mN: 0.4 mN as printed. Equation 8 would exceed the largest force at beta 1; with the missing factor "
    "1/2, 0.4 mN is peak to peak, and levels are 6 dB higher. 20 mN is the force on 12 x 12 mm, half of the total "
    "force of such a focus. For other frequencies the paper has only a figure, which is not used here.",
    why="measured on the palm in mid-air, force on 1.44 cm2",
    spread_dB=10.0,
    spread_of="range of 15 to 20 dB between people; step of the method +-2 dB; 6 dB more if equation 8 lacks a "
    "factor 1/2",
)


def force_level_dB_SL(observer: ForceObserver, amplitude_N: float) -> float:
    """Return the level of an oscillating force above the threshold of the observer [dB]; -inf for amplitude 0.

    amplitude_N: peak amplitude of the force on the observer's area [N]. Raises OutputError if it is below 0.
    """
    if not amplitude_N >= 0.0:
        raise OutputError(f"amplitude_N is {amplitude_N}; allowed: 0 or more")
    return 20 * math.log10(amplitude_N / observer.threshold_N) if amplitude_N > 0.0 else -math.inf


def force_near_peak_N(vertices: Float, faces: Int, arp: Float | Float32, area_m2: float) -> float:
    """Return the surface integral of the ARP over a disc about the vertex with the highest ARP [N].

    vertices: [m], shape (n, 3); faces: shape (m, 3); arp: ARP at the vertices [Pa], shape (n,), linear between them
    area_m2: area of the disc [m^2]; on a curved surface, the part of it inside the sphere of the radius of the disc
    """
    radius = math.sqrt(area_m2 / math.pi)
    corners = vertices[faces] - vertices[int(np.argmax(arp))]
    # Triangles with all corners farther than the radius and the longest edge have no part in the sphere
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    near = np.linalg.norm(corners, axis=2).min(axis=1) < radius + longest
    corners, at_corners = corners[near], np.asarray(arp, dtype=np.float64)[faces[near]]
    shares = _parts_of_a_triangle(SPLIT)
    points = np.einsum("pk,mki->mpi", shares, corners)
    pressure = at_corners @ shares.T
    areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    inside = np.linalg.norm(points, axis=2) <= radius
    return float((np.where(inside, pressure, 0.0).sum(axis=1) * areas).sum()) / len(shares)


def why_refused(config: StimulusConfig) -> str | None:
    """Return in words why the threshold does not apply to a stimulus; None if it applies."""
    if config.path != "point":
        return f"it was measured with a stationary focus, but path is '{config.path}'"
    if config.foci_m:
        return f"it was measured with one focus, but the stimulus has {len(config.foci_m) // 3}"
    if config.burst_window != "none":
        return f"it was measured with a steady sine, but burst_window is '{config.burst_window}'"
    frequencies = main_frequencies(config)
    if not frequencies:
        return "it was measured with AM, but this sound is not modulated"
    frequency = frequencies[0]
    if period_s(config) is None:
        return "it was measured with a sine, but this modulation comes from a file"
    if abs(frequency - FORCE_OBSERVER.frequency_Hz) > NEAR_Hz:
        return (
            f"its threshold is printed for {FORCE_OBSERVER.frequency_Hz:g} Hz only, but the sound has {frequency:g} Hz"
        )
    purity = _share_of_line(config, frequency)
    if purity < PUREST:
        return (
            f"it was measured with a sine, but the sine has only {100 * purity:.0f} % of the power of this modulation"
        )
    return None


def _share_of_line(config: StimulusConfig, frequency: float) -> float:
    """Return the share of the line at a frequency [Hz] in the power of the modulation of the ARP after the ramp."""
    begin = config.start_s + config.ramp_s
    if config.am_waveform == "burst" and config.am_burst_length_s is not None:
        # One period at the maximum of the burst, where it is a sine as in the measurement
        begin = config.start_s + 0.5 * (config.am_burst_length_s - 1.0 / frequency)
    times = begin + np.arange(SAMPLES) / (SAMPLES * frequency)
    power = np.abs(np.fft.rfft(factors_at(config, times))[1:]) ** 2
    return float(power[0] / power.sum()) if power.sum() > 0.0 else 0.0


def _parts_of_a_triangle(count: int) -> Float:
    """Return the barycentric coordinates of the centres of count^2 equal parts, shape (count^2, 3)."""
    up = [(i + 1 / 3, j + 1 / 3) for i in range(count) for j in range(count - i)]
    down = [(i + 2 / 3, j + 2 / 3) for i in range(count - 1) for j in range(count - 1 - i)]
    first = np.array(up + down) / count
    return np.column_stack([first, 1.0 - first.sum(axis=1)])
