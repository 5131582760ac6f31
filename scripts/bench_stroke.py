"""Measure a focus that strokes the reference hand for half a second, in a scene on the CPU and on a GPU.

python scripts/bench_stroke.py scene            two CPU cores; writes docs/bench/stroke.md
python scripts/bench_stroke.py spectral_elements [--device cuda:0] [--seconds 0.5] [--save FILE.npz]
python scripts/bench_stroke.py wedges --seconds 0.03 --against FILE.npz     its first part, on the CPU
"""

import argparse
import os
import time
from pathlib import Path

import numpy as np

import palmfield
from palmfield.data import folder
from palmfield.hand.patch import surface_patch
from palmfield.hand.preset import load_preset
from palmfield.hand.surface import hand_surface
from palmfield.skin.materials.catalogue import preset
from palmfield.skin.materials.material import Sheet
from palmfield.skin.problem import Layer, Spot
from palmfield.skin.solver_choice import solve
from palmfield.studies.bench.table import processor

ROOT = Path(__file__).resolve().parents[1]
SPEED_m_s, LENGTH_m, DEPTH_m, SPOT_m, PEAK_Pa = 4.0, 0.07, 0.002, 0.0103, 46.0
KEYS = {
    "skin.depth_m": DEPTH_m,
    "skin.patch_radius_m": 0.045,
    "skin.material": "finger_pad",
    "skin.accuracy": 0.05,
    "stimulus.path": "line",
    "stimulus.path_sites": None,
    "stimulus.path_width_m": LENGTH_m,
    "stimulus.frame": "palm_centre",
    "stimulus.focus_m": (0, 0, 0),
    "stimulus.path_speed_m_s": SPEED_m_s,
}


def in_scene(seconds: float) -> str:
    """Run the scene stroke_palm on that layer: sound of 256 transducers, their ring-up, forces on the hand, skin."""
    began, busy = time.perf_counter(), time.process_time()
    sim = palmfield.Simulation(folder("mjcf") / "scenes" / "stroke_palm.xml", keys=KEYS)
    sim.step()
    ready = time.perf_counter() - began
    while sim.time < seconds - 1e-9:
        sim.step()
    wall, processor_s = time.perf_counter() - began, time.process_time() - busy
    skin, stepper = sim.runtime.model.skins[0], sim.runtime.model.begin[0].value
    made = f"reduced model {100 * stepper.error:.2g} %" if stepper.error else ""
    return (
        f"| scene, `{sim.skin().solver}` | {len(skin.layer.mesh.elements)} | {skin.layer.dofs} | {wall:.1f} | "
        f"{processor_s:.1f} | {ready:.1f} | {wall / seconds:.0f} | {made} |"
    )


def problem(seconds: float) -> tuple[Layer, Spot, np.ndarray]:
    """Return the layer of docs/bench/skin_spectral_elements.md, a spot that moves back and forth, and two points."""
    hand = hand_surface(load_preset("open_men_p50"))
    patch = surface_patch(
        hand.surface, DEPTH_m, np.zeros(3), 0.045, 0.0018, 0.0018, 0.045, max_depth_m=DEPTH_m, max_fraction=1.0
    )
    body = Layer(patch, (Sheet(preset("finger_pad"), DEPTH_m),))
    grid = np.arange(0.0, seconds + 1e-9, 1e-4)
    turns = np.mod(grid * SPEED_m_s / LENGTH_m, 2.0)
    x = LENGTH_m * (np.minimum(turns, 2.0 - turns) - 0.5)
    load = Spot(SPOT_m, grid, np.full(len(grid), PEAK_Pa), np.column_stack([x, np.zeros_like(x)]))
    at = [patch.vertices[np.hypot(*(patch.vertices[:, :2] - place).T).argmin()] for place in ([0.0, 0.0], [0.02, 0.0])]
    return body, load, np.array(at)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("scene", "spectral_elements", "wedges"))
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--seconds", type=float, default=0.5)
    parser.add_argument("--save", type=Path)
    parser.add_argument("--against", type=Path)
    arguments = parser.parse_args()
    if arguments.what == "scene":
        print(f"{processor()}, {os.cpu_count()} cores, load average {os.getloadavg()[0]:.1f}")
        print(in_scene(arguments.seconds))
        return
    body, load, at = problem(arguments.seconds)
    solver = arguments.what
    if solver == "spectral_elements":
        # Kernels are compiled before anything is timed
        solve(body, load, load.times_s[1:3], at, solver=solver, accuracy=0.05, device=arguments.device)
    for _ in range(3 if solver == "spectral_elements" else 1):
        motion = solve(body, load, load.times_s[1:], at, solver=solver, accuracy=0.05, device=arguments.device)
        print(f"{solver}: {motion.seconds:.2f} s, {motion.seconds / arguments.seconds:.1f} times real time; "
              f"{motion.solver}; error {100 * motion.error:.2g} % ({motion.error_source})", flush=True)  # fmt: skip
    if arguments.save:
        np.savez(arguments.save, times=motion.times_s, displacement=motion.displacement_m)
    if arguments.against:
        found, count = np.load(arguments.against)["displacement"][:, :, 2], len(motion.times_s)
        own = motion.displacement_m[:, :, 2]
        apart = np.linalg.norm(found[:count] - own, axis=0) / np.linalg.norm(own, axis=0)
        print(f"difference from {arguments.against} over {arguments.seconds:g} s: {100 * apart.max():.2g} %")


if __name__ == "__main__":
    main()
