#!/usr/bin/env python3
"""Compare solvers spectral_elements and particles in a scene with wedges on the CPU: difference and time.

python scripts/verification/check_steppers_on_gpu.py [SCENE ...] [--device cuda:0] [--duration 0.03] [--set KEY=VALUE]

SCENE is one of SCENES, both by default, at the sizes there. "surface" and "focus" are differences of the displacement
from that of wedges, relative, L2 over the times, over the surface and at the node that moves most. "stated" has the
estimates of both runs for mesh and step (summary.json), first of the solver, then of wedges; both have the same cut
edge. The check fails if the difference at the focus exceeds their sum. "again" is whether a copy made during a run
continued with the same bits.
"""

import argparse
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

import palmfield
from palmfield import Simulation
from palmfield.studies.bench.field import git_commit

ROOT = Path(__file__).resolve().parents[2]
SCENES: dict[str, dict[str, Any]] = {
    "phantom_am200": {"skin.radius_m": 0.04},
    "palm_am200": {"skin.patch_radius_m": 0.03},
}
HEAD = (
    "| scene | solver | mesh | steps a MuJoCo step | ms per simulated ms | surface | focus | stated | again |\n"
    "|---|---|---|---|---|---|---|---|---|"
)


def moved(scene: str, device: str, duration_s: float, keys: dict[str, Any]) -> tuple[np.ndarray, dict[str, Any]]:
    """Return the displacement [m] of the surface nodes over the times of a run, (t, S, 3), and its skin's summary."""
    sim = Simulation(ROOT / "mjcf" / "scenes" / f"{scene}.xml", device=device, keys=keys)
    result = palmfield.run(sim, None, duration_s=duration_s, progress=False)
    return result.dataset[f"skin/{sim.skins[0]}"]["displacement"].values, result.summary["skins"][0]


def _of_mesh_and_step(summary: dict[str, Any]) -> float:
    return float(summary["mesh_error_relative"] + summary["step_error_relative"])


def pace(scene: str, device: str, duration_s: float, keys: dict[str, Any]) -> tuple[float, int, bool]:
    """Return wall ms per simulated ms after preparation, scheme steps per MuJoCo step, and whether a copy repeats."""
    sim = Simulation(ROOT / "mjcf" / "scenes" / f"{scene}.xml", device=device, keys=keys)
    model = sim.runtime.model
    timestep_s = model.spec.timestep_s
    count = max(4, round(0.5 * duration_s / timestep_s))
    for _ in range(count):
        sim.step()
    other = sim.copy()
    wp.synchronize()
    begun = time.perf_counter()
    for _ in range(count):
        sim.step()
    wp.synchronize()
    seconds = time.perf_counter() - begun
    for _ in range(count):
        other.step()
    same = np.array_equal(sim.data.plugin_state, other.data.plugin_state)
    stepper: Any = model.begin[0].value
    return seconds / (count * timestep_s), stepper.steps * model.substeps, same


def rows(scene: str, device: str, duration_s: float, keys: dict[str, Any]) -> tuple[list[str], bool]:
    """Return lines of the table, and whether all values are within the estimates."""
    expected, own = moved(scene, "cpu", duration_s, keys | {"skin.solver": "wedges"})
    lines, good = [], True
    most = int(np.argmax(np.linalg.norm(expected, axis=2).max(axis=0)))
    for solver in ("spectral_elements", "particles"):
        found, summary = moved(scene, device, duration_s, keys | {"skin.solver": solver})
        apart = found - expected
        surface = np.linalg.norm(apart) / np.linalg.norm(expected)
        focus = np.linalg.norm(apart[:, most]) / np.linalg.norm(expected[:, most])
        stated = _of_mesh_and_step(summary), _of_mesh_and_step(own)
        ms, steps, same = pace(scene, device, duration_s, keys | {"skin.solver": solver})
        good &= bool(focus <= sum(stated)) and same
        mesh = summary["solver"].partition(": ")[2]
        lines.append(
            f"| {scene} | {solver} | {mesh} | {steps} | {ms:.3g} | {100 * surface:.1f} % "
            f"| {100 * focus:.1f} % | {100 * stated[0]:.1f} % + {100 * stated[1]:.1f} % | {'yes' if same else 'NO'} |"
        )
        print(lines[-1], flush=True)
    return lines, good


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", default=list(SCENES))
    parser.add_argument("--device", default="cuda:0")
    parser.add_argument("--duration", type=float, default=0.03, help="simulated time [s]")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="a key of the scene")
    options = parser.parse_args()
    unknown = [name for name in options.scenes if name not in SCENES]
    if unknown:
        parser.error(f"scene is '{unknown[0]}'; use one of {', '.join(SCENES)}")
    more = dict(pair.split("=", 1) for pair in options.set)
    print(f"{wp.get_device(options.device).name}, {git_commit()}\n\n{HEAD}", flush=True)
    results = [rows(name, options.device, options.duration, SCENES[name] | more)[1] for name in options.scenes]
    return 0 if all(results) else 1


if __name__ == "__main__":
    sys.exit(main())
