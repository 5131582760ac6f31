#!/usr/bin/env python3
"""Measure how often the guided mode of a scan is resolved, and its error: docs/bench/guided_modes.md.

python scripts/bench/guided_modes.py --seed SEED [--again SEED ...] [--random 100] [--out docs/bench/guided_modes.md]

The scans are of bonded layers, computed by elements through the depth (tests/helpers), a different model from that of
the fit. Each has a fractional material, beams at 45 degrees that also measure motion along the surface, an error of
1 mm in the position of the grid, and noise. First there is a table of layers and frequencies, then layers, materials,
grids, beams and noise are random. The Cramer-Rao bound is listed with each answer: no unbiased estimator has a smaller
standard deviation in such noise if it knows the number of waves and their true values, and only fits their amplitudes
and the place of the source.
"""

import argparse
import math
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.special import hankel1

from palmfield.instruments import disc_grid, guided_mode_fit
from palmfield.instruments.guided_mode import LEAST_POINTS_A_WAVE, LEAST_WAVES, SURE
from palmfield.studies.bench.table import keep_rows

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests" / "helpers"))

from guided_layer import GuidedLayer, fractional  # noqa: E402 - tests' helpers are no package

THICKNESSES_M = (0.004, 0.006, 0.008, 0.01, 0.015, 0.02)
FREQUENCIES_HZ = (120.0, 160.0, 200.0, 250.0, 300.0, 350.0, 400.0)
LIMIT = 0.03
REASONS = {
    "wavelengths; needed": "scan too short",
    "points per wavelength; needed": "points too sparse",
    "decays": "decays too fast",
    "below the noise": "possible hidden wave",
    "uncertainty": "noise",
}
"""Kinds of reasons, by words of `palmfield.instruments.guided_mode.guided_mode_fit`."""
COUNTED = 0.03
"""Waves with a smaller share of the motion are omitted from the bound: their amplitudes would only widen it."""


class Case(NamedTuple):
    """A simulated scan: layer, material as of `fractional`, grid, beam and noise."""

    f_Hz: float
    thickness_m: float
    stiff_Pa: float = 8e3
    pot_Pa: float = 6e3
    power: float = 0.3
    half_m: float = 0.06
    pitch_m: float = 0.005
    spot_m: float = 0.0103
    snr_dB: float = 20.0
    angle_deg: float = 45.0


class Answer(NamedTuple):
    """Result of a scan.

    true: the strongest travelling wave; bound: its bound; reported: result of the fit; error: its error

    right: whether each reported wave is within LIMIT of a wave of the layer, and the strongest is that of the layer or
    has at least 0.8 of its amplitude
    """

    case: Case
    true: complex | None
    bound: float
    wide: bool
    reported: complex | None
    error: float
    right: bool
    others: int
    reason: str
    seconds: float


def answered(case: Case, rng: np.random.Generator) -> Answer:
    """Make a scan, fit it, and compare."""
    material = fractional(case.f_Hz, case.stiff_Pa, case.pot_Pa, 100.0, case.power)
    layer = GuidedLayer(case.f_Hz, material, case.thickness_m)
    grid = disc_grid(case.half_m, case.pitch_m)
    turn, near, tilt = rng.uniform(0.0, 2.0 * math.pi), 1.55 * case.spot_m, math.tan(math.radians(case.angle_deg))
    true = grid[:, :2] + 1e-3 * np.array([math.cos(turn), math.sin(turn)])
    r = np.maximum(np.linalg.norm(true, axis=1), 1e-9)
    down, out = layer.under_spot(r, case.spot_m, 800)
    read = -down + tilt * out * true[:, 0] / r
    far = np.linalg.norm(grid[:, :2], axis=1) > near
    rms = float(np.sqrt(np.mean(np.abs(read[far]) ** 2)))
    noise = rms * 10.0 ** (-case.snr_dB / 20.0) / math.sqrt(2.0)
    k, fields = layer.seen(case.spot_m, true[far], tilt)
    motion = np.sqrt(np.mean(np.abs(fields) ** 2, axis=1)) / rms
    sights = np.tile([tilt, 0.0, 1.0], (len(grid), 1))
    begun = time.perf_counter()
    dirty = read + noise * (rng.normal(size=len(r)) + 1j * rng.normal(size=len(r)))
    found = guided_mode_fit(dirty, grid, [0.0, 0.0], near, sights=sights)
    seconds = time.perf_counter() - begun
    travels = np.where(k.real > k.imag, motion, 0.0)
    if not travels.any():
        return Answer(case, None, math.inf, False, found.wavenumber_rad_m, math.inf, found.wavenumber_rad_m is None, 0,
                      found.reason, seconds)  # fmt: skip
    lead = int(travels.argmax())
    counted = np.flatnonzero((motion > COUNTED) | (np.arange(len(k)) == lead))
    bounds = bound(k[counted], fields[counted], true[far], tilt, noise)
    waves, points = 2.0 * case.half_m * k.real / (2.0 * math.pi), 2.0 * math.pi / (k.real * case.pitch_m)
    wide = bool(waves[lead] >= LEAST_WAVES and points[lead] >= LEAST_POINTS_A_WAVE)
    every = [found.wavenumber_rad_m, *(one.wavenumber_rad_m for one in found.others)]
    apart = [float((np.abs(one - k) / np.abs(k)).min()) for one in every if one is not None]
    right = all(one <= LIMIT for one in apart)
    error = math.inf
    if found.wavenumber_rad_m is not None:
        own = int((np.abs(found.wavenumber_rad_m - k) / np.abs(k)).argmin())
        error = apart[0]
        right = right and bool(travels[own] >= 0.8 * travels[lead])
    return Answer(
        case, complex(k[lead]), float(bounds[list(counted).index(lead)]), wide, found.wavenumber_rad_m, error, right,
        sum(one is not None for one in every[1:]), found.reason, seconds,
    )  # fmt: skip


def bound(k: Any, fields: Any, ways: Any, tilt: float, noise: float) -> Any:
    """Return the Cramer-Rao bound of each wavenumber relative to |k|; amplitudes and source position are free."""

    def rings(one: complex, at: Any) -> Any:
        r = np.linalg.norm(at, axis=1)
        h0, h1 = hankel1(0, one * r), hankel1(1, one * r) * at[:, 0] / r
        return np.stack([h0, h1], axis=1) if tilt else h0[:, None]

    def slope(at: Any, step: Any) -> Any:
        return (at(step) - at(-step)) / (2.0 * step)

    columns: list[Any] = []
    moved = [np.zeros(len(ways), complex), np.zeros(len(ways), complex)]
    for one, field in zip(k, fields, strict=True):
        shapes = rings(one, ways)
        parts = np.linalg.lstsq(shapes, field, rcond=None)[0]
        by_k = slope(lambda step, one=one, parts=parts: rings(one + step, ways) @ parts, 1e-4 * abs(one))
        for column in (by_k, *shapes.T):
            columns += [column, 1j * column]
        for axis, way in enumerate(np.eye(2)):
            moved[axis] += slope(lambda d, one=one, parts=parts, way=way: rings(one, ways + d * way) @ parts, 1e-7)
    columns += moved
    jacobian = np.stack(columns, axis=1)
    jacobian = np.vstack([jacobian.real, jacobian.imag])
    sizes = np.linalg.norm(jacobian, axis=0)
    covariance = np.linalg.pinv((jacobian / sizes).T @ (jacobian / sizes), rcond=1e-14) * noise**2
    spread = np.sqrt(np.diag(covariance)) / sizes
    each = 6 if tilt else 4
    return np.hypot(spread[:-2:each], spread[1:-2:each]) / np.abs(k)


def drawn(rng: np.random.Generator) -> Case:
    """Return a random case."""
    return Case(
        rng.uniform(80.0, 500.0), rng.uniform(0.003, 0.025), 8e3 * math.exp(rng.uniform(-1.0, 1.0)),
        6e3 * math.exp(rng.uniform(-1.0, 0.7)), rng.uniform(0.15, 0.5), rng.uniform(0.04, 0.08),
        rng.uniform(0.003, 0.007), rng.uniform(0.008, 0.014), rng.uniform(14.0, 34.0),
        float(rng.choice([0.0, 30.0, 45.0, 60.0])),
    )  # fmt: skip


def summary(draw: str, answers: list[Answer]) -> str:
    """Return the counts of a series as a row of the table on the page."""
    wide = [one for one in answers if one.wide]
    reported = [one for one in answers if one.reported is not None]
    errors = sorted(one.error for one in reported) or [math.nan]
    bounded = [one for one in wide if one.bound < SURE]
    missed = [one for one in bounded if one.reported is None]
    wrong = sum(not one.right for one in answers)
    return (
        f"| {draw} | {len(answers)} | {len(wide)} | {len(reported)} ({sum(one.wide for one in reported)}) "
        f"| {100 * np.median(errors):.2g}, {100 * errors[-1]:.2g} | {sum(one.others for one in answers)} | {wrong} "
        f"| {len(wide) - len(bounded)} | {len(missed)} of {len(bounded)} "
        f"| {np.median([one.seconds for one in answers]):.2g} |"
    )


def short(reason: str) -> str:
    """Return the kind of a reason of `guided_mode_fit` for a wave that is not resolved."""
    return next((kind for words, kind in REASONS.items() if words in reason), reason)


def table(snr: float, answers: list[Answer]) -> list[str]:
    lines = []
    for one in answers:
        if one.true is None:
            continue
        outcome = f"{100 * one.error:.2g} % off" if one.reported is not None else short(one.reason)
        outcome += "" if one.others == 0 else f", and {one.others} more"
        lines.append(
            f"| {snr:g} | {1e3 * one.case.thickness_m:g} | {one.case.f_Hz:g} "
            f"| {one.true.real:.0f} + {one.true.imag:.0f}i | {100 * one.bound:.2g} "
            f"| {outcome}{'' if one.right else ' **wrong**'} |"
        )
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--again", type=int, nargs="*", default=[], help="seeds of further draws of the table's noise")
    parser.add_argument("--random", type=int, default=100, help="scans drawn at random")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    lines, rows = [], []
    for number, seed in enumerate([options.seed, *options.again]):
        for snr in (20.0, 34.0) if number == 0 else (20.0,):
            rng = np.random.default_rng([seed, int(snr)])
            answers = []
            for thickness in THICKNESSES_M:
                for frequency in FREQUENCIES_HZ:
                    answers.append(answered(Case(frequency, thickness, snr_dB=snr), rng))
                    print(answers[-1], flush=True)
            answers = [one for one in answers if one.true is not None]
            lines.append(summary(f"grid, {snr:g} dB, seed {seed}", answers))
            if number == 0:
                rows += table(snr, answers)
    if options.random:
        rng = np.random.default_rng(options.seed)
        answers = []
        for _ in range(options.random):
            answers.append(answered(drawn(rng), rng))
            print(answers[-1], flush=True)
        lines.append(summary(f"at random, seed {options.seed}", answers))
    print("\n".join(lines))
    if options.out is not None:
        link = keep_rows(options.out, [*ROWS, *rows])
        options.out.write_text(HEAD.format(link=link) + "\n".join(lines) + "\n", encoding="utf-8")


ROWS = ["| SNR dB | layer mm | Hz | strongest wave rad/m | bound % | answer |", "|---|---|---|---|---|---|"]
HEAD = """# Guided mode of a scan: resolved or not

For developers. `scripts/bench/guided_modes.py` tests the fit of the [guided
mode](../instruments.md#the-guided-mode) on scans from another model. This model has finite elements through the
depth of a bonded layer of a fractional material. The beams have an incidence of 45 degrees. The grid covers 120 mm
with points 5 mm apart, and is displaced by 1 mm. Seeds were drawn after the code was finished.

- Wide: scans that are wide and fine enough for their strongest wave. Layers without a travelling wave are omitted.
- Wrong: the resolved wavenumber differs by more than 3 % from that of each wave of the layer, or belongs to a
  weaker wave although the strongest is more than 1.25 times as strong.
- Others: further waves that were resolved.
- Noise: wide scans with too much noise to resolve the wave (the Cramer-Rao bound of the wavenumber is above 1.3 %).
- Not resolved: scans that were not resolved, of the wide scans without too much noise.

The last column is the median time of a fit [s]. A signal-to-noise ratio of 34 dB needs 25 times as many averages as
20 dB. {link} has each scan of the first seed.

| draw | scans | wide | resolved (wide) | error [%]: median, largest | others | wrong | noise | not resolved | s |
|---|---|---|---|---|---|---|---|---|---|
"""

if __name__ == "__main__":
    main()
