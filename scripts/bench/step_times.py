#!/usr/bin/env python3
"""What a simulated millisecond costs in the shipped scenes, in plain mj_step over whole runs from reset.

python scripts/bench/step_times.py [SCENE ...] [--runs 5] [--duration S] [--device cpu] [--write docs/bench/steps.md]

SCENE is a file, or a name in mjcf/scenes; all of them by default. Each scene runs in a process of its own. Median, 90th
percentile and maximum are over all steps of a run; of several runs each is the median. Beside them stands a yardstick,
a fixed piece of work measured before and after each run, by which figures of machines, or of hours of a shared one,
can be compared.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

import palmfield
from palmfield.studies.bench.field import git_commit
from palmfield.studies.bench.table import processor

ROOT = Path(__file__).resolve().parents[2]
SCENES = ROOT / "mjcf" / "scenes"
HEAD = (
    "| scene | solver | unknowns | steps | median [ms/ms] | p90 [ms/ms] | max [ms/ms] | preparation [s] "
    "| yardstick [ms] |\n|---|---|---|---|---|---|---|---|---|"
)


class Yardstick:
    """A product of two 600 x 600 matrices, and a walk through 64 MB: what a step waits for, processor and memory."""

    def __init__(self) -> None:
        generator = np.random.default_rng(0)
        self._factors = generator.random((2, 600, 600))
        self._long = generator.random(4_000_000)
        self._sum = np.empty_like(self._long)

    def ms(self) -> float:
        """Median of seven times [ms]."""
        times = []
        for _ in range(7):
            start = time.perf_counter()
            self._factors[0] @ self._factors[1]
            np.add(self._long, 1.0, out=self._sum)
            times.append(time.perf_counter() - start)
        return 1e3 * statistics.median(times)


def measure(scene: Path, runs: int, duration_s: float | None, device: str) -> dict[str, Any]:
    """One scene in this process: figures of each run, and what it took to get ready."""
    yardstick = Yardstick()
    yardstick.ms()
    start = time.perf_counter()
    sim = palmfield.Simulation(scene, device=device)
    began = [lazy.value.name for lazy in sim.runtime.model.begin]
    preparation_s = time.perf_counter() - start
    model, data = sim.model, sim.data
    step_ms = 1e3 * model.opt.timestep
    count = max(1, round((duration_s or sim.duration_s) / model.opt.timestep))
    figures, yards = [], [yardstick.ms()]
    for _ in range(runs):
        sim.reset()
        times = np.empty(count)
        for number in range(count):
            start = time.perf_counter()
            mujoco.mj_step(model, data)
            times[number] = time.perf_counter() - start
        palmfield.raise_errors(data)
        each = 1e3 * times / step_ms
        figures.append((float(np.median(each)), float(np.quantile(each, 0.9)), float(each.max())))
        yards.append(yardstick.ms())
    ended = [sim.skin(name).solver for name in sim.skins]
    solvers = [first if first == last else f"{first}, then {last}" for first, last in zip(began, ended, strict=True)]
    return {
        "scene": scene.stem,
        "solvers": solvers,
        "unknowns": [skin.layer.system.ndof for skin in sim.runtime.model.skins],
        "steps": count,
        "figures": figures,
        "preparation_s": preparation_s,
        "yardstick_ms": statistics.median(yards),
    }


def row(measured: dict[str, Any]) -> str:
    """One line of the table."""
    median, p90, most = (statistics.median(values) for values in zip(*measured["figures"], strict=True))
    unknowns = " + ".join(str(number) for number in measured["unknowns"])
    return (
        f"| {measured['scene']} | {' + '.join(measured['solvers'])} | {unknowns} | {measured['steps']} | {median:.2f} "
        f"| {p90:.2f} | {most:.1f} | {measured['preparation_s']:.1f} | {measured['yardstick_ms']:.1f} |"
    )


def alone(scene: Path, options: argparse.Namespace) -> dict[str, Any]:
    """`measure` in a process of its own."""
    command = [sys.executable, __file__, str(scene), "--json", "--runs", str(options.runs), "--device", options.device]
    if options.duration is not None:
        command += ["--duration", str(options.duration)]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    result: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help="files, or names in mjcf/scenes; all by default")
    parser.add_argument("--runs", type=int, default=5, help="runs of each scene [default: 5]")
    parser.add_argument("--duration", type=float, help="simulated time of a run [s] [default: the scene's own]")
    parser.add_argument("--device", default="cpu", help="where fields are computed [default: cpu]")
    parser.add_argument("--write", type=Path, help="also write the page to this file")
    parser.add_argument("--json", action="store_true", help="measure one scene in this process and print the figures")
    options = parser.parse_args()
    os.environ["PALMFIELD_CACHE"] = "off"  # what it takes to get ready is that of a first run
    if options.runs < 1:
        parser.error(f"--runs has value {options.runs}; allowed: whole numbers >= 1")
    known = sorted(path for path in SCENES.glob("*.xml") if not path.name.startswith("plain_"))
    scenes = [Path(name) if name.endswith(".xml") else SCENES / f"{name}.xml" for name in options.scenes] or known
    missing = [str(scene) for scene in scenes if not scene.is_file()]
    if missing:
        parser.error(f"there is no scene {missing[0]}; allowed: a file, or one of {', '.join(p.stem for p in known)}")
    if options.json:
        print(json.dumps(measure(scenes[0], options.runs, options.duration, options.device)))
        return
    load = os.getloadavg()[0]
    print(HEAD, flush=True)
    rows = []
    for scene in scenes:
        rows.append(row(alone(scene, options)))
        print(rows[-1], flush=True)
    if options.write is not None:
        options.write.write_text(page(rows, options, load), encoding="utf-8")


def page(rows: list[str], options: argparse.Namespace, load: float) -> str:
    """The table with what was measured, where and how. load: average of the machine before the first run"""
    shown = " ".join(["python scripts/bench/step_times.py", *options.scenes, "--runs", str(options.runs)])
    shown += "" if options.duration is None else f" --duration {options.duration:g}"
    return (
        "# What a step costs\n\n"
        f"`{shown}`, {processor()}, {os.cpu_count()} cores, load average {load:.1f} before, commit {git_commit()}.\n\n"
        "Wall milliseconds for a simulated one, in plain `mj_step` over whole runs from reset, sensors and forces on: "
        "median, 90th percentile and maximum over a run's steps, each the median of "
        f"{options.runs} runs. Preparation: loading the scene and factorising or reducing its skin, once. Yardstick: a "
        "product of 600 x 600 matrices and a walk through 64 MB, beside the runs.\n\n" + "\n".join([HEAD, *rows, ""])
    )


if __name__ == "__main__":
    main()
