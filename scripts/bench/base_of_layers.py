"""Compare bases below the palm and other regions: bone, deep tissue, muscle. Prints tables for docs/skin.md.

    python scripts/bench/base_of_layers.py

The regions: displacement at the centre of a spot of 10.3 mm on an infinite flat layer of preset palm, relative to bone.
The palm: `palm_am200` with full wedges and absorbing sides at 60 and 200 Hz; also unknowns and time per substep.
"""

import time
from pathlib import Path

import numpy as np

import palmfield
from palmfield.estimate.numerics.base_band import ALTERNATIVES, responses
from palmfield.skin import Sheet, half_space, preset
from palmfield.skin.fem.wedge_stepper import WedgeStepper
from palmfield.skin.stepper import SurfaceLoads

SCENE = Path(__file__).resolve().parents[2] / "mjcf" / "scenes" / "palm_am200.xml"
REGIONS_MM = {"finger pulp": 5.0, "palm, thin": 8.0, "palm centre": 13.0, "hypothenar": 17.0}
FREQUENCIES_Hz = (0.0, 60.0, 200.0)
STEPS = 50


def regions() -> list[str]:
    palm = preset("palm")
    bases = ("bonded", half_space(palm), half_space(preset("muscle")))
    rows = []
    for name, depth_mm in REGIONS_MM.items():
        cells = []
        for f_Hz in FREQUENCIES_Hz:
            bone, deep, muscle = responses([Sheet(palm, 1e-3 * depth_mm)], 0.0103, f_Hz, bases)
            cells.append(f"{deep / bone:.2f}, {muscle / bone:.2f}")
        rows.append(f"| {name}, {depth_mm:g} mm | {' | '.join(cells)} |")
    return rows


def palm() -> list[str]:
    rows = []
    for base in ALTERNATIVES:
        moved = []
        for f_Hz in (60, 200):
            keys = {"skin.base": base, "skin.solver": "wedges", "skin.patch_radius_m": 0.04, "skin.side": "absorbing",
                    "stimulus.am_frequency_Hz": f_Hz}  # fmt: skip
            scene = palmfield.Simulation(SCENE, keys=keys)
            result = palmfield.run(scene, duration_s=0.05, estimate="none")
            moved.append(1e6 * result.summary["skins"][0]["peak_displacement_m"])
        layer = scene.runtime.model.skins[0].layer
        unknowns, rows_deep = layer.system.ndof, len(layer.sizes.depth_fractions) - 1
        stepper = WedgeStepper(layer.system, layer.quadrature.operator, layer.step_s)
        state, one = np.zeros((1, stepper.state_size)), np.ones((1, STEPS, 1))
        loads = SurfaceLoads(np.ones((1, 1, layer.quadrature.operator.shape[1])), one, one)
        times = []
        for _ in range(5):
            begun = time.perf_counter()
            stepper.step(state, loads, 0.0, STEPS * stepper.step_s)
            times.append(time.perf_counter() - begun)
        step_ms = 1e3 * min(times) / STEPS
        rows.append(f"| {base} | {moved[0]:.2f} | {moved[1]:.2f} | {unknowns} ({rows_deep} rows) | {step_ms:.2f} |")
    return rows


if __name__ == "__main__":
    print("\n".join(regions()))
    print("\n".join(palm()))
