"""Score measured scans against registered bands: numbers with noise, a verdict for each, table and picture."""

import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from palmfield.errors import MeasurementError
from palmfield.files import write_text
from palmfield.outputs.scan_files.named_mat import NamedMat
from palmfield.outputs.style import COLOURS, save, style
from palmfield.types import Float
from palmfield_papers.reardon2023.scan_bands import ALL
from palmfield_papers.reardon2023.scan_numbers import (
    CENTROID,
    SPEED,
    THRESHOLD,
    WAKE,
    WIDTH,
    Pass,
    STEP_s,
    band_passed,
    envelope,
    numbers,
)
from palmfield_papers.reardon2023.scans import predict, read_scans

SCORE, TABLE, PICTURE = "score.json", "score.md", "scans.png"
LEAST_QUIET_s = 5e-3
"""Smallest time before the stimulus from which noise is estimated [s]."""
DRAWS, SIGMAS = 16, 2.0
"""Number of noise records added to the measured one; standard deviations by which a number may leave a band."""
INSIDE, OUTSIDE, UNRESOLVED = "inside", "outside", "not resolved"
BARS = (*COLOURS[1:], "#a16207")
"""Colours of the bases."""


@dataclass(frozen=True)
class Verdict:
    """One number of one file.

    error: SIGMAS times the standard deviation of its noise
    numerical_error: numerical error of the prediction
    bands: low and high value, for all skins and for each base alone
    verdicts: verdict for each band
    """

    file: str
    number: str
    measured: float
    error: float
    numerical_error: float
    bands: dict[str, tuple[float, float]]
    verdicts: dict[str, str]


def score(
    folder: Path, out: Path, *, quick: bool, device: str = "cpu", names: Mapping[str, str] | None = None,
    predict_only: bool = False,
) -> tuple[str, list[Verdict]]:  # fmt: skip
    """Predict, register and, unless predict_only, score the scans of a folder. Return digest and verdicts.

    Raises MeasurementError for invalid settings, files and places before anything is computed.
    """
    setting, files, passes = read_scans(folder, names)
    found, digest = predict(setting, passes, out, quick=quick, device=device)
    verdicts: list[Verdict] = []
    for name, scan in () if predict_only else files.items():
        verdicts += judged(name, found["bands"][name], *measured(scan, passes[name]))
    if not predict_only:
        facts = {"digest": digest, "quick": quick, "verdicts": [vars(one) for one in verdicts]}
        write_text(out / SCORE, json.dumps(facts, indent=1, allow_nan=False) + "\n")
        write_text(out / TABLE, table(digest, verdicts))
        with style():
            save(drawn(verdicts), out / PICTURE)
    return digest, verdicts


def measured(scan: NamedMat, one: Pass) -> tuple[dict[str, float], dict[str, float], set[str]]:
    """Read a scan.

    Return its numbers, the standard deviation of each due to noise, and the numbers that noise hides.
    """
    times, records = scan.records()
    step, before = float(times[1] - times[0]), int(np.count_nonzero(times < 0.0))
    if before * step < LEAST_QUIET_s or times[-1] < one.times_s[-1] or step > STEP_s:
        raise MeasurementError(
            f"{scan.file}: the record is from {1e3 * times[0]:.4g} to {1e3 * times[-1]:.4g} ms at {1 / step:.4g} Hz; "
            f"needed: {-1e3 * LEAST_QUIET_s:g} to {1e3 * one.times_s[-1]:.4g} ms from start, {1 / STEP_s:g} Hz; set "
            "reference or onset_s, rate, and along_m_s"
        )
    mean = records.mean(axis=0)
    values = band_passed(mean - mean[:before].mean(axis=0), step)
    moved = np.column_stack([np.interp(one.times_s, times, column) for column in values.T])
    rng = np.random.default_rng(0)
    noise, *others = (_noise(values[:before], step, len(moved), rng) for _ in range(DRAWS + 1))
    found = numbers(one, moved, noise)
    again = [numbers(one, moved + more, np.sqrt(2.0) * noise) for more in others]
    spread = {name: float(np.std([one_more.get(name, value) for one_more in again])) for name, value in found.items()}
    faint = (noise**2).mean() > 0.5 * (moved**2).mean()
    largest = max(float(envelope(one, more)[1].max()) for more in others)
    hidden = set(found) if faint else set()
    return found, spread, hidden | ({WAKE} if largest > THRESHOLD * envelope(one, moved)[1].max() else set())


def _noise(quiet: Float, step: float, count: int, rng: np.random.Generator) -> Float:
    """Return noise with the power of the record before the stimulus, at STEP_s, shape (count, n), in random order."""
    first = rng.integers(len(quiet), size=quiet.shape[1])
    rows = (first + max(1, round(STEP_s / step)) * np.arange(count)[:, None]) % len(quiet)
    return np.asarray(np.take_along_axis(quiet, rows, axis=0) * rng.choice([-1.0, 1.0], size=quiet.shape[1]))


def judged(
    file: str, band: dict[str, Any], found: dict[str, float], spread: dict[str, float], hidden: set[str]
) -> list[Verdict]:
    """Return a verdict for each predicted number.

    It is inside if the number with its noise overlaps the band with its numerical error.
    """
    result = []
    for name, of in ((name, of) for name, of in band.items() if name in found):
        error, value = SIGMAS * spread[name], found[name]
        room, (lowest, highest) = error + of["numerical_error"], of["bands"][ALL]
        lost = name in hidden or error > highest - lowest
        by = {
            base: UNRESOLVED if lost else INSIDE if low - room <= value <= high + room else OUTSIDE
            for base, (low, high) in of["bands"].items()
        }
        result.append(Verdict(file, name, value, error, of["numerical_error"], of["bands"], by))
    return result


def table(digest: str, verdicts: list[Verdict]) -> str:
    """Return the score in Markdown."""
    counts = Counter(one.verdicts[ALL] for one in verdicts)
    bases = [base for base in dict.fromkeys(base for one in verdicts for base in one.verdicts) if base != ALL]
    by = [f"base {base} alone: {sum(one.verdicts.get(base) == INSIDE for one in verdicts)} inside" for base in bases]
    heads = ("file", "number", "measured", "its noise", "band", "numerical error", "verdict", *bases)
    rows = [heads, ("---",) * len(heads)]
    for one in verdicts:
        band = "{:.3g} to {:.3g}".format(*one.bands[ALL])
        found = (f"{one.measured:.3g}", f"{one.error:.2g}", band, f"{one.numerical_error:.2g}")
        rows.append((one.file, one.number, *found, *(one.verdicts.get(base, "-") for base in (ALL, *bases))))
    summary = ", ".join([*(f"{counts[what]} {what}" for what in (INSIDE, OUTSIDE, UNRESOLVED)), *by])
    lines = [f"SHA-256 of the predictions: `{digest}`", "", summary, "", *(f"| {' | '.join(row)} |" for row in rows)]
    return "\n".join(lines) + "\n"


def drawn(verdicts: list[Verdict]) -> Figure:
    """Draw bands and measured numbers: lengths, speeds, frequencies for all files; power, energies for each file."""
    files = list(dict.fromkeys(one.file for one in verdicts))
    figure = Figure(figsize=(11.0, 3.2 + 2.4 * len(files)), layout="constrained")
    top, below = figure.subfigures(2, 1, height_ratios=[3.2, 2.4 * len(files)], squeeze=False)[:, 0]
    for axes, name in zip(top.subplots(1, 4), (WAKE, SPEED, CENTROID, WIDTH), strict=True):
        _bars(axes, name, {one.file.removesuffix(".mat"): one for one in verdicts if one.number == name})
    top.legend(*axes.get_legend_handles_labels(), loc="outside upper right", ncols=3, fontsize=8)
    for row, file in zip(below.subplots(len(files), 2, squeeze=False), files, strict=True):
        for axes, word, unit in zip(row, ("power", "energy"), ("[%]", "[dB]"), strict=True):
            of = [one for one in verdicts if one.file == file and one.number.startswith(word)]
            shown = {one.number.removeprefix(word).removesuffix(unit).strip(): one for one in of}
            _bars(axes, f"{file}: {word} {unit}", shown)
    return figure


def _bars(axes: Axes, title: str, shown: Mapping[str, Verdict]) -> None:
    for place, one in enumerate(shown.values()):
        bases = [base for base in one.bands if base != ALL]
        width = 0.7 / len(bases)
        for number, base in enumerate(bases):
            (low, high), x = one.bands[base], place + (number - 0.5 * (len(bases) - 1)) * width
            axes.bar(x, high - low, width, low, color=BARS[number], alpha=0.4, label=base if place == 0 else "")
        colour = {INSIDE: "black", OUTSIDE: COLOURS[0], UNRESOLVED: "#999999"}[one.verdicts[ALL]]
        axes.errorbar(place, one.measured, one.error, fmt="o", ms=4.0, color=colour, capsize=2.0)
    axes.set_title(title, fontsize=8)
    axes.set_xticks(range(len(shown)), list(shown), rotation=20, ha="right", fontsize=7)
