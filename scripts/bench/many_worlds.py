#!/usr/bin/env python3
"""Measure the time of a step by part, for many worlds of a moving scene on a GPU.

python scripts/bench/many_worlds.py [--scene hover_explore] [--worlds 1024] [--start 0.1] [--steps 20] [--device cuda:0]
    [--key skin.force_accuracy=0.012]

Worlds differ in their level. It prints the median wall time of whole steps, the mean times of their nested parts, and
the time of each kernel and copy alone, all in us per world and step.
"""

import argparse
import statistics
import time
from collections import Counter
from typing import Any

import numpy as np
import warp as wp

import palmfield
from palmfield.data import folder
from palmfield.engine.many_data import ManyData
from palmfield.engine.worlds import SceneWorlds
from palmfield.simulation.moving_worlds import MovingWorlds
from palmfield.studies.bench.table import processor
from palmfield.threads import cores

PARTS = (
    (SceneWorlds, "_begin", "MuJoCo, poses, sound and forces"),
    (SceneWorlds, "_each", "  MuJoCo"),
    (ManyData, "gather", "  poses read"),
    (MovingWorlds, "place", "  frames taken in"),
    (MovingWorlds, "emit", "  foci and levels"),
    (MovingWorlds, "press", "  waited for sound and skins"),
    (MovingWorlds, "_good", "    results looked at"),
    (MovingWorlds, "push", "  forces read"),
    (ManyData, "push", "  forces applied"),
    (SceneWorlds, "_sense", "sensors"),
    (SceneWorlds, "_advance", "states taken over"),
)


def watch(owner: Any, name: str, what: str, spent: Counter[str]) -> None:
    """Count the seconds of a class's method."""
    method = getattr(owner, name)

    def timed(*args: Any, **kwargs: Any) -> Any:
        start = time.perf_counter()
        try:
            return method(*args, **kwargs)
        finally:
            spent[what] += time.perf_counter() - start

    setattr(owner, name, timed)


def main() -> None:
    """See the module's docstring."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", default="hover_explore")
    parser.add_argument("--worlds", type=int, default=1024)
    parser.add_argument("--start", type=float, default=0.1, help="time at which the steps begin [s]")
    parser.add_argument("--steps", type=int, default=20)
    parser.add_argument("--device", default="cuda:0")
    parser.add_argument("--key", action="append", default=[], help="a key of the scene and its value in all worlds")
    args = parser.parse_args()
    levels: dict[str, object] = {"stimulus.drive_amplitude": np.linspace(0.5, 1.0, args.worlds)}
    levels |= dict(key.split("=", 1) for key in args.key)
    path = folder("mjcf") / "scenes" / f"{args.scene}.xml"
    start = time.perf_counter()
    sim = palmfield.Simulation(path, device=args.device, keys=levels, worlds=args.worlds)
    sim.start_at(args.start)
    sim.step(3)
    ready_s = time.perf_counter() - start
    spent: Counter[str] = Counter()
    for owner, name, what in PARTS:
        watch(owner, name, what, spent)
    times = []
    for _ in range(args.steps):
        start = time.perf_counter()
        sim.step()
        times.append(time.perf_counter() - start)
    us = 1e6 / args.worlds
    scenes: Any = sim._scenes
    graphs = [backend for backend in scenes.steps.backends if isinstance(backend, MovingWorlds)]
    joined = sum(len(graph.joined) for graph in graphs)
    print(f"{processor()}, {cores()} cores, {args.device}")
    print(f"{args.scene}, {args.worlds} worlds, {joined} in {len(graphs)} graphs")
    print(f"ready after {ready_s:.1f} s; {us * statistics.median(times):.1f} us a world and step")
    for _, _, what in PARTS:
        print(f"{what:32} {us * spent[what] / args.steps:7.2f}")
    work = graphs[0]._work if graphs else None
    if work is None or args.device == "cpu":
        return
    device = wp.get_device(args.device)
    print(f"GPU memory in use: {(device.total_memory - device.free_memory) / 2**30:.1f} GiB")
    with wp.ScopedTimer("kernels", cuda_filter=wp.TIMING_ALL, print=False) as timer:
        for call in work.calls(True, True, tuple(work.of.skins)):
            call()
    kernels: Counter[str] = Counter()
    for one in timer.timing_results:
        kernels[one.name.removeprefix("forward kernel ")] += 1e3 * one.elapsed
    for name, elapsed in kernels.most_common(12):
        print(f"  {name[:40]:40} {elapsed / work.of.worlds:7.2f}")


if __name__ == "__main__":
    main()
