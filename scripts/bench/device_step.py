#!/usr/bin/env python3
"""Measure the time of a step of a scene on a GPU by part, and its differences from the CPU.

python scripts/bench/device_step.py [SCENE ...] [--device cuda:0] [--steps 300] [--compare 12] [--timeline]

SCENE is a file, or a name in mjcf/scenes. For each scene it prints the wall time of mj_step, median and 99th
percentile, and its parts: the device (one launch with the copies in and out), the transfer of the skins' load, the
step of the skins, and the rest, which is Python and MuJoCo. Then it prints the time of the device alone over repeated
launches, and with --timeline the time of each kernel and copy alone. Differences are relative to the maximum of the
run.
"""

import argparse
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import warp as wp

import palmfield
from palmfield.device import Branches, resolve
from palmfield.simulation import step as stepping
from palmfield.simulation.graph_work import GraphWork
from palmfield.simulation.moving_worlds import MovingWorlds
from palmfield.simulation.scene_graph import SceneGraph

ROOT = Path(__file__).resolve().parents[2]
SCENES = ROOT / "mjcf" / "scenes"
DEFAULT = ["palm_am200", "phantom_stm70", "palm_circle", "approach_withdraw", "two_hands", "two_hands_both_feel"]
AGAIN = {"cpu": 3}
"""Number of launches of the graph alone; 200 on a GPU."""


class Stopwatch:
    """Seconds spent in some functions since `clear`, by name."""

    def __init__(self) -> None:
        self.spent: dict[str, float] = {}
        self._watched: set[tuple[Any, str]] = set()

    def clear(self) -> None:
        self.spent = dict.fromkeys(self.spent, 0.0)

    def watch(self, owner: Any, name: str, what: str) -> None:
        """Count the time of a class's method under the name `what`, once."""
        method = getattr(owner, name)
        if (owner, name) in self._watched:
            return
        self._watched.add((owner, name))
        self.spent.setdefault(what, 0.0)

        def timed(*args: Any, **kwargs: Any) -> Any:
            start = time.perf_counter()
            try:
                return method(*args, **kwargs)
            finally:
                self.spent[what] += time.perf_counter() - start

        setattr(owner, name, timed)


@contextmanager
def on_device(allowed: bool) -> Iterator[None]:
    """Set whether scenes compute their sound by graphs, also on the CPU."""
    kept = stepping.serves
    stepping.serves = lambda model: allowed
    try:
        yield
    finally:
        stepping.serves = kept


def opened(scene: Path, device: str, options: argparse.Namespace) -> palmfield.Simulation:
    with on_device(device == options.device):
        return palmfield.Simulation(scene, device=device, accuracy=options.accuracy)


def numbers(sim: palmfield.Simulation, steps: int) -> dict[str, Any]:
    """Return sensors, forces on parts of bodies, and displacement of the first skin after each step."""
    result: dict[str, list[Any]] = {"sensors": [], "forces": [], "displacement": []}
    for _ in range(steps):
        sim.step()
        result["sensors"].append(sim.data.sensordata.copy())
        result["forces"].append(np.concatenate([force for force, _ in sim.runtime.applied_parts]))
        result["displacement"].append(sim.skin(sim.skins[0]).normal_displacement.copy())
    return {name: np.array(values) for name, values in result.items()}


def differences(here: dict[str, Any], there: dict[str, Any]) -> str:
    """Return the largest difference of each quantity relative to its maximum; of sensors, by channel."""
    found = []
    for name, values in here.items():
        axis = 0 if name == "sensors" else None
        largest = np.maximum(np.abs(values).max(axis=axis), 1e-300)
        found.append(f"{name} {(np.abs(there[name] - values).max(axis=axis) / largest).max():.1e}")
    return ", ".join(found)


def device_us(calls: list[Callable[[], object]], device: str, repeats: int) -> float:
    """Return the median time of some calls on the device [us]; it includes host time only where the host is slower."""
    times = []
    stream = None if device == "cpu" else wp.get_stream(device)
    for _ in range(repeats):
        if stream is None:
            start = time.perf_counter()
            for call in calls:
                call()
            times.append(1e6 * (time.perf_counter() - start))
            continue
        before, after = wp.Event(device, enable_timing=True), wp.Event(device, enable_timing=True)
        stream.record_event(before)
        for call in calls:
            call()
        stream.record_event(after)
        times.append(1e3 * wp.get_event_elapsed_time(before, after))
    return statistics.median(times)


def label(work: GraphWork, call: Any) -> str:
    """Describe what a call of a step does."""
    owner = getattr(call, "__self__", None)
    if owner is work.inputs:
        return "poses and drives in"
    if owner is work.results:
        return "forces and sensors out"
    kernel = getattr(owner, "kernel", None)
    if kernel is None:
        return "tree over what casts shadows, refit"
    name = kernel.key.partition("__")[0]
    return f"{name}, {owner.bounds.size} threads"


def one_by_one(calls: list[Any]) -> list[Any]:
    """Return the same calls with all branches in sequence."""
    result: list[Any] = []
    for call in calls:
        result += [one for part in call.parts for one in part] if isinstance(call, Branches) else [call]
    return result


def by_itself(work: GraphWork, device: str, options: argparse.Namespace) -> None:
    """Measure the time of the device for a step after a motion, and for a step without motion."""
    again = AGAIN.get(device, 200)
    for moved in (True, False):
        drawn_from = moved, True, tuple(work.of.skins)
        work.launch(*drawn_from)
        work.wait()
        waits = []
        for _ in range(again):
            start = time.perf_counter()
            work.launch(*drawn_from)
            work.wait()
            waits.append(1e6 * (time.perf_counter() - start))
        graph = device_us([work.replay(*drawn_from)], device, again)
        what = "moved" if moved else "at rest"
        p99 = np.quantile(waits, 0.99)
        print(
            f"  {what}: launch and wait {statistics.median(waits):.0f} us (p99 {p99:.0f}), on the device {graph:.0f} us"
        )
    in_us, out_us = (device_us([call], device, again) for call in (work.inputs.upload, work.results.download))
    print(f"  copies: {work.inputs.nbytes} bytes in {in_us:.1f} us, {work.results.nbytes} out {out_us:.1f} us")
    if options.timeline:
        total = 0.0
        for call in one_by_one(work.calls(True, True, tuple(work.of.skins))):
            took = device_us([call], device, min(again, 40))
            total += took
            print(f"    {took:7.1f} us  {label(work, call)}")
        print(f"    {total:7.1f} us  one after another, each launched from Python")


def measure(scene: Path, watch: Stopwatch, options: argparse.Namespace) -> None:
    device = resolve(options.device)
    sim = opened(scene, device, options)
    start = time.perf_counter()
    sim.step(2)
    print(f"{scene.stem}: {sim.runtime.model.substeps} substeps, first steps {time.perf_counter() - start:.1f} s")
    if options.compare:
        sim.reset()
        there = numbers(sim, options.compare)
        other = opened(scene, "cpu", argparse.Namespace(device="", accuracy=options.accuracy))
        print(f"  against the CPU over {options.compare} steps: {differences(numbers(other, options.compare), there)}")
    watch.watch(GraphWork, "launch", "device")
    watch.watch(GraphWork, "wait", "device")
    watch.watch(SceneGraph, "load", "load fetched")
    for lazy in (*sim.runtime.model.begin, *sim.runtime.model.whole):
        if lazy.made:
            watch.watch(type(lazy.value), "step", "skin")
    sim.reset()
    sim.step(5)
    walls, parts = [], []
    for number in range(options.steps):
        if number % max(1, round(sim.duration_s / sim.model.opt.timestep)) == 0:
            sim.reset()
        watch.clear()
        start = time.perf_counter()
        mujoco.mj_step(sim.model, sim.data)
        walls.append(1e3 * (time.perf_counter() - start))
        parts.append([1e3 * spent for spent in watch.spent.values()])
    palmfield.raise_errors(sim.data)
    step_ms = 1e3 * sim.model.opt.timestep
    shown = ", ".join(f"{what} {ms:.3f}" for what, ms in zip(watch.spent, np.median(parts, axis=0), strict=True))
    rest = np.median(np.array(walls) - np.sum(parts, axis=1))
    print(
        f"  mj_step of {step_ms:g} ms: p50 {np.median(walls):.3f} ms, p99 {np.quantile(walls, 0.99):.3f}, max "
        f"{max(walls):.3f}; {shown}, Python and MuJoCo {rest:.3f}"
    )
    graph, moving = sim.steps.host, sim.steps.backends[0]
    assert isinstance(graph, SceneGraph)
    joins = isinstance(moving, MovingWorlds)
    print(f"  graphs of the scene {graph.launches}, in the graph of moving worlds {len(moving.joined) if joins else 0}")
    work = moving._work if joins else graph._now
    if work is not None:
        by_itself(work, device, options)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", metavar="SCENE", default=DEFAULT)
    parser.add_argument("--device", default="cuda:0", help="cpu shows only that it runs [default: cuda:0]")
    parser.add_argument("--steps", type=int, default=300, help="steps that are timed [default: 300]")
    parser.add_argument("--compare", type=int, default=12, help="steps against the CPU, 0 for none [default: 12]")
    parser.add_argument("--accuracy", type=float, help="of the skins [default: the scene's own]")
    parser.add_argument("--timeline", action="store_true", help="each kernel and copy of a step by itself")
    options = parser.parse_args()
    watch = Stopwatch()
    for name in options.scenes:
        scene = Path(name) if name.endswith(".xml") else SCENES / f"{name}.xml"
        if not scene.is_file():
            parser.error(f"there is no scene {scene}; allowed: a file, or a name in {SCENES}")
        measure(scene, watch, options)
        sys.stdout.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main())
