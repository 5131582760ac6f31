#!/usr/bin/env python3
"""Compare small forms of the shipped scenes on GPU and CPU: sensors, forces, displacement and ARP.

python scripts/verification/check_scenes_on_gpu.py [SCENE ...] [--steps 20] [--write docs/bench/gpu_scenes.md]

SCENE is a name in tests/data/scene_reference/small; all of them by default. Differences are relative to the largest of
the quantity over the run; those of force components are relative to the largest length of the vector. "flipped" is the
share of nodes and steps at which ARP differs by more than 1e-4: there a shadow ray grazes an edge, and rounding
determines the side.
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from palmfield import Simulation
from palmfield.simulation.sensors import CHANNELS, UNITS
from palmfield.studies.bench.field import git_commit
from palmfield.studies.bench.table import cells, keep_rows

ROOT = Path(__file__).resolve().parents[2]
REFERENCE = ROOT / "tests" / "data" / "scene_reference" / "small"
LIMIT = 1e-4
HEAD = "| scene | sensors | force | displacement | ARP, without flipped points | flipped |\n|---|---|---|---|---|---|"


def steps_of(name: str, device: str, steps: int) -> dict[str, Any]:
    """Return sensors, force of each skin's body, normal displacement and ARP of the first skin, after each step."""
    facts = json.loads(str(np.load(REFERENCE / f"{name}.npz")["facts"]))
    keys = facts["keys"] | {"skin.solver": "wedges" if facts["began"] == "wedges" else "auto"}
    sim = Simulation(ROOT / "mjcf" / "scenes" / f"{name}.xml", device=device, keys=keys)
    if facts["start_s"]:
        sim.start_at(facts["start_s"])
    result: dict[str, list[Any]] = {"sensors": [], "force": [], "displacement": [], "arp": []}
    for _ in range(steps):
        sim.step()
        skin = sim.skin(sim.skins[0])
        result["sensors"].append(sim.data.sensordata.copy())
        result["force"].append([np.asarray(force) for force in sim.runtime.applied])
        result["displacement"].append(skin.normal_displacement.copy())
        result["arp"].append(skin.arp.copy())
    return {quantity: np.array(values) for quantity, values in result.items()}


def row(name: str, device: str, steps: int) -> tuple[str, bool]:
    """Return a line of the table, and whether all values except flipped nodes are within LIMIT."""
    here, there = steps_of(name, "cpu", steps), steps_of(name, device, steps)
    apart = {key: np.abs(there[key] - here[key]) for key in here}
    channels = here["sensors"].reshape(steps, -1, len(CHANNELS))
    largest = np.abs(channels).max(axis=0)
    newtons = [number for number, unit in enumerate(UNITS) if unit == "N"]
    largest[:, newtons] = np.linalg.norm(channels[..., newtons], axis=2).max(axis=0)[:, None]
    sensors = (apart["sensors"].max(axis=0) / np.maximum(largest.ravel(), 1e-300)).max()
    lengths = np.linalg.norm(here["force"], axis=-1)
    force = np.linalg.norm(there["force"] - here["force"], axis=-1).max() / max(lengths.max(), 1e-300)
    displacement = apart["displacement"].max() / max(np.abs(here["displacement"]).max(), 1e-300)
    arp = apart["arp"] / max(np.abs(here["arp"]).max(), 1e-300)
    flipped = arp > LIMIT
    rest = arp[~flipped].max(initial=0.0)
    line = f"| {name} | {sensors:.1e} | {force:.1e} | {displacement:.1e} | {rest:.1e} | {flipped.mean():.1e} |"
    return line, max(sensors, force, displacement) <= LIMIT and flipped.mean() < 1e-3


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", default=sorted(path.stem for path in REFERENCE.glob("*.npz")))
    parser.add_argument("--steps", type=int, default=20)
    parser.add_argument("--device", default="cuda:0")
    parser.add_argument("--write", type=Path, help="also write the page to this file")
    parser.add_argument("--commit", default="", help="for the head, where no git is [default: git's]")
    options = parser.parse_args()
    print(HEAD, flush=True)
    rows, good = [], True
    for name in options.scenes:
        line, within = row(name, options.device, options.steps)
        rows.append(line)
        good = good and within
        print(line, flush=True)
    if options.write is not None:
        commit, device = options.commit or git_commit(), wp.get_device(options.device).name
        link = keep_rows(options.write, [*HEAD.split("\n"), *rows])
        title = f"""\
# Scenes on a GPU

For developers. `python scripts/verification/{Path(__file__).name}`, {device}, commit {commit}.
Small variants of {len(rows)} scenes were stepped {options.steps} times on the GPU and on the CPU. The table has the
largest difference of all scenes; {link} has each scene. Differences are relative to the largest value of the run (for
forces: to the length of the vector). The differences show consistency, not accuracy. "Flipped" is the share of nodes
and steps at which the ARP differs by more than 1e-4. At such a point a ray grazes an edge, and rounding decides whether
the point is lit.

"""
        largest = [max((cells(row)[column] for row in rows), key=float) for column in range(1, 6)]
        options.write.write_text(f"{title}{HEAD}\n| largest | {' | '.join(largest)} |\n")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
