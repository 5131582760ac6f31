"""Predict findings in mid-air by the observers: levels of simulated skin, without values from the findings.

The skin is palmfield's palm on bone, infinite and flat, under Gaussian spots of 10.3 mm (a 16 x 16 array at 200 mm),
and the motion is steady (`repeated_load`). Perceived strength is the highest level on the skin. Differences of levels
don't depend on p0. `python scripts/verification/predictions.py` writes the page.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from repeated_load import FlatLayer, RepeatedSpot

from palmfield.perception.observers import OBSERVERS, Observer, levels_dB_SL
from palmfield.skin.materials.catalogue import preset
from palmfield.types import Complex, Float, Float32

FWHM_M = 0.0103
DEPTHS_M = (0.01, 0.02)
NO_WAVES = 0.0
"""Value in place of a depth for a skin without wave propagation."""
HELD = 256
"""Number of positions per period of a continuous motion or modulation."""
HIGHEST_Hz = 500.0
"""Upper end of the longest table."""
BLOCK = 16
"""Number of lines per block."""
PACINIAN_Hz = 40.0
DIP_dB = 3.0
"""Dip of a gap between two spots.

It is the largest difference threshold of amplitude without masking, 1.65
to 2.98 dB (A. Israr et al., J. Acoust. Soc. Am. 120 (2006) 2789, abstract).
"""


@dataclass(frozen=True)
class Finding:
    """A finding and its prediction. quantity: in words; unit: of the predicted size; claim: predicted direction

    size: function of an observer and a depth [m]; holds: whether a size has the direction of the claim
    baseline: prediction from duration and energy alone, in words; baseline_holds: whether it has that direction
    """

    name: str
    stimulus: str
    quantity: str
    unit: str
    claim: str
    size: Callable[[Observer, float], float]
    holds: Callable[[float], bool]
    baseline: str
    baseline_holds: bool


class NoWaves(FlatLayer):
    """A skin whose points move only with their own pressure, 1 um/Pa at all frequencies.

    Nothing propagates in it, so a correct prediction by it is no evidence of waves.
    """

    def lines(self, spots: Sequence[RepeatedSpot], rate_Hz: float, orders: Sequence[int]) -> Complex:
        places = self.places()
        spread = FWHM_M / math.sqrt(8.0 * math.log(2.0))
        result = np.zeros((len(orders), len(places), len(places)), dtype=complex)
        for spot in spots:
            along_x, along_y = (
                np.exp(-0.5 * ((places[None] - spot.centres_m[:, axis, None]) / spread) ** 2) for axis in (0, 1)
            )
            number = np.asarray(orders, dtype=float)[:, None]
            edges = np.exp(2j * math.pi * number * np.arange(len(spot.peak_Pa) + 1) / len(spot.peak_Pa))
            weights = np.diff(edges, axis=1) / (1j * math.pi * number) * spot.peak_Pa
            result += np.einsum("nj,jy,jx->nyx", weights, along_y, along_x, optimize=True)
        return 1e-6 * result


def layer(depth_m: float) -> FlatLayer:
    """Return the palm of a depth [m]; the skin without waves for NO_WAVES."""
    return NoWaves(preset("palm"), DEPTHS_M[0]) if depth_m == NO_WAVES else FlatLayer(preset("palm"), depth_m)


def circle(circumference_m: float, points: int = HELD, begin: float = 0.0, peak_Pa: float = 1.0) -> RepeatedSpot:
    """Return a focus on a circle with this number of positions per turn; begin: in turns."""
    turns = 2.0 * math.pi * (np.arange(points) / points + begin)
    radius = circumference_m / (2.0 * math.pi)
    return RepeatedSpot(
        radius * np.column_stack([np.cos(turns), np.sin(turns)]), np.full(points, peak_Pa), FWHM_M
    )  # fmt: skip


def pressure_am(centre_m: Sequence[float] = (0.0, 0.0)) -> RepeatedSpot:
    """Return a fixed focus with a pressure sine of depth 1: ARP ((1 + sin)/2)^2, 1 Pa at its maximum."""
    phase = 2.0 * math.pi * (np.arange(HELD) + 0.5) / HELD
    return RepeatedSpot(np.tile(np.asarray(centre_m, float), (HELD, 1)), (0.5 * (1.0 + np.sin(phase))) ** 2, FWHM_M)


def to_and_fro(width_m: float, step_m: float) -> RepeatedSpot:
    """Return LM: a focus that rests at positions step_m apart, there and back, like path `lm`."""
    steps = round(width_m / step_m)
    there = np.linspace(-0.5 * width_m, 0.5 * width_m, steps + 1)
    x = np.concatenate([there, there[-2:0:-1]])
    return RepeatedSpot(np.column_stack([x, np.zeros_like(x)]), np.ones(len(x)), FWHM_M)


def level_map(
    observer: Observer, depth_m: float, spots: Sequence[RepeatedSpot], rate_Hz: float, least_Hz: float = 0.0
) -> Float:
    """Return the level at the layer's grid [dB SL], shape (cells, cells), of lines from least_Hz to HIGHEST_Hz."""
    last = min(HIGHEST_Hz, observer.frequency_Hz[-1])
    orders = [
        n for n in range(1, math.floor(last / rate_Hz) + 1) if n * rate_Hz >= max(least_Hz, observer.frequency_Hz[0])
    ]
    if not orders:
        return np.full((1, 1), -math.inf)
    key = tuple(
        (np.asarray(spot.centres_m, float).tobytes(), np.asarray(spot.peak_Pa, float).tobytes()) for spot in spots
    )
    lines = _amplitudes(key, depth_m, rate_Hz)[np.array(orders) - 1]
    levels = levels_dB_SL(observer, rate_Hz * np.array(orders), lines.reshape(len(orders), -1))
    return levels.reshape(lines.shape[1:])


@lru_cache(maxsize=64)
def _amplitudes(spots: tuple[tuple[bytes, bytes], ...], depth_m: float, rate_Hz: float) -> Float32:
    """Return peak amplitudes of all lines up to HIGHEST_Hz, for all observers [m/Pa], shape (n, cells, cells)."""
    pressed = [
        RepeatedSpot(np.frombuffer(centres).reshape(-1, 2), np.frombuffer(peaks), FWHM_M) for centres, peaks in spots
    ]
    orders = range(1, math.floor(HIGHEST_Hz / rate_Hz) + 1)
    parts = [
        np.abs(layer(depth_m).lines(pressed, rate_Hz, orders[i : i + BLOCK])) for i in range(0, len(orders), BLOCK)
    ]
    return np.concatenate(parts).astype(np.float32)


def strength(
    observer: Observer, depth_m: float, spots: Sequence[RepeatedSpot], rate_Hz: float, least_Hz: float = 0.0
) -> float:
    """Return the highest level on the skin [dB SL per Pa]."""
    return float(level_map(observer, depth_m, spots, rate_Hz, least_Hz).max())


SPEEDS = (0.5, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 10.0, 12.0, 15.0, 20.0)
CIRCUMFERENCES_M = (0.10, 0.15, 0.20)


def best_speed(observer: Observer, depth_m: float) -> float:
    """Return the mean over three circles of the speed with the highest level [m/s]."""
    return float(np.mean([_best_speed(observer, depth_m, length) for length in CIRCUMFERENCES_M]))


def _best_speed(observer: Observer, depth_m: float, length_m: float) -> float:
    levels = [strength(observer, depth_m, [circle(length_m)], speed / length_m) for speed in SPEEDS]
    return SPEEDS[int(np.argmax(levels))]


def gap_mm(observer: Observer, depth_m: float) -> float:
    """Return the least spacing of two spots with in-phase AM of 200 Hz at which the dip is DIP_dB [mm]."""
    spacings = np.arange(5.0, 61.0, 1.0)
    deep = [dip_dB(observer, depth_m, 1e-3 * spacing) >= DIP_dB for spacing in spacings]
    shallow = [i for i, one in enumerate(deep) if not one]
    first = shallow[-1] + 1 if shallow else 0
    return float(spacings[first]) if first < len(spacings) else math.inf


def dip_dB(observer: Observer, depth_m: float, spacing_m: float) -> float:
    """Return the lowest level on the line between two spots, below the higher of their centres' [dB]."""
    half = 0.5 * spacing_m
    levels = level_map(observer, depth_m, [pressure_am((-half, 0.0)), pressure_am((half, 0.0))], 200.0)
    places, middle = layer(depth_m).places(), levels.shape[0] // 2
    between = np.interp(np.linspace(-half, half, 61), places, levels[middle])
    return float(max(between[0], between[-1]) - between.min())


def fine_step_dB(observer: Observer, depth_m: float) -> float:
    """Return the level from 40 Hz of LM at 10 Hz on 6 mm, with steps of 0.2 mm minus steps of 2 mm [dB]."""
    fine, coarse = (
        strength(observer, depth_m, [to_and_fro(0.006, step)], 10.0, PACINIAN_Hz) for step in (0.0002, 0.002)
    )
    return fine - coarse


LM_RATES_Hz = (10.0, 50.0, 100.0, 200.0)
LM_RADIUS_M = 0.003


def lm_over_am_dB(observer: Observer, depth_m: float) -> float:
    """Return the least level over four rates of a circle of 3 mm radius, minus that of pressure AM [dB]."""
    moving = circle(2.0 * math.pi * LM_RADIUS_M)
    return min(
        strength(observer, depth_m, [moving], rate) - strength(observer, depth_m, [pressure_am()], rate)
        for rate in LM_RATES_Hz
    )


POINTS = (4, 8, 16, 32, 64, 128, 256)


def coarse_sampling_dB(observer: Observer, depth_m: float) -> float:
    """Return the best number of points per turn over the largest, in level at 5 turns/s minus that at 50 [dB]."""
    gains = []
    for rate in (5.0, 50.0):
        levels = [strength(observer, depth_m, [circle(0.2, points)], rate) for points in POINTS]
        gains.append(max(levels) - levels[-1])
    return gains[0] - gains[1]


TURNS_Hz = (2.0, 5.0, 8.0, 11.0, 14.0, 17.0)


def faster_dB(observer: Observer, depth_m: float) -> float:
    """Return the least rise of the level between successive rates of six, 2 to 17 Hz, circle of 12 cm [dB]."""
    levels = [strength(observer, depth_m, [circle(0.12)], rate) for rate in TURNS_Hz]
    return float(np.diff(levels).min())


def more_foci_dB(observer: Observer, depth_m: float) -> float:
    """Return the level of four foci with a quarter of the ARP, minus that of one; 20 cm circle, 7 m/s [dB]."""
    four = [circle(0.2, HELD, 0.25 * number, 0.25) for number in range(4)]
    return strength(observer, depth_m, four, 7.0 / 0.2) - strength(observer, depth_m, [circle(0.2)], 7.0 / 0.2)


def pointer_contrast_dB(observer: Observer, depth_m: float) -> float:
    """Return the contrast of a 200 Hz pointer minus that of an outline drawn 100 times per second [dB].

    The contrast is the level on the path minus that of the mean energy within half its radius, on a circle of 16 cm;
    the pointer moves slowly. The exact middle is not used: by symmetry all lines of a circle vanish there.
    """
    radius = 0.16 / (2.0 * math.pi)
    places = layer(depth_m).places()
    inner = np.hypot(places[:, None], places[None, :]) < 0.5 * radius
    contrasts = []
    for spots, rate in (([pressure_am((radius, 0.0))], 200.0), ([circle(0.16)], 100.0)):
        levels = level_map(observer, depth_m, spots, rate)
        on_path = float(np.interp(radius, places, levels[levels.shape[0] // 2]))
        contrasts.append(on_path - 10.0 * math.log10(float((10.0 ** (levels[inner] / 10.0)).mean())))
    return contrasts[0] - contrasts[1]


FINDINGS = (
    Finding(
        "STM speed", "one focus on circles of 10, 15 and 20 cm, 0.5 to 20 m/s", "speed of the highest level", "m/s",
        "a best speed between the ends, 1 to 15 m/s", best_speed, lambda v: 1.0 <= v <= 15.0,
        "no best speed: energy and duration are the same", False,
    ),
    Finding(
        "gap", "two foci, 200 Hz pressure AM in phase, 5 to 60 mm apart", f"least spacing with a dip of {DIP_dB:g} dB",
        "mm", "a gap opens, wider than the spot and below 60 mm", gap_mm, lambda d: 1e3 * FWHM_M <= d < 60.0,
        "no gap at any spacing: energy and duration are the same", False,
    ),
    Finding(
        "LM step", "LM at 10 Hz on 6 mm, steps of 0.2 against 2 mm", "lines from 40 Hz on, fine less coarse", "dB",
        "finer steps vibrate less", fine_step_dB, lambda d: d < 0.0,
        "the same: energy and duration are the same", False,
    ),
    Finding(
        "LM over AM", "circle of 3 mm radius against pressure AM of depth 1, same largest output; 10, 50, 100, 200 Hz",
        "the least of four differences", "dB", "LM is stronger at each of the four", lm_over_am_dB, lambda d: d > 0.0,
        "LM stronger by 4.3 dB at each: mean ARP 1 against 3/8", True,
    ),
    Finding(
        "sampling", "circle of 20 cm drawn by 4 to 256 points, 5 turns a second against 50",
        "gain of the best number of points over 256, slow less fast", "dB",
        "few points are stronger, and more so at slow rates", coarse_sampling_dB, lambda d: d > 0.0,
        "the same: energy and duration are the same", False,
    ),
    Finding(
        "rate of turns", "circle of 12 cm, 2 to 17 turns a second",
        "least rise from one of six rates to the next", "dB",
        "each is stronger than the slower one", faster_dB, lambda d: d > 0.0,
        "the same: energy and duration are the same", False,
    ),
    Finding(
        "more foci", "circle of 20 cm at 7 m/s by four foci of a quarter of the ARP each against one",
        "four less one", "dB", "four are weaker", more_foci_dB, lambda d: d < 0.0,
        "the same: energy and duration are the same", False,
    ),
    Finding(
        "tactile pointer", "circle of 16 cm: 200 Hz pointer that hardly moves against an outline at 100 turns a second",
        "level on the path less that of the mean energy within half its radius, pointer less outline", "dB",
        "the pointer stands out more", pointer_contrast_dB, lambda d: d > 0.0,
        "the same: energy and duration are the same", False,
    ),
)  # fmt: skip


def predicted(finding: Finding, depths_m: Sequence[float] = DEPTHS_M) -> dict[str, dict[str, float | None]]:
    """Return sizes by depth [mm] and observer; None if the observer has no value."""
    sizes: dict[str, dict[str, float | None]] = {}
    for depth in depths_m:
        row = {name: finding.size(observer, depth) for name, observer in OBSERVERS.items()}
        sizes[f"{1e3 * depth:g} mm"] = {name: value if math.isfinite(value) else None for name, value in row.items()}
    return sizes


def agreement(finding: Finding, sizes: dict[str, dict[str, float | None]]) -> tuple[int, int]:
    """Return how many sizes have the direction of the claim, and their number."""
    values = [value for row in sizes.values() for value in row.values() if value is not None]
    return sum(finding.holds(value) for value in values), len(values)
