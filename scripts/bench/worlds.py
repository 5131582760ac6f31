#!/usr/bin/env python3
"""Measure the cost of a simulated millisecond in each of several worlds, and in a single simulation.

python scripts/bench/worlds.py [--worlds 64] [--scene palm_am200] [--vary level|focus] [--solver auto] [--steps 200]
                               [--device cpu] [--compare 4]

Worlds differ in their modulation depth (level), or in the position of the focus on a ring of 5 mm (focus). Both run in
the same process from rest; the first steps, which make fields and record launches, do not count. Then the results of
--compare single simulations are compared with those of their worlds: it prints the largest relative difference of
displacement, forces and sensors.
"""

import argparse
import statistics
import time
from pathlib import Path
from typing import Any

import numpy as np

import palmfield
from palmfield.studies.bench.table import processor
from palmfield.threads import cores

SCENES = Path(__file__).resolve().parents[2] / "mjcf" / "scenes"
FIRST = 10
"""Number of first steps that do not count."""
RING_M = 5e-3


def values(vary: str, worlds: int, focus_m: np.ndarray) -> dict[str, np.ndarray]:
    """Return keys with a value for each world."""
    if vary == "level":
        return {"stimulus.drive_amplitude": np.linspace(0.5, 1.0, worlds)}
    angle = 2.0 * np.pi * np.arange(worlds) / worlds
    return {"stimulus.focus_m": focus_m + RING_M * np.array([np.cos(angle), np.sin(angle), 0.0 * angle]).T}


def ms_per_step(sim: Any, steps: int) -> float:
    """Return the median wall time of steps, in ms."""
    sim.step(FIRST)
    times = []
    for _ in range(steps):
        start = time.perf_counter()
        sim.step()
        times.append(time.perf_counter() - start)
    return 1e3 * statistics.median(times)


def apart(one: np.ndarray, other: np.ndarray) -> float:
    """Return the largest difference relative to the largest number of either."""
    size = max(float(np.abs(one).max(initial=0.0)), float(np.abs(other).max(initial=0.0)))
    return 0.0 if size == 0.0 else float(np.abs(one - other).max()) / size


def main() -> None:
    """See the module's docstring."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", type=int, default=64)
    parser.add_argument("--scene", default="palm_am200")
    parser.add_argument("--vary", choices=("level", "focus"), default="level")
    parser.add_argument("--solver", default="auto")
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--compare", type=int, default=4)
    args = parser.parse_args()
    scene = Path(args.scene) if Path(args.scene).is_file() else SCENES / f"{args.scene}.xml"
    common: dict[str, object] = {"skin.solver": args.solver}
    single = palmfield.Simulation(scene, device=args.device, keys=common)
    timestep_ms = 1e3 * single.model.opt.timestep
    alone_ms = ms_per_step(single, args.steps) / timestep_ms
    focus = np.array(single.runtime.model.stimuli[0].config.focus_m)
    differing = values(args.vary, args.worlds, focus)
    start = time.perf_counter()
    together: Any = palmfield.Simulation(scene, device=args.device, keys=common | differing, worlds=args.worlds)
    together.step()
    made_s = time.perf_counter() - start
    together_ms = ms_per_step(together, args.steps) / timestep_ms
    each_ms = together_ms / args.worlds
    print(f"{processor()}, {cores()} cores, device {args.device}, scene {scene.stem}, {args.vary} differs")
    steppers = {solver for name in together.skins for solver in together.skin(name).solver}
    print(f"steppers: {sorted(steppers)}; alone: {single.skin(single.skins[0]).solver}")
    print(f"one simulation: {alone_ms:.3f} ms a simulated ms")
    print(f"{args.worlds} worlds, ready after {made_s:.1f} s:")
    print(f"    {together_ms:.3f} ms a simulated ms, {each_ms:.4f} ms a world and simulated ms")
    print(f"{args.worlds} worlds take {args.worlds * alone_ms / together_ms:.1f} x less than as many simulations")
    steps = 1 + FIRST + args.steps
    chosen = np.unique(np.linspace(0, args.worlds - 1, min(args.compare, args.worlds)).astype(int))
    worst = dict.fromkeys(("displacement", "forces", "sensors"), 0.0)
    for world in chosen.tolist():
        own = {key: value[world] for key, value in differing.items()}
        sim = palmfield.Simulation(scene, device=args.device, keys=common | own)
        sim.step(steps)
        for name in sim.skins:
            difference = apart(together.skin(name).displacement[world], sim.skin(name).displacement)
            worst["displacement"] = max(worst["displacement"], difference)
        worst["forces"] = max(worst["forces"], apart(together.forces[world], sim.forces))
        worst["sensors"] = max(worst["sensors"], apart(together.sensors[world], sim.data.sensordata))
    differences = ", ".join(f"{name} {difference:.1e}" for name, difference in worst.items())
    print(f"worlds {chosen.tolist()} against simulations by themselves: {differences}")


if __name__ == "__main__":
    main()
