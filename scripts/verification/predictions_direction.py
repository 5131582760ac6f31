#!/usr/bin/env python3
"""Predictions by populations of afferents of two more findings: docs/gallery/predictions_direction.json.

python scripts/verification/predictions_direction.py [--out docs/gallery]   # about 5 minutes of processor

1. Direction of one pass of a focus along 16 cm at 0.5 to 11 m/s. The observer compares the mean spike times in the
   first and last quarter of the path. Its noise is that of judgements of the order of two touches, and the spread of
   the spike times themselves. No constant comes from the finding.
2. Level of a focus at rest with a sinusoidal force of 20 to 500 Hz, and of a rectangular one at 10 Hz.

Skins and constants are those of `predictions_populations`. The numbers are committed before `score_populations.py`
compares them with what was published. Known before: the text of the paper on direction (at chance at 4, 7 and 11 m/s)
and that on thresholds of force (lowest near 200 Hz, 0.4 mN; rectangles about 20 dB lower at 10 Hz).
"""

import argparse
import json
import math
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import predictions_felt as felt
import predictions_populations as pop
from repeated_load import FlatLayer, RepeatedSpot, transform
from scipy.interpolate import CubicSpline
from scipy.special import ndtr, ndtri

from palmfield.perception.afferents import AFFERENTS, largest_under_probe, spikes
from palmfield.perception.observers import OBSERVERS, levels_dB_SL
from palmfield.perception.populations import DENSITIES_PER_CM2
from palmfield.studies.bench.field import git_commit
from palmfield.types import Complex, Float

NUMBERS = "predictions_direction.json"
SPEEDS_M_S = (0.5, 1.0, 2.0, 4.0, 7.0, 11.0)
SLOW, FAST = (0.5, 1.0), (4.0, 7.0, 11.0)
PATH_M, ASIDE_M = 0.16, 0.02
"""Length of the path, and largest distance from it of the afferents that count."""
PERIOD_S, QUIET_S, STEP_S, HIGHEST_Hz = 0.5, 0.06, 1.25e-4, 1000.0
PLACES = 320
ORDER_S, ORDERS_S = 0.04, (0.02, 0.06)
"""Interval of two touches whose order is judged right in 75 %: 20 to 60 ms (S. Yamamoto and S. Kitazawa, Scholarpedia
10 (2015) 8249, first paragraph); the middle is used."""
LEVELS_Pa = (80.0, 320.0)
"""Peak ARP of the focus: the first is 10 mN on a spot of 10.3 mm, the second four times as much. The first counts."""
CHANCE = 0.563
"""Highest share that 240 fair trials reach in 95 %, as in rows R19 of the gallery."""
FREQUENCIES_Hz = (20.0, 30.0, 50.0, 80.0, 100.0, 150.0, 200.0, 250.0, 300.0, 400.0, 500.0)
THRESHOLD_N, PER_Pa_N = 0.4e-3, 83.9e-6
"""Force at threshold in the finding, and force on 144 mm2 (round) of a Gaussian spot of 10.3 mm per Pa."""


def one_pass(speed_m_s: float) -> RepeatedSpot:
    """Return a focus that moves along x once in a period, from QUIET_S on, and is silent then, peak 1 Pa."""
    count = round(PERIOD_S * speed_m_s / PATH_M * PLACES)
    x = -0.5 * PATH_M + (np.arange(PLACES) + 0.5) * (PATH_M / PLACES)
    centres, peaks = np.zeros((count, 2)), np.zeros(count)
    begin = round(QUIET_S / PERIOD_S * count)
    centres[begin : begin + PLACES, 0], peaks[begin : begin + PLACES] = x, 1.0
    return RepeatedSpot(centres, peaks, felt.FWHM_M)


def strip() -> tuple[Float, Float]:
    """Return the places of afferents, x and y [m], shapes (n,)."""
    places = felt.layer(felt.DEPTHS_M[0]).places()
    y, x = np.meshgrid(places, places, indexing="ij")
    inside = _inside()
    return x[inside], y[inside]


def _inside() -> Any:
    places = felt.layer(felt.DEPTHS_M[0]).places()
    return (np.abs(places) <= ASIDE_M)[:, None] & (np.abs(places) <= 0.5 * PATH_M)


@lru_cache(maxsize=8)
def _compliance(depth_m: float, ending_m: float, strain: bool) -> tuple[FlatLayer, Float, Complex]:
    layer = FlatLayer(felt.preset("palm"), depth_m)
    k = 2.0 * math.pi * np.fft.fftfreq(layer.cells, layer.span_m / layer.cells)
    length = np.hypot(k[:, None], k[None, :])
    table = np.linspace(1e-3, float(length.max()), 200)
    orders = range(math.floor(HIGHEST_Hz * PERIOD_S) + 1)
    values = np.array([layer._compliance(table, order / PERIOD_S, ending_m, strain) for order in orders])
    return layer, table, values


def motion(name: str, depth_m: float, speed_m_s: float) -> Float:
    """Return the motion at the endings of `strip` over a period per Pa [m], shape (t, n)."""
    afferent, spot = AFFERENTS[name], one_pass(speed_m_s)
    ending_m, strain = afferent.depth_m, afferent.quantity == "strain"
    orders = range(math.floor(HIGHEST_Hz * PERIOD_S) + 1)
    used = np.flatnonzero(spot.peak_Pa)
    weights = transform(spot, orders)[:, used]
    centres = spot.centres_m[used]
    spread = spot.fwhm_m / math.sqrt(8.0 * math.log(2.0))
    inside = _inside()
    if depth_m == felt.NO_WAVES:
        layer = FlatLayer(felt.preset("palm"), felt.DEPTHS_M[0])
        rest = RepeatedSpot(np.zeros((1, 2)), np.ones(1), spot.fwhm_m)
        middle = layer.cells // 2
        per_Pa = layer.lines([rest], 1.0, [0], depth_m=ending_m, compression=strain)[0, middle, middle].real
        x, y = strip()
        bells = np.exp(-0.5 * ((x[None] - centres[:, :1]) ** 2 + y[None] ** 2) / spread**2)
        lines = per_Pa * (weights @ bells)
    else:
        layer, table, values = _compliance(depth_m, ending_m, strain)
        k = 2.0 * math.pi * np.fft.fftfreq(layer.cells, layer.span_m / layer.cells)
        length = np.hypot(k[:, None], k[None, :])
        along = np.exp(-1j * np.outer(centres[:, 0], k))
        bell = 2.0 * math.pi * spread**2 * np.exp(-0.5 * (length * spread) ** 2)
        lines = np.empty((len(values), int(inside.sum())), dtype=complex)
        for row, value in enumerate(values):
            # All centres are on y = 0
            waves = CubicSpline(table, value)(np.maximum(length, table[0])) * bell * (weights[row] @ along)[None]
            lines[row] = (np.fft.fftshift(np.fft.ifft2(waves)) * (layer.cells / layer.span_m) ** 2)[inside]
    samples = round(PERIOD_S / STEP_S)
    spectrum = np.zeros((samples // 2 + 1, lines.shape[1]), dtype=complex)
    spectrum[: len(lines)] = 0.5 * samples * np.conj(lines)
    spectrum[0] *= 2.0
    return np.fft.irfft(spectrum, samples, axis=0) / largest_under_probe(afferent)


def times_at_ends(depth_m: float, speed_m_s: float, peak_Pa: float) -> list[tuple[float, float, float]]:
    """Return, for the first and the last quarter of the path, number of spikes, and mean and spread of their times [s].

    Spikes of a class count by its density.
    """
    x, _ = strip()
    weights, moments, places = [], [], []
    for name, afferent in AFFERENTS.items():
        time, unit = spikes(afferent, peak_Pa * _motion(name, depth_m, speed_m_s), STEP_S)
        weights.append(np.full(len(time), DENSITIES_PER_CM2["palm"][name]))
        moments.append(time)
        places.append(x[unit])
    weight, moment, place = (np.concatenate(parts) for parts in (weights, moments, places))
    result = []
    for zone in (place < -0.25 * PATH_M, place > 0.25 * PATH_M):
        total = weight[zone].sum()
        mean = float((weight[zone] * moment[zone]).sum() / total) if total else math.nan
        spread = math.sqrt(float((weight[zone] * (moment[zone] - mean) ** 2).sum() / total)) if total else math.nan
        result.append((float(zone.sum()), mean, spread))
    return result


@lru_cache(maxsize=3)
def _motion(name: str, depth_m: float, speed_m_s: float) -> Float:
    return motion(name, depth_m, speed_m_s)


def share_right(ends: list[tuple[float, float, float]], order_s: float = ORDER_S) -> float:
    """Return the share of right answers; 0.5 if a zone has no spikes."""
    (first, begin, one), (last, end, other) = ends
    if not (first and last):
        return 0.5
    noise_s = order_s / float(ndtri(0.75))
    return float(ndtr((end - begin) / math.hypot(noise_s, one, other)))


def by_duration(speed_m_s: float) -> float:
    """Return the share by the duration alone: the time between the middles of the two zones."""
    return float(ndtr(0.75 * PATH_M / speed_m_s / (ORDER_S / float(ndtri(0.75)))))


def direction() -> dict[str, Any]:
    """Return the shares of right answers, by depth, level and interval, and speed."""
    found: dict[str, Any] = {"duration": {f"{speed:g}": by_duration(speed) for speed in SPEEDS_M_S}}
    for depth_m in pop.DEPTHS_M:
        for speed in SPEEDS_M_S:
            for peak_Pa in LEVELS_Pa:
                ends = times_at_ends(depth_m, speed, peak_Pa)
                row = found.setdefault(pop._depth(depth_m), {}).setdefault(f"{peak_Pa:g} Pa", {})
                row[f"{speed:g}"] = {
                    "share": share_right(ends), "spikes": [ends[0][0], ends[1][0]],
                    "apart_s": ends[1][1] - ends[0][1], "spread_s": [ends[0][2], ends[1][2]],
                    "other_intervals": [share_right(ends, one) for one in ORDERS_S],
                }  # fmt: skip
                print(depth_m, speed, peak_Pa, row[f"{speed:g}"], flush=True)
    return found


def sine(rectangle: bool = False) -> RepeatedSpot:
    """Return a focus at rest with a sinusoidal or rectangular pressure of amplitude 1 Pa without its mean."""
    phase = 2.0 * math.pi * (np.arange(felt.HELD) + 0.5) / felt.HELD
    course = np.sign(np.sin(phase)) if rectangle else np.sin(phase)
    return RepeatedSpot(np.zeros((felt.HELD, 2)), course, felt.FWHM_M)


def level_dB(depth_m: float, frequency_Hz: float, rectangle: bool = False) -> float:
    """Return the level of the populations at a force of THRESHOLD_N [dB SL]."""
    return pop.strength(None, depth_m, [sine(rectangle)], frequency_Hz) + 20.0 * math.log10(THRESHOLD_N / PER_Pa_N)


def point_dB(frequency_Hz: float, rectangle: bool = False) -> float:
    """Return the level of one surface point under the middle of the spot, 10 mm, by bolanowski_1988 [dB SL]."""
    layer, orders = (
        FlatLayer(felt.preset("palm"), felt.DEPTHS_M[0]),
        list(range(1, max(2, int(500 / frequency_Hz) + 1))),
    )
    lines = layer.lines([sine(rectangle)], frequency_Hz, orders)[:, layer.cells // 2, layer.cells // 2]
    moved = np.abs(lines)[:, None] * THRESHOLD_N / PER_Pa_N
    return float(levels_dB_SL(OBSERVERS["bolanowski_1988"], frequency_Hz * np.array(orders), moved)[0])


def frequencies() -> dict[str, Any]:
    found: dict[str, Any] = {}
    for depth_m in pop.DEPTHS_M:
        row = found[pop._depth(depth_m)] = {f"{f:g}": level_dB(depth_m, f) for f in FREQUENCIES_Hz}
        row["10"], row["10 rectangle"] = level_dB(depth_m, 10.0), level_dB(depth_m, 10.0, True)
        print(depth_m, row, flush=True)
    row = found["one surface point"] = {f"{f:g}": point_dB(f) for f in FREQUENCIES_Hz}
    row["10"], row["10 rectangle"] = point_dB(10.0), point_dB(10.0, True)
    print(row)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=pop.ROOT / "docs" / "gallery", help="folder of the numbers")
    args = parser.parse_args()
    numbers = {
        "commit": git_commit(),
        "constants": {
            "path_m": PATH_M, "aside_m": ASIDE_M, "order_s": ORDER_S, "orders_s": ORDERS_S, "levels_Pa": LEVELS_Pa,
            "chance": CHANCE, "threshold_N": THRESHOLD_N, "per_Pa_N": PER_Pa_N,
        },
        "claims": CLAIMS, "direction": direction(), "frequency": frequencies(),
    }  # fmt: skip
    (args.out / NUMBERS).write_text(json.dumps(pop._rounded(numbers), indent=1) + "\n", encoding="utf-8")


CLAIMS = {
    "direction, slow": "at 0.5 and 1 m/s the direction is judged right in 75 % or more",
    "direction, fast": f"at 4, 7 and 11 m/s it is judged at chance, {100 * CHANCE:.1f} % or less",
    "direction, order": "the share falls from each speed to the next",
    "best frequency": "the level is highest between 100 and 300 Hz",
    "threshold at 200 Hz": "0.4 mN at 200 Hz is within 10 dB of the threshold",
    "rectangle": "a rectangle of 10 Hz is felt more than a sine of its amplitude",
}

if __name__ == "__main__":
    main()
