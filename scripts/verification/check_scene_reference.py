#!/usr/bin/env python3
"""Compare the scenes with stored arrays of the program before the redesign of its core (commit f6cb3e2).

If the facts of a small scene have `forces_commit`, its arrays were stored again at that commit. Since then, forces are
those of the emitted sound (change up to 30 % in the millisecond of a ring-up, 4 % later), sound from behind does not
reach a surface, and the mean of a moving focus keeps the lit points of each moment (change 0.06 % of the force of
hover_explore). `path_commit`: the same for a path on the skin (stroke_palm), which has been nearer to the shortest one
since (force 0.2 %, displacement 0.2 %). `mesh_commit`: the same (`--store`) for meshes for all foci of a region, and
for outlines and depths of patches that do not depend on the edges. Forces then changed by at most 3e-4 and ARP by 3e-3,
the motion of these coarse layers by 0.2 to 3 %, and by 15 to 65 % with a moving focus on the palm. With focus_region_m
0 the discs had their old arrays.

Solver, mesh and step are the same as at that commit. `small` layers take seconds and are a test. `shipped` scenes take
some minutes each: run this file.
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
from palmfield.simulation import skin_sound

REFERENCE = Path(__file__).parents[2] / "tests" / "data" / "scene_reference"
TOLERANCE, IN_POINTS = 1e-5, 5e-4
"""Tolerances relative to the maximum of each array.

The second is for the motion of skins with small models, which use few points of their load now: a tenth of the
allowed reduction error at accuracy 0.05.
"""
MOTION = ("displacement_m", "velocity_m_s", "sensor channel 3", "sensor channel 4")
P0_PA_M = 2.53
"""p0 of all arrays at that commit."""
NODES = 24
FORCE, DISPLACEMENT, VELOCITY, ARP = slice(0, 3), 3, 4, 5
"""Channels of the sensor of the skin."""


def scenes(size: str) -> list[str]:
    """Return the names of the scenes with stored arrays. size: "small" or "shipped"."""
    return sorted(path.stem for path in (REFERENCE / size).glob("*.npz"))


def opened(facts: dict[str, Any]) -> Simulation:
    """Return the scene with the steps of that time, at the time from which it was stored."""
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
    """Return the names of the compared arrays, and their largest differences relative to the stored maximum."""
    # The force then came from all samples of a body, also from those that the arrays don't see
    with patch.object(skin_sound, "visible", lambda points, normals, arrays: np.ones(len(points), np.bool_)):
        return list(_differences(size, name))


def _differences(size: str, name: str) -> Iterator[tuple[str, float]]:
    facts, expected = stored(size, name)
    found, arrays = stepped(facts, expected["nodes"])
    yield "unknowns", abs(found["unknowns"] - facts["unknowns"]) / facts["unknowns"]
    yield "step_s", abs(found["step_s"] - facts["step_s"]) / facts["step_s"]
    yield "rest_m", relative(arrays["rest_m"], expected["rest_m"])
    if facts["response"]:
        yield "emitted", relative(arrays["emitted"], expected["emitted"])
    for channel in (FORCE, DISPLACEMENT, VELOCITY, ARP):
        yield (
            f"sensor channel {channel}",
            relative(arrays["sensordata"][:, channel], expected["sensordata"][:, channel]),
        )
    for key in ("displacement_m", "velocity_m_s", "force_N", "qpos"):
        yield key, relative(arrays[key], expected[key])
    yield f"ended with {facts['ended']}", float(found["ended"] != facts["ended"])


def stored(size: str, name: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the stored facts and arrays of a scene."""
    with np.load(REFERENCE / size / f"{name}.npz") as file:
        return json.loads(str(file["facts"])), {key: file[key] for key in file.files if key != "facts"}


def stepped(facts: dict[str, Any], nodes: Any = None) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return facts and arrays of a scene stepped now.

    nodes: of the surface, by default as many as in the stored arrays
    """
    sim = opened(facts)
    skin, layer = sim.skin(), sim.runtime.model.skins[0].layer
    if nodes is None:
        nodes = np.linspace(0, layer.mesh.surface_nodes - 1, NODES).round().astype(int)
    rows: dict[str, list[Any]] = {
        key: [] for key in ("time_s", "sensordata", "displacement_m", "velocity_m_s", "force_N", "qpos")
    }
    for _ in range(facts["steps"]):
        sim.step()
        normals = skin.rest_normal[nodes]
        rows["displacement_m"].append(np.einsum("ij,ij->i", skin.displacement[nodes], normals))
        rows["velocity_m_s"].append(np.einsum("ij,ij->i", skin.velocity[nodes], normals))
        rows["sensordata"].append(sim.data.sensordata.copy())
        rows["force_N"].append(sim.forces[0].copy())
        rows["qpos"].append(sim.data.qpos.copy())
        rows["time_s"].append(sim.data.time)
    found = {"unknowns": int(layer.system.ndof), "step_s": float(layer.sizes.step_s), "ended": skin.solver,
             "mesh_nodes": len(layer.mesh.nodes), "surface_nodes": int(layer.mesh.surface_nodes)}  # fmt: skip
    emitted = sim.runtime.amplitudes if facts["response"] else np.zeros(0, complex)
    arrays = {key: np.array(values) for key, values in rows.items()}
    return found, arrays | {"nodes": nodes, "rest_m": skin.rest_position[nodes], "emitted": emitted}


def store(size: str, name: str, commit: str) -> None:
    """Store the arrays of a scene again, with `mesh_commit` in the facts, and print the changes."""
    facts, before = stored(size, name)
    with patch.object(skin_sound, "visible", lambda points, normals, arrays: np.ones(len(points), np.bool_)):
        found, arrays = stepped(facts)
    channels = zip(("force", "displacement", "ARP"), (FORCE, DISPLACEMENT, ARP), strict=True)
    changes = [
        f"{what} {relative(arrays['sensordata'][:, channel], before['sensordata'][:, channel]):.1e}"
        for what, channel in channels
    ]
    print(
        f"{name}: unknowns {facts['unknowns']} -> {found['unknowns']}; largest change: {', '.join(changes)}", flush=True
    )
    kept = json.dumps(facts | found | {"mesh_commit": commit})
    np.savez_compressed(REFERENCE / size / f"{name}.npz", facts=np.array(kept), **arrays)


def allowed(size: str, name: str, what: str) -> float:
    """Return the largest allowed difference of an array."""
    return IN_POINTS if stored(size, name)[0]["began"] == "reduced" and what in MOTION else TOLERANCE


def relative(values: Any, expected: Any) -> float:
    """Return the largest difference relative to the largest expected value."""
    if np.shape(values) != np.shape(expected):
        return float("inf")
    largest = float(np.abs(expected).max(initial=0.0))
    difference = float(np.abs(values - expected).max(initial=0.0))
    return difference / largest if largest > 0.0 else difference


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", nargs="*", help="all by default")
    parser.add_argument("--size", choices=("small", "shipped"), default="shipped")
    parser.add_argument("--store", metavar="COMMIT", help="store the arrays of this commit instead")
    chosen = parser.parse_args()
    failed = 0
    if chosen.store:
        for name in chosen.scene or scenes(chosen.size):
            store(chosen.size, name, chosen.store)
        return 0
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
