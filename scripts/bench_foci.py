"""Compare methods for several foci: pressure, evenness and time. Writes docs/bench/foci.md."""

import argparse
import os
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

import numpy as np
from matplotlib.figure import Figure
from threadpoolctl import threadpool_limits

from palmfield.acoustics.arrays import layout
from palmfield.acoustics.field import FieldEvaluator
from palmfield.drive.foci import ITERATIONS, SOLVERS, Foci, Method, solve_transfer, transfer64
from palmfield.outputs.style import COLOURS, save, style
from palmfield.studies.bench.field import git_commit
from palmfield.studies.bench.table import cells, keep_rows, processor
from palmfield.types import Air, Array, Complex, Float

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "bench" / "foci.md"
ALL = "| foci | method | level | quietest | per power | uniformity | side lobe dB | mean a^2 | steps | time ms |"
METHODS: tuple[Method, ...] = get_args(Method)
COUNTS = (2, 4, 8, 16)
SHOWN = (4, 16)
"""Numbers of foci on the page; the file has all."""
LAYOUTS = 20
RUNS = 9
HEIGHT_M = 0.2
HALF_WIDTH_M = 0.05
APART_M = 0.02
LOBE_M = 0.012
"""Radius around each focus without search for side lobes; the first null of a 16 x 16 board is at 10.4 mm."""


def median_s(work: Callable[[], object]) -> float:
    work()
    seconds = []
    for _ in range(RUNS):
        start = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - start)
    return statistics.median(seconds)


def scattered(count: int, random: np.random.Generator) -> Float:
    """Return random foci in a square of one plane, at least APART_M from each other [m], shape (count, 3)."""
    found: list[Float] = []
    while len(found) < count:
        point = np.append(random.uniform(-HALF_WIDTH_M, HALF_WIDTH_M, 2), HEIGHT_M)
        if all(np.linalg.norm(point - other) >= APART_M for other in found):
            found.append(point)
    return np.array(found)


def plane(step_m: float) -> Float:
    steps = np.arange(-0.08, 0.08 + 0.5 * step_m, step_m)
    x, y = map(np.ravel, np.meshgrid(steps, steps))
    return np.column_stack([x, y, np.full(len(x), HEIGHT_M)])


def side_lobe(field: FieldEvaluator, found: Foci, points: Float) -> float:
    """Return the largest |p| in the plane of the foci outside their lobes, relative to that of the weakest focus."""
    where = plane(1.5e-3)
    outside = np.linalg.norm(where[:, None] - points, axis=2).min(axis=1) > LOBE_M
    loud = np.abs(field.pressure(where[outside], found.drive).pressure).max()
    return float(loud / found.magnitude_Pa.min())


def quality(found: Foci) -> tuple[float, float, float, float]:
    quietest = found.magnitude_Pa.min() / found.bound_Pa.mean()
    return found.level, float(quietest), found.uniformity, found.power


def starts(transfers: list[Complex]) -> tuple[float, float, float]:
    """Return the weakest focus of "gsw" over a single focus: own start, mean and best of ten random starts."""
    own, mean, best = [], [], []
    random = np.random.default_rng(7)
    for transfer in transfers:
        targets, bound = np.ones(len(transfer)), np.abs(transfer).sum(axis=1).mean()
        own.append(solve_transfer(transfer).magnitude_Pa.min() / bound)
        levels = []
        for _ in range(10):
            phases = np.exp(2j * np.pi * random.random(len(transfer)))
            drive, _ = SOLVERS["gsw"](transfer, targets, phases, ITERATIONS["gsw"])
            levels.append(np.abs(transfer @ drive).min() / bound)
        mean.append(np.mean(levels))
        best.append(max(levels))
    return float(np.mean(own)), float(np.mean(mean)), float(np.mean(best))


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--commit", help="what to write as the commit where no git is")
    name = options.parse_args().commit or git_commit()
    with threadpool_limits(1, user_api="blas"):
        measure(name)


def measure(name: str) -> None:
    array, air = layout("uhev1"), Air()
    field = FieldEvaluator(array, air, "cpu")
    random = np.random.default_rng(0)
    rows, beginnings = [], []
    shown: dict[Method, list[tuple[int, float, float]]] = {method: [] for method in METHODS}
    for count in COUNTS:
        layouts = [scattered(count, random) for _ in range(LAYOUTS)]
        transfers = [transfer64(points, array, air) for points in layouts]
        prepare = median_s(lambda layouts=layouts: transfer64(layouts[0], array, air))
        for method in METHODS:
            solved = [solve_transfer(transfer, method=method) for transfer in transfers]
            level, quietest, uniformity, power = np.mean([quality(found) for found in solved], axis=0)
            lobe = np.mean([side_lobe(field, f, p) for f, p in zip(solved, layouts, strict=True)])
            seconds = median_s(lambda first=transfers[0], method=method: solve_transfer(first, method=method))
            iterations = np.mean([found.iterations for found in solved])
            rows.append(
                f"| {count} | {method} | {level:.3f} | {quietest:.3f} | {quietest * np.sqrt(count / power):.3f} | "
                f"{uniformity:.3f} | {20 * np.log10(lobe):.1f} | {power:.2f} | {iterations:.0f} | {1e3 * seconds:.2f} |"
            )
            shown[method].append((count, 1e3 * seconds, float(quietest)))
            print(rows[-1])
        own, mean, best = starts(transfers)
        beginnings.append(f"| {count} | {own:.3f} | {mean:.3f} | {best:.3f} | {1e3 * prepare:.2f} |")
    pairs = list(zip(shown["gsw"], shown["lbfgs"], strict=True))
    closest = min(mine[2] / best[2] for mine, best in pairs)
    shares = [mine[1] / best[1] for mine, best in pairs]
    draw(array, air, field, shown)
    lines = [
        "# Several foci at once",
        "",
        "For everyone who uses several foci. The page compares five methods that compute one drive for several foci.",
        f"{processor()}, {os.cpu_count()} cores seen, NumPy on one thread; commit {name}. Array uhev1 (256 pistons,",
        f"p0 = {array.p0_Pa_m} Pa m). Values are means over {LAYOUTS} random arrangements of equal foci, in a",
        f"square of {200 * HALF_WIDTH_M:.0f} cm at {100 * HEIGHT_M:.0f} cm distance, at least {1e3 * APART_M:.0f} mm",
        "apart.",
        "",
        "    python scripts/bench_foci.py",
        "",
        "- Quietest: |p| of the quietest focus, divided by |p| of a single focus.",
        '- Per power: the quantity "quietest" times sqrt(foci / mean |a|^2), with the number of foci and the drive a.',
        "- Uniformity: quietest focus divided by loudest focus.",
        f"- Side lobe: loudest |p| in the plane of the foci, at least {1e3 * LOBE_M:.0f} mm from each, divided by the",
        "  quietest focus.",
        f"- Time: median of {RUNS} solutions, without the transfer matrix.",
        "",
        f"{keep_rows(PAGE, [ALL, '', *rows])} has all numbers of foci, mean levels, drives and steps.",
        "",
        "| foci | method | quietest | per power | uniformity | side lobe [dB] | time [ms] |",
        "|---|---|---|---|---|---|---|",
        *(
            f"| {' | '.join(cells(row)[i] for i in (0, 1, 3, 4, 5, 6, 9))} |"
            for row in rows
            if int(cells(row)[0]) in SHOWN
        ),
        "",
        "`lbfgs` searches directly for the drive that makes the quietest focus as loud as possible. On average `gsw`,",
        f"the default, reaches at least {100 * closest:.1f} % of the pressure of `lbfgs` in at most "
        f"{100 * max(shares):.0f} % of its time.",
        "`tikhonov` uses amplitudes below full drive. Its foci are less loud, but it needs less power and has weaker",
        "side lobes.",
        "",
        "`gsw` is iterative. The next table has |p| of the quietest focus divided by |p| of a single focus. The",
        "iterations start from phases that reinforce one another, or from random phases (ten draws).",
        "",
        "| foci | reinforcing phases | random, mean | random, best of ten | time of the transfer matrix [ms] |",
        "|---|---|---|---|---|",
        *beginnings,
        "",
        "![Fields of three methods, quality against time, and convergence](../images/foci.png)",
        "",
    ]
    PAGE.write_text("\n".join(lines))
    print("\n".join(lines))


def draw(array: Array, air: Air, field: FieldEvaluator, shown: dict[Method, list[tuple[int, float, float]]]) -> None:
    points = scattered(8, np.random.default_rng(3))
    transfer = transfer64(points, array, air)
    where = plane(1e-3)
    side = round(np.sqrt(len(where)))
    colours = dict(zip(METHODS, ("#888888", *COLOURS, "#111111"), strict=True))
    with style():
        figure = Figure(figsize=(10, 6.4), layout="constrained")
        axes: Any = figure.subplots(2, 3)
        image = None
        for axis, method in zip(axes[0], ("naive", "gsw", "tikhonov"), strict=True):
            found = solve_transfer(transfer, method=method)
            loud = np.abs(field.pressure(where, found.drive).pressure) / found.bound_Pa.mean()
            image = axis.imshow(
                loud.reshape(side, side),
                origin="lower",
                extent=(-80, 80, -80, 80),
                vmin=0,
                vmax=0.4,
                cmap="magma",
            )
            axis.plot(*(1e3 * points[:, :2].T), "o", mfc="none", mec="white", ms=11, mew=0.8)
            axis.set(title=f"{method}: uniformity {found.uniformity:.2f}", xlabel="x [mm]", ylabel="y [mm]")
            axis.grid(False)
        figure.colorbar(image, ax=axes[0], label="|p| over that of a single focus")
        for method, values in shown.items():
            counts, milliseconds, quietest = zip(*values, strict=True)
            axes[1, 0].plot(
                milliseconds, np.array(quietest) * np.sqrt(counts), "o-", color=colours[method], label=method, ms=4
            )
        axes[1, 0].set(
            xscale="log", xlabel="time of the solution [ms]", ylabel="quietest focus x sqrt(foci)", ylim=(0, 1.1)
        )
        axes[1, 0].set_title("Quality against time (2 to 16 foci)")
        axes[1, 0].legend(fontsize=8)
        for method in ("gs", "gsw", "lbfgs"):
            residual = solve_transfer(transfer, method=method).residual
            axes[1, 1].semilogy(residual, color=colours[method], label=method)
        axes[1, 1].set(xlim=(0, 100), ylim=(1e-8, 0.2), xlabel="iteration", ylabel="rms of |p|/target over mean")
        axes[1, 1].set_title("Convergence, 8 foci")
        axes[1, 1].legend(fontsize=8)
        loudness = {m: np.sort(solve_transfer(transfer, method=m).magnitude_Pa) for m in METHODS}
        for i, (method, values) in enumerate(loudness.items()):
            axes[1, 2].plot(values / 1e3, np.full(8, i), "o", color=colours[method], mfc="none")
        axes[1, 2].set_yticks(range(len(METHODS)), METHODS)
        axes[1, 2].set(xlabel="|p| at each focus [kPa]", xlim=(0, None))
        axes[1, 2].set_title("Loudness of the 8 foci")
        save(figure, ROOT / "docs" / "images" / "foci.png", dpi=90)


if __name__ == "__main__":
    main()
