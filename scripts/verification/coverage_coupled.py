"""Test the error estimate of `palmfield run` for ten kinds of coupled scenes, each against a finer mesh.

    python scripts/verification/coverage_coupled.py begin --seed 1
    python scripts/verification/coverage_coupled.py run

`begin` writes the seed and freezes the code, as coverage.py does; `run` appends a line for each scene and skips those
with a line. If a scene is refused before the run, another of its kind is drawn. The reference is the same scene by
solver wedges, with edges 2.5 or 3 times finer, half the substep and a fifth of the target accuracy. Both have the same
cut edges, so their part of the estimate does not count. Set OMP_NUM_THREADS=1, OPENBLAS_NUM_THREADS=1 and
PALMFIELD_CACHE=off.
"""

import argparse
import json
import math
import time
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from coverage_draw import between, pick
from coverage_report import CONVERGED
from coverage_scenes import PRESETS, SCENES
from coverage_store import CODE, FOLDER, begin, known_head, rounded

import palmfield
from palmfield.errors import SceneError
from palmfield.skin.approximation.richardson import error_of_finer
from palmfield.skin.scene_layer import LayerSizes
from palmfield.studies.bench.table import keep_rows
from palmfield.types import Float

REFINED = {"small": (3.0, 1.8), "default": (2.5, 1.6)}
"""Ratios of the edges of a scene to those of its reference, and to those of the mesh that gives the reference's error,
by the patch: a small one, or that of the scene."""
DEFAULT = ("am", "am 40 Hz", "circle")
"""Kinds with the patch of the scene and accuracy 0.05: they have enough unknowns for coarser meshes."""
ORDER = 2.0
"""Order of convergence for the error of the reference: that of the elements."""
PARTS = ("mesh", "step", "reduction", "field")
Readings = dict[str, Float]
CHANNELS = {"displacement": "normal_displacement_m", "velocity": "normal_velocity_m_s"}
KINDS: dict[str, tuple[str, str, str]] = {
    "am": ("palm_am200", "palm_centre", "skin"),
    "am 40 Hz": ("palm_am200", "palm_centre", "skin"),
    "step": ("palm_step_sonicsurface", "palm_centre", "skin"),
    "circle": ("palm_circle", "palm_centre", "skin"),
    "lm": ("palm_am200", "palm_centre", "skin"),
    "disc am": ("phantom_am200", "centre", "skin"),
    "modal": ("palm_am200", "palm_centre", "skin"),
    "disc circle": ("phantom_stm70", "centre", "skin"),
    "turning hand": ("trace_shape", "palm_centre", "skin"),
    "fingertip": ("palm_and_fingertip", "index_pad", "fingertip"),
}
"""Scene, site near the focus, and skin of each kind."""


def draw(seed: int, again: int = 0) -> list[dict[str, Any]]:
    """Return one scene per kind as plain data: keys, positions of sensors around the site [m], duration [s].

    again: number of refused scenes of the kind so far.
    """
    first = again * len(KINDS)
    return [_draw_one(np.random.default_rng([seed, first + number, 37]), kind) for number, kind in enumerate(KINDS)]


def _draw_one(random: np.random.Generator, kind: str) -> dict[str, Any]:
    scene, site, skin = KINDS[kind]
    disc, finger, default = kind.startswith("disc"), kind == "fingertip", kind in DEFAULT
    reach, duration = (1.0 if finger else 2.5) * 1e-3, 0.04
    focus = np.zeros(2) if finger else random.uniform(-4e-3, 4e-3, 2)
    keys: dict[str, Any] = {
        "array.response": pick(random, "on", "off"),
        f"{skin}.accuracy": 0.05 if default or random.random() < 0.5 else 0.1,
    }  # fmt: skip
    if disc:
        keys |= {"skin.radius_m": between(random, 0.015, 0.025), "skin.thickness_m": between(random, 4e-3, 9e-3)}
        keys |= {"skin.material": pick(random, "ecoflex_00-10", "gelatin_2"), "stimulus.stop_s": None}
    else:
        radius = between(random, 0.010, 0.012) if finger else between(random, 0.014, 0.018)
        keys |= {} if default else {f"{skin}.patch_radius_m": radius}
        keys[f"{skin}.material"] = pick(random, *PRESETS)
        keys |= {"palm.patch_radius_m": 0.014} if finger else {}
    keys[f"{skin}.side"] = pick(random, "fixed", "free")
    if kind == "step":  # this board plays no focus in a moving frame; the hand has the axes of the array
        keys["stimulus.focus_m"] = (*focus.tolist(), 0.2)
    elif not finger:
        keys |= {"stimulus.frame": site, "stimulus.focus_m": (*focus.tolist(), 0.0)}
    if random.random() < 0.5:
        keys |= {"stimulus.arp_peak_Pa": between(random, 2.0, 9.0), "stimulus.drive_amplitude": None}
    else:
        keys |= {"stimulus.drive_amplitude": float(random.uniform(0.3, 1.0)), "stimulus.arp_peak_Pa": None}
    if kind == "step":  # this board is on or off
        keys |= {"stimulus.arp_peak_Pa": None, "stimulus.drive_amplitude": None}
    elif kind in ("am", "disc am", "modal", "fingertip"):
        keys |= {"stimulus.am_frequency_Hz": between(random, 70.0, 250.0)}
        keys |= {"stimulus.am_quantity": pick(random, "amplitude", "arp")}
    elif kind == "am 40 Hz":
        keys["stimulus.am_frequency_Hz"], duration = 40.0, 0.06
    elif kind in ("circle", "disc circle"):
        reach = between(random, 2e-3, 6e-3)
        keys |= {"stimulus.path_diameter_m": 2.0 * reach, "stimulus.path_rate_Hz": between(random, 40.0, 120.0)}
    elif kind == "lm":
        reach = between(random, 1.5e-3, 5e-3)
        keys |= {"stimulus.path": "lm", "stimulus.path_width_m": 2.0 * reach, "stimulus.modulation": "none"}
        keys |= {f"stimulus.am_{name}": None for name in ("quantity", "frequency_Hz", "depth")}
        keys["stimulus.path_rate_Hz"] = between(random, 40.0, 120.0)
    elif kind == "turning hand":
        reach = between(random, 3e-3, 5e-3)
        keys |= {"stimulus.path_width_m": 2.0 * reach, "stimulus.path_height_m": 2.0 * reach}
        keys["stimulus.path_speed_m_s"] = between(random, 1.5, 4.0)
    if kind == "modal":
        keys["skin.solver"] = "modal"
    places = [focus, *(focus + reach * np.array(away) for away in ((1, 0), (0, 1), (-1, 0), (0, -1)))]
    places = [place.tolist() for place in places]
    return {
        "kind": kind,
        "scene": scene,
        "keys": keys,
        "near_m": places,
        "duration_s": duration,
        "patch": "default" if default else "small",
    }


def opened(case: dict[str, Any], keys: dict[str, Any]) -> palmfield.Simulation:
    """Return the scene of a case with further keys, and a sensor at each of its positions."""
    _, site, skin = KINDS[case["kind"]]
    spec = mujoco.MjSpec.from_file(str(SCENES / f"{case['scene']}.xml"))
    base, model = spec.site(site), spec.sensor(skin)
    for number, (x, y) in enumerate(case["near_m"]):
        name = f"near{number}"
        base.parent.add_site(name=name, pos=base.pos + np.array([x, y, 0.0]))
        sensor = spec.add_sensor(name=name, type=model.type, objtype=model.objtype, objname=name)
        sensor.plugin.plugin_name, sensor.plugin.name = model.plugin.plugin_name, model.plugin.name
        sensor.plugin.active = True
    return palmfield.load(spec, device="cpu", keys=case["keys"] | keys)


def measured(case: dict[str, Any], keys: dict[str, Any], estimate: Any) -> tuple[dict[str, Any], Readings, LayerSizes]:
    """Return numbers of a run, its readings by quantity, (places, steps), and the sizes of its layer."""
    begin = time.process_time()
    skin = KINDS[case["kind"]][2]
    sim = opened(case, keys)
    result = palmfield.run(sim, duration_s=case["duration_s"], estimate=estimate)
    numbers = result.summary["skins"][sim.skins.index(skin)]
    layer = sim.runtime.model.skins[sim.skins.index(skin)].layer
    row: dict[str, Any] = {"unknowns": layer.dofs, "solver": numbers["solver"]}
    if estimate != "none":
        numerical = json.loads(result.dataset.attrs["error_budget"])[skin]["numerical"]
        row |= {part: numerical[f"{part}_error_relative"] for part in (*PARTS, "edge")}
        row |= {f"velocity_{part}": numerical.get(f"{part}_velocity_error_relative", row[part]) for part in PARTS}
        row["stated_displacement"] = math.hypot(*(row[part] for part in PARTS))
        row["stated_velocity"] = math.hypot(*(row[f"velocity_{part}"] for part in PARTS))
    values = [result.dataset[f"sensors/near{place}"]["value"] for place in range(len(case["near_m"]))]
    readings = {
        name: np.array([value.sel(channel=channel).to_numpy() for value in values])
        for name, channel in CHANNELS.items()
    }
    return row | {"seconds": time.process_time() - begin}, readings, layer.sizes


def judged(case: dict[str, Any]) -> dict[str, Any]:
    """Return the error estimates of a scene and its true errors, relative L2 over the second half of the run.

    true_QUANTITY: at all positions together, true_QUANTITY_first: at the first one, _whole: over the whole run. A step
        load has no motion in the second half, so its velocity is that of the whole run.
    reference_QUANTITY: error of the reference, from the mesh between, by Richardson's rule.
    """
    row, found, sizes = measured(case, {}, "quick")
    skin = KINDS[case["kind"]][2]

    def reference(finer: float, steps: float, share: float) -> tuple[dict[str, Any], Readings]:
        keys = {"solver": "wedges", "element_m": sizes.edge_fine_m / finer, "step_s": sizes.step_s / steps}
        keys["accuracy"] = case["keys"][f"{skin}.accuracy"] * share
        keys |= {"patch_radius_m": sizes.radius_m} if case["patch"] == "default" else {}
        return measured(case, {f"{skin}.{name}": value for name, value in keys.items()}, "none")[:2]

    finest, middle = REFINED[case["patch"]]
    (truth, known), (between, other) = reference(finest, 2.0, 0.2), reference(middle, 1.0, 0.4)
    row |= {"reference_unknowns": truth["unknowns"], "reference_seconds": truth["seconds"] + between["seconds"]}
    for name, exact in known.items():
        whole = np.s_[:, :]
        late = whole if case["kind"] == "step" and name == "velocity" else np.s_[:, exact.shape[1] // 2 :]
        row[f"true_{name}"] = _off(found[name][late], exact[late])
        row[f"true_{name}_first"] = _off(found[name][late][:1], exact[late][:1])
        row[f"true_{name}_whole"] = _off(found[name], exact)
        row[f"reference_{name}"] = error_of_finer(_off(other[name][late], exact[late]), finest / middle, ORDER)
        row[f"reference_{name}_whole"] = error_of_finer(_off(other[name], exact), finest / middle, ORDER)
    return {"kind": case["kind"], "scene": case["scene"], "keys": case["keys"]} | row


def _off(found: Float, exact: Float) -> float:
    return float(np.linalg.norm(found - exact) / np.linalg.norm(exact))


def section(folder: Path, out: Path) -> list[str]:
    """Return lines of the page for the scenes of a folder, None without a run; their rows go to the page's data."""
    if not (folder / "rows.jsonl").exists():
        return []
    head = json.loads((folder / "head.json").read_text())
    rows = [json.loads(line) for line in (folder / "rows.jsonl").read_text().splitlines()]
    judged = [row for row in rows if "refused" not in row]
    names = ("unknowns", *(f"{part}_{name}" for name in CHANNELS for part in ("stated", "true", "reference")))
    names += tuple(f"true_{name}_{part}" for name in CHANNELS for part in ("first", "whole"))
    table = [f"| kind | scene | solver | {' | '.join(names)} |", "|" + "---|" * (3 + len(names))]
    for row in judged:
        numbers = " | ".join(f"{row[name]:.3g}" if name != "unknowns" else str(row[name]) for name in names)
        table.append(f"| {row['kind']} | {row['scene']} | {row['solver'].split(',')[0]} | {numbers} |")

    def sure(row: dict[str, Any], quantity: str, ending: str = "") -> bool:
        """Return whether the reference is accurate enough to tell if the estimate is too low or too high."""
        stated, true = row[f"stated_{quantity}"], row[f"true_{quantity}{ending}"]
        off = row[f"reference_{quantity}{ending if ending == '_whole' else ''}"]
        return bool(off <= max(CONVERGED * max(stated, true), abs(stated - true)))

    def ratios_of(quantity: str, ending: str) -> dict[str, float]:
        some = [row for row in judged if sure(row, quantity, ending)]
        return {row["kind"]: row[f"stated_{quantity}"] / row[f"true_{quantity}{ending}"] for row in some}

    def cells(quantity: str, ending: str = "") -> str:
        ratios = list(ratios_of(quantity, ending).values())
        covered, half = sum(ratio >= 1.0 for ratio in ratios), sum(ratio < 0.5 for ratio in ratios)
        return f"{len(ratios)} | {covered} | {half} | {np.median(ratios):.2g}"

    below = [
        f"{quantity} of {kind} ({ratio:.2g} of the true error)"
        for quantity, ending in (("displacement", ""), ("velocity", ""), ("velocity", "_whole"))
        for kind, ratio in ratios_of(quantity, ending).items()
        if ratio < 1.0
    ]
    kept = keep_rows(out, table, f"{out.stem}_coupled")
    return [
        "## Coupled scenes",
        "",
        f"`python scripts/verification/coverage_coupled.py run`, commit {head['frozen'][:8]}, seed {head['seed']}: ten "
        f"kinds of scenes with array, body, stimulus and skin ({kept}). {len(rows) - len(judged)} more were refused "
        "before the run. The reference is solver wedges with elements 2.5 or 3 times finer. Errors are relative L2 "
        "errors over the second half of the run, at five places near the focus. The stated error is without cut edges. "
        "Stated too small: "
        f"{', '.join(below) or 'none'}.",
        "",
        "| true error of | judged | stated >= true | below half | median stated / true |",
        "|---|---|---|---|---|",
        f"| displacement near the focus | {cells('displacement')} |",
        f"| displacement at the focus | {cells('displacement', '_first')} |",
        f"| velocity near the focus | {cells('velocity')} |",
        f"| velocity near the focus, whole run | {cells('velocity', '_whole')} |",
        "",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("step", choices=("begin", "run"))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--folder", type=Path, default=FOLDER / "coupled")
    settings = parser.parse_args()
    if settings.step == "begin":
        begin(settings.folder, settings.seed, len(KINDS))
        return
    head = known_head(settings.folder, code=CODE)
    path = settings.folder / "rows.jsonl"
    rows = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    for place, kind in enumerate(KINDS):
        while not any(row["kind"] == kind and "refused" not in row for row in rows):
            case = draw(head["seed"], sum(row["kind"] == kind for row in rows))[place]
            try:
                row = judged(case)
            except SceneError as error:
                row = {"kind": kind, "scene": case["scene"], "keys": case["keys"], "refused": str(error)}
            rows.append(row)
            with path.open("a") as file:
                file.write(json.dumps(rounded(row)) + "\n")
            names = ("refused", *(f"{part}_{name}" for name in CHANNELS for part in ("stated", "true")))
            print(kind, *(f"{name} {row[name]}" for name in names if name in row), flush=True)


if __name__ == "__main__":
    main()
