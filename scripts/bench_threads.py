"""Compare the gain of a second thread for the field with that for hashing; writes docs/bench/threads.md.

python scripts/bench_threads.py

Virtual machines often lend their second core to others. One measurement is therefore not reliable; many are sorted by
the simultaneous gain of hashing.
"""

import argparse
import os
import statistics
import time
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from palmfield.acoustics.arrays import layout
from palmfield.acoustics.field import FieldEvaluator
from palmfield.acoustics.focus import focus
from palmfield.studies.bench.field import git_commit
from palmfield.studies.bench.processes import cores
from palmfield.studies.bench.table import processor
from palmfield.types import Air

ROOT = Path(__file__).resolve().parents[1]
AIR = Air()
BINS = (0.0, 1.3, 1.7, 1.9, 9.0)
"""Limits of the speed of hashing on all cores, relative to one."""


def turns(points: int, count: int) -> list[tuple[float, float, float]]:
    """Return the speed ratios of hashing and of the field, and the field's pairs/s on all cores, by measurement."""
    array = replace(layout("autd3_2x2"), directivity_table=None)
    drive = focus(array, AIR, np.array([0.0, 0.0, 0.2]))
    where = np.random.default_rng(0).uniform([-0.1, -0.1, 0.05], [0.1, 0.1, 0.4], (points, 3)).astype(np.float32)
    one, all_cores = (FieldEvaluator(array, AIR, "cpu", threads=n) for n in (1, os.cpu_count() or 1))
    repeats = 1 + 200_000 // points

    def seconds(evaluator: FieldEvaluator) -> float:
        start = time.perf_counter()
        for _ in range(repeats):
            evaluator.pressure(where, drive)
        return (time.perf_counter() - start) / repeats

    seconds(one), seconds(all_cores)
    found = []
    for _ in range(count):
        before = cores()
        single_s, shared_s = seconds(one), seconds(all_cores)
        found.append((0.5 * (before + cores()), single_s / shared_s, points * len(array) / shared_s))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--turns", type=int, default=60)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "bench" / "threads.md")
    args = parser.parse_args()
    lines = [
        "# The field on all cores",
        "",
        f"For developers. `python scripts/bench_threads.py`, {processor()}, {os.cpu_count()} cores seen, commit "
        f"{git_commit()}. The table shows how much a second core speeds up the field (pressure of 996 pistons with "
        "absorption, mode fast). A simple computation for comparison (hashing) was measured before and after each of "
        f"{args.turns} rounds. Rounds with a similar speed-up of hashing are in one row, with medians.",
        "",
        "| points | speed-up of hashing by all cores | rounds | speed-up of the field | M pairs/s on all cores |",
        "|---|---|---|---|---|",
    ]
    for points in (20_000, 400_000):
        found = turns(points, args.turns)
        for low, high in pairwise(BINS):
            some = [turn for turn in found if low <= turn[0] < high]
            if some:
                hashing, field, rate = (statistics.median(column) for column in zip(*some, strict=True))
                lines.append(f"| {points} | {hashing:.2f} | {len(some)} | {field:.2f} | {1e-6 * rate:.0f} |")
    text = "\n".join([*lines, ""])
    print(text)
    args.out.write_text(text)


if __name__ == "__main__":
    main()
