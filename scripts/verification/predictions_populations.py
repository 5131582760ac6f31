#!/usr/bin/env python3
"""Predictions of mid-air findings by populations of afferents: docs/gallery/predictions_populations.json.

python scripts/verification/predictions_populations.py [--out docs/gallery]   # about 15 minutes of processor

The findings and stimuli are those of `predictions_felt`, and one more: steady pressure by slow LM. The skin is the
same, 10 and 20 mm of palm on bone, and a skin without waves, in which each point follows the pressure on it alone. All
constants are those of `palmfield.perception.populations`, from thresholds under probes and a contactor. The numbers are
committed before `score_populations.py` compares them with what was published.
"""

import argparse
import json
import math
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

import numpy as np
import predictions_felt as felt
import scipy.signal
from numpy.typing import NDArray
from repeated_load import FlatLayer, RepeatedSpot, transform
from scipy.signal import lfilter

from palmfield.perception.afferents import AFFERENTS, largest_under_probe
from palmfield.perception.observers import Observer
from palmfield.perception.populations import DENSITIES_PER_CM2, POPULATIONS, class_level_dB
from palmfield.studies.bench.field import git_commit
from palmfield.types import Complex, Float

ROOT = Path(__file__).resolve().parents[2]
NUMBERS = "predictions_populations.json"
DEPTHS_M = (*felt.DEPTHS_M, felt.NO_WAVES)
STEP_S = 1.25e-4
HAND_M = 0.07
"""Half edge of the square of skin with afferents."""
PLACES = 2000
"""Number of places whose time courses are computed together."""
HELD_N, FELT_N = 0.027, 0.21
"""Force of the sound, and the force of equal sensation, in the finding on steady pressure."""


Key = tuple[tuple[bytes, bytes], ...]


@lru_cache(maxsize=3)
def motion_lines(ending_m: float, strain: bool, depth_m: float, spots: Key, rate_Hz: float) -> Complex:
    """Return the lines of the motion at endings, from the mean on, per Pa: (n, p) at the places of `near`."""
    pressed = [RepeatedSpot(np.frombuffer(c).reshape(-1, 2), np.frombuffer(p), felt.FWHM_M) for c, p in spots]
    orders = range(math.floor(felt.HIGHEST_Hz / rate_Hz) + 1)
    layer = FlatLayer(felt.preset("palm"), depth_m or felt.DEPTHS_M[0])
    if depth_m != felt.NO_WAVES:
        return layer.lines(pressed, rate_Hz, orders, depth_m=ending_m, compression=strain)[:, near()]
    # The static motion under the middle of a spot, at each place from the pressure there
    middle, places = layer.cells // 2, layer.places()
    rest = RepeatedSpot(np.zeros((1, 2)), np.ones(1), felt.FWHM_M)
    per_Pa = layer.lines([rest], 1.0, [0], depth_m=ending_m, compression=strain)[0, middle, middle].real
    spread = felt.FWHM_M / math.sqrt(8.0 * math.log(2.0))
    result = np.zeros((len(orders), len(places), len(places)), dtype=complex)
    for spot in pressed:
        along = [np.exp(-0.5 * ((places[None] - spot.centres_m[:, axis, None]) / spread) ** 2) for axis in (0, 1)]
        bells = (along[1][:, :, None] * along[0][:, None, :]).reshape(len(along[0]), -1)
        result += (transform(spot, orders) @ bells).reshape(result.shape)
    return per_Pa * result[:, near()]


def near() -> NDArray[np.bool_]:
    """Return which grid points have afferents, (cells, cells): a square of the size of a hand."""
    inside = np.abs(felt.layer(felt.DEPTHS_M[0]).places()) < HAND_M
    return inside[:, None] & inside


@lru_cache(maxsize=64)
def _unit_levels(name: str, depth_m: float, spots: Key, rate_Hz: float) -> Float:
    """Return the level of a unit at each place, over its threshold and per Pa, (cells, cells); steady motion."""
    afferent = AFFERENTS[name]
    lines = motion_lines(afferent.depth_m, afferent.quantity == "strain", depth_m, spots, rate_Hz)
    lines = lines / largest_under_probe(afferent)
    turn = 2.0 * math.pi
    analogue = [turn * np.array(one) for one in (afferent.zeros_Hz, afferent.poles_Hz)]
    _, passed = scipy.signal.freqs_zpk(*analogue, afferent.gain_per_m, turn * rate_Hz * np.arange(len(lines)))
    samples = max(64, math.ceil(1.0 / rate_Hz / STEP_S))
    times = np.arange(samples) / samples / rate_Hz
    # Lines are under e^{-iwt}, the filter under e^{+iwt}
    waves = np.exp(-1j * turn * rate_Hz * np.outer(times, np.arange(len(lines)))) * np.conj(passed)
    left = math.exp(-1.0 / (rate_Hz * samples * afferent.tau_s))
    levels = np.empty(lines.shape[1])
    for first in range(0, lines.shape[1], PLACES):
        part = slice(first, first + PLACES)
        driven = np.maximum((waves @ lines[:, part]).real, 0.0)
        once = lfilter([0.5 * (1.0 - left)] * 2, [1.0, -left], driven, axis=0)
        begin = once[-1] / (1.0 - left**samples)
        levels[part] = (once + begin * left ** np.arange(1, samples + 1)[:, None]).max(axis=0)
    result = np.full(near().shape, 1e-12)
    result[near()] = levels
    return result


def unit_levels(name: str, depth_m: float, spots: Sequence[RepeatedSpot], rate_Hz: float) -> Float:
    key = tuple((np.asarray(one.centres_m, float).tobytes(), np.asarray(one.peak_Pa, float).tobytes()) for one in spots)
    return _unit_levels(name, depth_m, key, rate_Hz)


def classes_of(least_Hz: float) -> tuple[str, ...]:
    """Return the classes that count; vibration from 40 Hz on is that of PC."""
    return ("pc",) if least_Hz >= felt.PACINIAN_Hz else tuple(AFFERENTS)


def strength(_: Any, depth_m: float, spots: Sequence[RepeatedSpot], rate_Hz: float, least_Hz: float = 0.0) -> float:
    """Return the level of the population [dB SL per Pa], like `predictions_felt.strength` for an observer."""
    cell_cm2 = 1e4 * (felt.layer(felt.DEPTHS_M[0]).span_m / felt.layer(felt.DEPTHS_M[0]).cells) ** 2
    found = []
    for name in classes_of(least_Hz):
        levels = unit_levels(name, depth_m, spots, rate_Hz).ravel()
        units = DENSITIES_PER_CM2["palm"][name] * cell_cm2
        found.append(class_level_dB(name, levels * (math.sqrt(units) if name == "pc" else 1.0)))
    return max(found)


def level_map(_: Any, depth_m: float, spots: Sequence[RepeatedSpot], rate_Hz: float, least_Hz: float = 0.0) -> Float:
    """Return the level of the most excited class of units at each place [dB], for the gap and the pointer."""
    levels = [unit_levels(name, depth_m, spots, rate_Hz) for name in classes_of(least_Hz)]
    with np.errstate(divide="ignore"):
        return 20.0 * np.log10(np.max(levels, axis=0))


def steady_pressure_dB(depth_m: float) -> float:
    """Return the level of SA1 under LM at 5 Hz, 6 mm, steps of 0.2 mm, less that under the same spot at rest [dB]."""
    moving, rest = felt.to_and_fro(0.006, 0.0002), RepeatedSpot(np.zeros((1, 2)), np.ones(1), felt.FWHM_M)
    levels = [unit_levels("sa1", depth_m, [one], 5.0).max() for one in (moving, rest)]
    return 20.0 * math.log10(levels[0] / levels[1])


def compute() -> dict[str, Any]:
    commit, found = git_commit(), []
    felt.strength, felt.level_map = strength, level_map
    observer = cast(Observer, POPULATIONS["population_all"])
    for finding in felt.FINDINGS:
        sizes = {_depth(depth): finding.size(observer, depth) for depth in DEPTHS_M}
        holds = {depth: bool(finding.holds(size)) for depth, size in sizes.items()}
        found.append(
            {"name": finding.name, "unit": finding.unit, "claim": finding.claim, "sizes": sizes, "holds": holds}
        )
        print(finding.name, sizes, holds, flush=True)
    sizes = {_depth(depth): steady_pressure_dB(depth) for depth in DEPTHS_M}
    found.append({
        "name": "steady pressure", "unit": "dB",
        "claim": "slow LM with fine steps excites SA1 more than a spot at rest",
        "sizes": sizes, "holds": {depth: size > 0.0 for depth, size in sizes.items()},
    })  # fmt: skip
    print("steady pressure", sizes)
    return {"commit": commit, "findings": [_rounded(one) for one in found]}


def _depth(depth_m: float) -> str:
    return "no waves" if depth_m == felt.NO_WAVES else f"{1e3 * depth_m:g} mm"


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _rounded(one) for key, one in value.items()}
    if isinstance(value, float):
        return float(f"{value:.4g}") if math.isfinite(value) else None
    return value


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "gallery", help="folder of the numbers")
    args = parser.parse_args()
    (args.out / NUMBERS).write_text(json.dumps(compute(), indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
