#!/usr/bin/env python3
"""Hold the scenes against the arrays that the program before the redesign of its core gave (commit f6cb3e2).

Where the facts of a small one have `forces_commit`, its arrays were stored again at that commit: forces are of what is
emitted since (up to 30 % in the millisecond of a ring-up, 4 % later), sound from behind does not reach a surface, and
the mean of a moving focus keeps each moment's own lit points (0.06 % of the force of hover_explore). `path_commit`: the
same for a path on the skin (stroke_palm), which is nearer to the shortest since (force 0.2 %, displacement 0.2 %).

The solver, the mesh and the step are those that it took then. `small` layers take seconds and are a test; `shipped` are
the scenes as they are, some minutes each: run this file.
"""

import argparse
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from palmfield.data import folder
from palmfield.hand.force_samples import A_FACE
from palmfield.session.simulation import Simulation
from palmfield.simulation import seen_samples

REFERENCE = Path(__file__).parents[2] / "tests" / "data" / "scene_reference"
TOLERANCE, IN_POINTS = 1e-5, 5e-4
"""Of each array's largest value. The second is for the motion of skins with small models, which have looked at their
load in few points since: a tenth of what reduction may cost at accuracy 0.05."""
MOTION = ("displacement_m", "velocity_m_s", "sensor channel 3", "sensor channel 4")
P0_PA_M = 2.53
"""Of all arrays then."""
FORCE, DISPLACEMENT, VELOCITY, ARP = slice(0, 3), 3, 4, 5
"""Channels of the skin's sensor."""


def scenes(size: str) -> list[str]:
    """Names of the scenes with stored arrays. size: "small" or "shipped"."""
    return sorted(path.stem for path in (REFERENCE / size).glob("*.npz"))


def opened(facts: dict[str, Any]) -> Simulation:
    """The scene as it was stepped then, at the time from which it was stored."""
    solver = facts["began"]
    if facts["began"] != facts["ended"]:
        solver = "auto"  # only this may leave its small model
    keys = {**facts["keys"], "skin.solver": solver, "array.p0_Pa_m": P0_PA_M}
    if not facts["scene"].startswith("phantom"):
        keys["skin.force_accuracy"] = A_FACE  # each face was a sample
    sim = Simulation(folder("mjcf") / "scenes" / f"{facts['scene']}.xml", device="cpu", keys=keys)
    if facts["start_s"]:
        sim.start_at(facts["start_s"])
    return sim


def differences(size: str, name: str) -> list[tuple[str, float]]:
    """What was compared, and its largest difference over the stored array's largest value."""
    # The force then came from all samples of a body, also from those that the arrays don't see
    with patch.object(seen_samples, "seen", lambda points, normals, arrays: np.ones(len(points), np.bool_)):
        return list(_differences(size, name))


def _differences(size: str, name: str) -> Iterator[tuple[str, float]]:
    with np.load(REFERENCE / size / f"{name}.npz") as stored:
        facts, expected = json.loads(str(stored["facts"])), {key: stored[key] for key in stored.files if key != "facts"}
    sim = opened(facts)
    skin, layer = sim.skin(), sim.runtime.model.skins[0].layer
    nodes = expected["nodes"]
    rows: dict[str, list[Any]] = {
        key: [] for key in ("sensordata", "displacement_m", "velocity_m_s", "force_N", "qpos")
    }
    for _ in range(facts["steps"]):
        sim.step()
        normals = skin.rest_normal[nodes]
        rows["displacement_m"].append(np.einsum("ij,ij->i", skin.displacement[nodes], normals))
        rows["velocity_m_s"].append(np.einsum("ij,ij->i", skin.velocity[nodes], normals))
        rows["sensordata"].append(sim.data.sensordata.copy())
        rows["force_N"].append(sim.forces[0].copy())
        rows["qpos"].append(sim.data.qpos.copy())
    yield "unknowns", abs(layer.system.ndof - facts["unknowns"]) / facts["unknowns"]
    yield "step_s", abs(layer.sizes.step_s - facts["step_s"]) / facts["step_s"]
    yield "rest_m", relative(skin.rest_position[nodes], expected["rest_m"])
    if facts["response"]:
        yield "emitted", relative(sim.runtime.amplitudes, expected["emitted"])
    sensors, seen = np.array(rows.pop("sensordata")), expected["sensordata"]
    for channel in (FORCE, DISPLACEMENT, VELOCITY, ARP):
        yield f"sensor channel {channel}", relative(sensors[:, channel], seen[:, channel])
    for key, values in rows.items():
        yield key, relative(np.array(values), expected[key])
    yield f"ended with {facts['ended']}", float(skin.solver != facts["ended"])


def allowed(size: str, name: str, what: str) -> float:
    """The largest difference that is allowed in what was compared."""
    with np.load(REFERENCE / size / f"{name}.npz") as stored:
        began = json.loads(str(stored["facts"]))["began"]
    return IN_POINTS if began == "reduced" and what in MOTION else TOLERANCE


def relative(values: Any, expected: Any) -> float:
    """Largest difference over the largest expected value."""
    if np.shape(values) != np.shape(expected):
        return float("inf")
    largest = float(np.abs(expected).max(initial=0.0))
    difference = float(np.abs(values - expected).max(initial=0.0))
    return difference / largest if largest > 0.0 else difference


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", nargs="*", help="all by default")
    parser.add_argument("--size", choices=("small", "shipped"), default="shipped")
    chosen = parser.parse_args()
    failed = 0
    for name in chosen.scene or scenes(chosen.size):
        found = dict(differences(chosen.size, name))
        what, worst = max(found.items(), key=lambda item: item[1])
        bad = any(not value <= allowed(chosen.size, name, key) for key, value in found.items())
        failed += bad
        print(
            f"{'DIFFERS' if bad else 'agrees'}  {name}: at most {worst:.1e} of the largest value, in {what}", flush=True
        )
    return min(failed, 1)


if __name__ == "__main__":
    sys.exit(main())
