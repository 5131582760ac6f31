"""Compare skin solvers on one slab and one load at several accuracies. A caller may add solutions of other programs."""

import os
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import cast

import numpy as np
from matplotlib.figure import Figure
from threadpoolctl import threadpool_limits

from palmfield.device import resolve
from palmfield.errors import PalmfieldError
from palmfield.outputs.style import save, style
from palmfield.skin.materials.material import Sheet
from palmfield.skin.problem import Motion, Slab, Spot
from palmfield.skin.solver_choice import Name, function, solve
from palmfield.studies.bench.field import check_writable, device_name, git_commit, written
from palmfield.studies.bench.processes import yardstick
from palmfield.studies.bench.skin_case import CASE, Case, F_Hz
from palmfield.studies.bench.table import processor
from palmfield.terminal import bars

ACCURACIES = {
    "lateral_waves": (0.1, 0.01, 0.001),
    "axisymmetric": (0.1, 0.02, 0.005),
    "reduced": (0.1, 0.05, 0.02),
    "wedges": (0.1, 0.05, 0.02),
    "spectral_elements": (0.1, 0.05, 0.02),
    "particles": (0.2, 0.1, 0.05),
}
"""Target accuracies of each palmfield solver."""
COMMAND = "palmfield bench skin"
MARKERS = "o^sDvP*X"
END_s, LAST_s = 0.1, 0.02
RADIUS_M = 0.06


@dataclass(frozen=True)
class SkinRow:
    """One solution of the skin benchmark.

    missing: reason if there is no solution
    static, moving: relative errors of the displacement of the centre: under a static load, and its complex amplitude at
        F_Hz
    stated: error that the solver estimates
    size: resolution of the solver in words
    """

    name: str
    size: str
    seconds: float = float("nan")
    static: float | None = None
    moving: float | None = None
    stated: float | None = None
    missing: str = ""

    @property
    def worst(self) -> float:
        return max(error for error in (self.static, self.moving, 0.0) if error is not None)


@dataclass(frozen=True)
class PeerSolutions:
    """Solutions of other programs for the same case, to compare with palmfield's solvers.

    jobs: solver by name in the table; about: description for the head of the report
    command: command of this comparison, printed in the report
    """

    jobs: Sequence[tuple[str, Callable[[], SkinRow]]]
    about: str
    command: str


def own(case: Case, name: str, accuracy: float, device: str, runs: int) -> SkinRow:
    """Solve amplitude modulation from rest.

    Mean and amplitude are taken over the last LAST_s; they are half of the exact values.
    """
    sheets, grid = (Sheet(case.material, case.depth_m),), np.arange(0.0, END_s + 1e-9, 5e-5)
    load = Spot(case.fwhm_m, grid, 0.5 * (1.0 + np.sin(2.0 * np.pi * F_Hz * grid)))
    endless, disc = Slab(sheets), Slab(sheets, "disc", side="free", radius_m=RADIUS_M)
    body = disc if function(name, "refusal")(endless, load) else endless
    times = END_s - LAST_s + np.arange(1, 401) * LAST_s / 400
    motions: list[Motion] = []
    seconds = []
    for _ in range(runs + 1):
        begin = time.perf_counter()
        motions.append(
            solve(body, load, times, np.zeros((1, 2)), solver=cast(Name, name), accuracy=accuracy, device=device)
        )
        seconds.append(time.perf_counter() - begin)
        if seconds[-1] > 20.0:
            break
    push = -motions[-1].displacement_m[:, 0, 2]
    # sin is the real part of i e^{-i w t}
    moving = 2.0 * 2.0 * np.mean(push * np.exp(2j * np.pi * F_Hz * times)) / 1j
    still, exact = case.exact()
    return SkinRow(
        f"palmfield {name}", f"target {accuracy:g}", statistics.median(seconds[1:] or seconds),
        abs(2.0 * push.mean() / still - 1.0), abs(moving / exact - 1.0), motions[-1].error,
    )  # fmt: skip


def main(
    out: Path | None = None,
    picture: Path | None = None,
    device: str = "cpu",
    runs: int = 3,
    only: str = "",
    commit: str = "",
    *,
    peers: PeerSolutions | None = None,
) -> str:
    """Measure, draw and return the report; options of `palmfield bench skin`, as for
    `palmfield.studies.bench.field.main`.

    Raises PalmfieldError for invalid options, OutputError for a file that cannot be written.
    """
    if not 1 <= runs <= 99:
        raise PalmfieldError(f"--runs has value {runs}; allowed: 1 to 99")
    check_writable({"--out": out, "--picture": picture})
    device = resolve(device)
    jobs: list[tuple[str, Callable[[], SkinRow]]] = []
    for name, accuracies in ACCURACIES.items():
        jobs += [(f"palmfield {name}", partial(own, CASE, name, accuracy, device, runs)) for accuracy in accuracies]
    jobs += peers.jobs if peers is not None else []
    names = list(dict.fromkeys(name for name, _ in jobs))
    jobs = [job for job in jobs if only in job[0]]
    if not jobs:
        raise PalmfieldError(f"--only '{only}' matches no method; use part of {', '.join(names)}")
    rows = []
    with bars() as progress, threadpool_limits(1):
        task = progress.add_task("skin", total=len(jobs))
        yard_s = statistics.median(yardstick() for _ in range(5))
        for name, job in jobs:
            progress.update(task, description=name)
            rows.append(job())
            progress.update(task, advance=1)
    report = as_markdown(rows, device, yard_s, commit or git_commit(), picture, out, peers)
    return written(report, out, None if picture is None else partial(draw, rows, picture))


def as_markdown(
    rows: list[SkinRow],
    device: str,
    yard_s: float,
    commit: str,
    picture: Path | None,
    out: Path | None,
    peers: PeerSolutions | None = None,
) -> str:
    lines = [
        "# Skin solvers side by side",
        "",
        f"    {COMMAND if peers is None else peers.command} --out FILE --picture FILE",
        "",
        f"{processor()}, one thread; palmfield on {device_name(device)}; commit {commit}. Yardstick: one float64 "
        f"product of 1000 x 1000 matrices took {1e3 * yard_s:.1f} ms.",
        "",
        f"The body is an infinite bonded slab of {CASE.material.name}, {1e3 * CASE.depth_m:g} mm thick, under a "
        f"spot of {1e3 * CASE.fwhm_m:g} mm. Two values are compared with plane waves through the depth: the static "
        f"displacement of the centre, and its complex amplitude at {F_Hz:g} Hz. The solvers of palmfield compute "
        f"{END_s:g} s of amplitude modulation from rest, with an error estimate by a second solution. If the "
        f"estimate exceeds the target, they compute a finer solution. Values are from the last {1e3 * LAST_s:g} ms. "
        f"axisymmetric and particles use a disc of {1e3 * RADIUS_M:g} mm radius; the others choose their domain. "
        + (f"{peers.about} " if peers is not None else "")
        + "Times do not include compilation.",
        "",
        "| method | size | seconds | error at rest | error at 200 Hz | stated |",
        "|---|---|---|---|---|---|",
    ]

    def percent(value: float | None) -> str:
        return "" if value is None else f"{100 * value:.2g} %"

    for row in rows:
        if row.missing:
            lines.append(f"| {row.name} | {row.size} | not run: {row.missing} | | | |")
        else:
            errors = " | ".join(percent(error) for error in (row.static, row.moving, row.stated))
            lines.append(f"| {row.name} | {row.size} | {row.seconds:.3g} | {errors} |")
    if picture is not None and out is not None:
        lines += ["", f"![Time against error]({os.path.relpath(picture, out.parent)})"]
    return "\n".join([*lines, ""])


def draw(rows: list[SkinRow], path: Path) -> None:
    with style():
        save(speed_figure([row for row in rows if not row.missing]), path)


def speed_figure(rows: list[SkinRow]) -> Figure:
    """Draw time [s] against the larger of both errors, one line for each method."""
    with style():
        figure = Figure(figsize=(7.5, 5.0), layout="constrained")
        axis = figure.subplots()
        names = list(dict.fromkeys(row.name for row in rows))
        for number, name in enumerate(names):
            some = [row for row in rows if row.name == name and row.worst > 0.0]
            line = "-" if name.startswith("palmfield") else "--"
            axis.plot(
                [100 * row.worst for row in some], [row.seconds for row in some],
                MARKERS[number % len(MARKERS)] + line, color=f"C{number % 10}", label=name,
            )  # fmt: skip
        axis.set(xscale="log", yscale="log", ylabel="seconds")
        axis.set_xlabel("error of the centre displacement [%], the larger of static and 200 Hz")
        axis.legend(fontsize="small")
    return figure
