"""Whole scenes of a coverage run: a disc, a hand or a user's mesh over an array, solved by `palmfield.run`.

The focus is fixed over the middle of the disc, at the sensor. Only the mean of the load around the axis then affects
the sensor, so the independent code uses this mean. For hands and meshes, another solver computes the reference in the
same scene.
"""

import json
import math
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from small_scene import small_scene_texts

import palmfield
from palmfield.errors import SceneError
from palmfield.simulation.emission import array_drives
from palmfield.simulation.radiation import Radiation
from palmfield.skin.materials.catalogue import preset
from palmfield.stimulus.schedule import frames_at
from palmfield.types import Float

SCENES = Path(__file__).parents[2] / "mjcf" / "scenes"
PRESETS = ("ecoflex_00-10", "gelatin_2", "palm", "finger_pad")
NAMED = ("reduced", "wedges", "spectral_elements")
"""Solvers one of which also solves a scene by name, in addition to `auto`."""
DURATION_S = 0.024
STEP_S = 1e-3
"""MuJoCo's step in these scenes: a sensor is evaluated at the beginning of each step."""
FINE_S = 2.5e-5
"""Time step within which the course of the load counts as linear."""
ROUND = 32
"""Number of places on a circle around the focus, over which pressures are averaged."""
RADII = 160


def draw_scene(random: np.random.Generator, accuracy: float) -> dict[str, Any]:
    """Return the file and keys of a scene, its solvers, and its body in the form of the other cases."""

    def between(low: float, high: float) -> float:
        return float(np.exp(random.uniform(np.log(low), np.log(high))))

    def pick(*names: str) -> str:
        return names[int(random.integers(len(names)))]

    radius, depth = between(0.010, 0.030), between(0.003, 0.012)
    side, base = pick("fixed", "free", "roller"), pick("bonded", "bonded", "free_slip")
    material = pick(*PRESETS)
    keys: dict[str, Any] = {
        "skin.radius_m": radius, "skin.thickness_m": depth, "skin.side": side, "skin.base": base,
        "skin.accuracy": accuracy, "skin.material": material,
    }  # fmt: skip
    scene = "phantom_am200"
    if random.random() < 0.6:
        keys |= {"stimulus.am_frequency_Hz": between(50.0, 250.0), "stimulus.am_quantity": pick("amplitude", "arp")}
        keys |= {"stimulus.am_depth": float(random.uniform(0.5, 1.0))}
    else:
        scene = "phantom_step"
        keys["stimulus.ramp_s"] = 0.0 if random.random() < 0.5 else between(1e-3, 8e-3)
    sheets = [{"thickness_m": depth, "material": numbers_of(material)}]
    times = (STEP_S * np.arange(1, round(DURATION_S / STEP_S))).tolist()
    return {
        "scene": scene, "keys": keys, "accuracy": accuracy, "solvers": ["auto", pick(*NAMED)],
        "by_scikit_fem": True, "by_others": False,
        "body": {"shape": "disc", "side": side, "base": base, "radius_m": radius, "sheets": sheets},
        "times_s": times, "at_m": [[0.0, 0.0]],
    }  # fmt: skip


def draw_body_scene(random: np.random.Generator, accuracy: float, kind: str) -> dict[str, Any]:
    """Return a scene of a hand's palm or a user's ellipsoid with its file; result as of `draw_scene`."""

    def between(low: float, high: float) -> float:
        return float(np.exp(random.uniform(np.log(low), np.log(high))))

    frequency, patch = between(60.0, 250.0), between(0.016, 0.024)
    keys: dict[str, Any] = {
        "skin.accuracy": accuracy, "skin.patch_radius_m": patch, "stimulus.am_frequency_Hz": frequency,
        "stimulus.am_depth": float(random.uniform(0.5, 1.0)),
    }  # fmt: skip
    case: dict[str, Any] = {"keys": keys, "accuracy": accuracy, "by_scikit_fem": False, "by_others": True}
    if kind == "hand":
        keys["skin.side"] = "fixed" if random.random() < 0.5 else "free"
        scene = {"scene": "palm_am200"}
    else:
        half = [between(0.03, 0.05), between(0.03, 0.05), between(0.015, 0.03)]
        skin = {
            "depth_m": between(0.003, 0.008), "side": "fixed" if random.random() < 0.5 else "free",
            "material": PRESETS[int(random.integers(len(PRESETS)))],
        }  # fmt: skip
        scene = {"scene": "ellipsoid", "half_m": half, "skin": skin}
    times = (STEP_S * np.arange(1, round(DURATION_S / STEP_S))).tolist()
    body = {"shape": "scene"}
    return scene | case | {"solvers": ["auto", "wedges"], "body": body, "times_s": times, "at_m": [[0.0, 0.0]]}


def opened(case: dict[str, Any], keys: dict[str, Any], folder: Path) -> palmfield.Simulation:
    """Return the scene of a case with keys. folder: folder for the scene with a user's mesh."""
    if "half_m" not in case:
        return palmfield.load(SCENES / f"{case['scene']}.xml", keys=keys)
    solid = trimesh.creation.icosphere(4, 1.0)
    solid.apply_scale([1e3 * half for half in case["half_m"]])
    # The skin's frame looks along its own z, from the ellipsoid's top
    solid.apply_translation((0.0, 0.0, -1e3 * case["half_m"][2]))
    solid.export(folder / "solid.obj")
    skin = {
        "shape": "mesh", "mesh": "solid.obj", "mesh_unit": "mm", "patch_site": "centre", "radius_m": None,
        "thickness_m": None, "element_m": None, "step_s": None, **case["skin"],
    }  # fmt: skip
    plain, haptic = small_scene_texts(DURATION_S, skin=skin)
    (folder / "plain.xml").write_text(plain)
    (folder / "scene.xml").write_text(haptic)
    return palmfield.load(folder / "scene.xml", keys=keys)


def numbers_of(name: str) -> dict[str, Any]:
    """Return a preset as plain data."""
    material = preset(name)
    return {
        "density_kg_m3": material.density_kg_m3, "shear_relaxed_Pa": material.shear_relaxed_Pa,
        "bulk_Pa": material.bulk_Pa, "viscosity_Pa_s": material.viscosity_Pa_s, "bulk_relaxes": material.bulk_relaxes,
        "branches": [[branch.shear_Pa, branch.time_s] for branch in material.branches],
    }  # fmt: skip


def with_load(case: dict[str, Any]) -> dict[str, Any]:
    """Return a case of a scene with its load: pressure [Pa] by distance from the axis [m], and its factor over time."""
    simulation = palmfield.load(SCENES / f"{case['scene']}.xml", keys=case["keys"])
    runtime = simulation.runtime
    model, posed = runtime.model, runtime.work.reference
    drive = array_drives(model, model.arrays)[0].unit_drive(model.stimuli[0].reference_foci).amplitudes
    radii = case["body"]["radius_m"] * np.linspace(0.0, 1.0, RADII)
    angles = 2.0 * math.pi / ROUND * (0.5 + np.arange(ROUND))
    x, y = radii[:, None] * np.cos(angles), radii[:, None] * np.sin(angles)
    places = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    frame = posed.bodies[0].frame
    outward = frame.vectors(np.tile([0.0, 0.0, 1.0], (len(places), 1)))
    arp = Radiation(model).at(posed, 0, "probe", frame.points(places), outward, drive).arp.reshape(x.shape)
    config = model.stimuli[0].config
    times = FINE_S * np.arange(1 + round(DURATION_S / FINE_S))
    factors = frames_at(config, times)[1]
    # What is there at once is there from the first time on
    law, kept = ("held", [0]) if np.all(factors == factors[0]) else ("linear", range(len(times)))
    profile = arp.mean(axis=1, dtype=float)
    half = radii[int(np.argmax(profile < 0.5 * profile[0]))]
    load = {
        "fwhm_m": 2.0 * float(half), "law": law, "times_s": times[kept].tolist(), "peak_Pa": factors[kept].tolist(),
        "centre_m": [[0.0, 0.0]] * len(kept), "radii_m": radii.tolist(), "profile_Pa": profile.tolist(),
    }  # fmt: skip
    return case | {"load": load}


def run_scene(case: dict[str, Any], solver: str, accuracy: float | None = None) -> dict[str, Any]:
    """Return the readings of the central sensor as a displacement with one component, and the numerical budget.

    accuracy: replaces that of the case. For hands and meshes the budget omits cut edges, because references have the
    same ones
    """
    keys = case["keys"] | ({} if solver == "auto" else {"skin.solver": solver})
    keys |= {} if accuracy is None else {"skin.accuracy": accuracy}
    with tempfile.TemporaryDirectory() as folder:
        simulation = opened(case, keys, Path(folder))
        result = palmfield.run(simulation, duration_s=DURATION_S)
    budget = json.loads(result.dataset.attrs["error_budget"])["skin"]
    if not isinstance(budget, dict):
        raise SceneError(f"no error budget: {budget}")
    values = result.dataset["sensors/skin"]["value"].sel(channel="normal_displacement_m").to_numpy()
    moved: Float = np.zeros((len(case["times_s"]), 1, 3))
    moved[:, 0, 2] = values[1 : 1 + len(moved)]
    numbers = budget["numerical"]
    error = numbers["displacement_error_relative"]
    if case["by_others"]:
        error = math.hypot(*(numbers[f"{name}_error_relative"] for name in ("mesh", "step", "reduction", "field")))
    name = result.summary["skins"][0]["solver"]
    return {"displacement_m": moved.tolist(), "displacement_error": error, "solver": name}
