#!/usr/bin/env python3
"""Compare modes for a load class with the whole layer on the same mesh, for loads outside the examples.

python scripts/verification/check_modes.py [SCENE ...] [--blocks 12 22 32] [--write docs/bench/modes.md] [--commit HASH]

For each scene (a name in mjcf/scenes, palm_am200 by default; with suffix `:shadows` for a class with shadow edges,
`:sheets` for three sheets with different relaxation, `:contrast` for one sheet a hundred times as stiff as the next,
with other losses) and number of blocks: modes, time to make them, memory of their numbers, and the relative error of
displacement and velocity, L2 over the surface and 50 ms, for

- a focus at 4 and at 11 m/s on a circle that no example contains, from a sudden start; the same at 4 m/s with a control
  rate of 1 kHz; AM 200 Hz; a focus on from 1 ms to 25 ms; a hand that moves 20 mm sideways and 12 mm up in 50 ms (0.5
  m/s); two foci half a wavelength apart; a finger's shadow, 14 mm wide, that crosses the spot: once with the lit share
  of each point's area, and once with points that are either lit or dark.

Each row also has the error estimates of the stepper and the share of the load outside its class. A picture of the error
over the number of modes is next to the page.
"""

import argparse
import platform
import time
from collections.abc import Callable
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from scipy import sparse

import palmfield
from palmfield.acoustics.surface_arp import SurfaceArp
from palmfield.simulation.emission import array_drives
from palmfield.simulation.model import HapticModel
from palmfield.simulation.posed_scene import reference_scene
from palmfield.simulation.small_models import load_class, mode_estimate
from palmfield.simulation.small_models.leaving import SHORT_WAVES, OutsideClass
from palmfield.skin.materials.catalogue import PRESETS
from palmfield.skin.materials.material import prony
from palmfield.skin.reduction.modal_stepper import ModalStepper
from palmfield.skin.stepper import SkinStepper, SurfaceLoads
from palmfield.studies.bench.field import git_commit
from palmfield.studies.bench.table import cells, keep_rows, processor
from palmfield.types import Float

ROOT = Path(__file__).resolve().parents[2]
ROWS = [
    "| scene | unknowns | shapes / points | modes | build time [s] | memory [MB] | load | error | stated | outside "
    "| estimate |",
    "",
]
"""Head of the stored rows; errors in percent, displacement / velocity."""
LENGTH_S = 0.05
HALF_WAVELENGTH_m = 0.0043
OFF_GRID_m: Float = np.array([0.0023, 0.0017, 0.0])
FINGER_m = 0.014
STEPS_A_CALL = 8
PRESETS["stiff_sheet"] = prony("stiff_sheet", 1100.0, 1e6, (0.5e6,), (3e-3,))
PRESETS["soft_sheet"] = prony("soft_sheet", 1000.0, 1e4, (1.5e4,), (0.3e-3,))
VARIANTS: dict[str, dict[str, object]] = {
    "": {},
    "shadows": {"skin.body_sound": "shadows"},
    "sheets": {
        "skin.material": None,
        "skin.materials": ("finger_pad", "palm", "forearm"),
        "skin.shares": (0.1, 0.3, 0.6),
    },
    "contrast": {
        "skin.material": None,
        "skin.materials": ("stiff_sheet", "soft_sheet"),
        "skin.shares": (0.05, 0.95),
    },
}
"""Keys of a skin by the suffix of a scene's name."""


class Trials:
    """Loads on one skin of a scene: pressure at the quadrature points at the ends of all substeps, (s + 1, q)."""

    def __init__(self, model: HapticModel) -> None:
        posed, skin = reference_scene(model), model.skins[0]
        self.points, self.normals = posed.skins[0].quadrature
        self._areas = skin.layer.quadrature.weights
        self.centre = posed.skins[0].body.frame.points(np.array(skin.spec.patch_centre))
        self.step_s = model.step_s
        self.times: Float = self.step_s * np.arange(round(LENGTH_S / self.step_s) + 1, dtype=np.float64)
        self._drive = array_drives(model, model.arrays)[0]
        self._arp = SurfaceArp(model.arrays.field, len(self.points), skin.spec.arp_law)
        self._one = self._amplitudes(self.centre + np.array([0.003, -0.002, 0.0]))
        self._spot = self._many(self._one[None])[0]

    def all(self) -> dict[str, tuple[float, Callable[[], Float]]]:
        """Return by name the corner of the load's spectrum [Hz], for the error estimate, and the load."""
        spot_m = 0.0105
        moving = 1.0 / (np.pi * spot_m)
        return {
            "4 m/s": (4.0 * moving, lambda: self._many(self._circle(4.0))),
            "11 m/s": (11.0 * moving, lambda: self._many(self._circle(11.0))),
            "1 kHz control": (500.0, self._held),
            "AM 200 Hz": (100.0, lambda: self._spot * np.sin(2 * np.pi * 100.0 * self.times[:, None]) ** 2),
            "on and off": (mode_estimate.LEAST_CORNER_Hz, self._on_and_off),
            "hand 0.5 m/s": (mode_estimate.LEAST_CORNER_Hz, self._moving_hand),
            "two foci": (mode_estimate.LEAST_CORNER_Hz, self._two),
            "finger's shadow": (mode_estimate.LEAST_CORNER_Hz, lambda: self._shadow(np.sqrt(self._areas))),
            "shadow by points": (mode_estimate.LEAST_CORNER_Hz, lambda: self._shadow(np.full(len(self._areas), 1e-9))),
        }

    def _amplitudes(self, focus: Float) -> Float:
        return self._drive.unit_drive(focus).amplitudes

    def _many(self, drives: Float) -> Float:
        return self._arp.evaluate_many(self.points, self.normals, drives).astype(np.float64)

    def _circle(self, speed: float, radius: float = 0.011) -> Float:
        turn = speed / radius * self.times
        ring = radius * np.column_stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)])
        return np.array([self._amplitudes(self.centre + OFF_GRID_m + offset) for offset in ring])

    def _held(self) -> Float:
        ticks = np.floor(self.times * 1000.0 + 1e-6) / 1000.0
        return self._many(self._circle(4.0)[np.rint(ticks / self.step_s).astype(int)])

    def _on_and_off(self) -> Float:
        return self._spot * ((self.times >= 0.001) & (self.times < 0.025))[:, None]

    def _moving_hand(self) -> Float:
        shift = np.array([-0.02, 0.0, 0.012]) / LENGTH_S
        rows = [self._arp.evaluate(self.points + shift * t, self.normals, self._one).arp.copy() for t in self.times]
        return np.array(rows, dtype=np.float64)

    def _two(self) -> Float:
        aside = np.array([0.5 * HALF_WAVELENGTH_m, 0.0, 0.0])
        pair = [self._amplitudes(self.centre + side * aside) for side in (-1.0, 1.0)]
        return np.repeat(self._many(0.5 * sum(pair)[None]), len(self.times), axis=0)

    def _shadow(self, widths_m: Float) -> Float:
        """widths_m: of the edge at each point, shape (q,)"""
        across = self.points[None, :, 0] - self.centre[0] - (-0.02 + 0.04 * self.times[:, None] / LENGTH_S)
        return self._spot * np.clip((np.abs(across) - 0.5 * FINGER_m) / widths_m + 0.5, 0.0, 1.0)


def march(stepper: SkinStepper, load: Float, surface: sparse.csr_matrix, outside: OutsideClass | None = None) -> Float:
    """Return the motion of the surface after each substep, shape (s, 2, m)."""
    state, reader, motion = np.zeros((1, stepper.state_size)), stepper.reader(surface), []
    pressure = load if stepper.points is None else load[:, stepper.points]
    for start in range(0, len(load) - 1, STEPS_A_CALL):
        stop = min(start + STEPS_A_CALL, len(load) - 1)
        unit = np.eye(stop - start + 1)[None]
        loads = SurfaceLoads(pressure[None, start : stop + 1], unit[:, :-1], unit[:, 1:])
        if outside is not None and isinstance(stepper, ModalStepper):
            outside.add(stepper.outside(loads))
        seen = stepper.step(state, loads, start * stepper.step_s, stop * stepper.step_s, reader)
        assert seen is not None
        motion.append(seen[0])
    return np.concatenate(motion)


def relative(motion: Float, truth: Float) -> tuple[float, float]:
    """Return the relative differences of displacement and velocity."""
    size = np.linalg.norm(truth, axis=(0, 2))
    return tuple(np.linalg.norm(motion - truth, axis=(0, 2)) / size)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", default=["palm_am200"], metavar="SCENE")
    parser.add_argument("--blocks", nargs="+", type=int, default=[12, 22, 32])
    parser.add_argument("--accuracy", type=float)
    parser.add_argument("--write", type=Path)
    parser.add_argument("--commit")
    arguments = parser.parse_args()
    lines, curves, known, smoother = [], {}, {}, {}
    for scene in arguments.scenes:
        name, _, variant = scene.partition(":")
        keys = VARIANTS[variant]
        sim = palmfield.Simulation(ROOT / "mjcf" / "scenes" / f"{name}.xml", accuracy=arguments.accuracy, keys=keys)
        # The loads and the layer of shadows are those without: what casts shadows is in the loads
        name = name if variant == "shadows" else scene
        model = sim.runtime.model
        layer, surface = model.skins[0].layer, model.skins[0].surface_vectors
        trials = Trials(model)
        if name not in known:
            made = {trial: make() for trial, (_, make) in trials.all().items()}
            known[name] = made, {trial: march(model.whole[0].value, load, surface) for trial, load in made.items()}
        loads, truths = known[name]
        for blocks in arguments.blocks:
            start = time.perf_counter()
            stepper = load_class.class_stepper(model, 0, blocks=blocks)
            seconds = time.perf_counter() - start
            count, shapes = stepper.order, len(stepper.body.shapes.sizes)
            megabytes = (stepper.body.modes.vectors.nbytes + stepper.body.shapes.shapes.nbytes) / 1e6
            head = f"| {scene} | {layer.system.ndof} | {shapes} / {len(stepper.points)} | {count} | {seconds:.0f} "
            head += f"| {megabytes:.0f} "
            for trial, (corner_Hz, _) in trials.all().items():
                outside = OutsideClass()
                outside.loudest = 0.0
                error = relative(march(stepper, loads[trial], surface, outside), truths[trial])
                stated = stepper.body.modes.errors(corner_Hz)
                total = np.hypot(stated, (outside.energy_share, SHORT_WAVES * outside.pressure_share))
                lines.append(
                    f"{head}| {trial} | {100 * error[0]:.2f} / {100 * error[1]:.1f} | {100 * stated[0]:.2f} / "
                    f"{100 * stated[1]:.1f} | {100 * outside.energy_share:.2f} / {100 * outside.pressure_share:.2f} "
                    f"| {100 * total[0]:.2f} / {100 * total[1]:.1f} |"
                )
                print(lines[-1], flush=True)
                curves.setdefault((scene, trial), []).append((count, *error))
            smooth = march(stepper, loads["shadow by points"], surface)
            smoother[scene] = relative(smooth, truths["finger's shadow"])[1]
    if arguments.write:
        command = " ".join([*arguments.scenes, "--blocks", *map(str, arguments.blocks)])
        jumps = {
            name: relative(truths["finger's shadow"], truths["shadow by points"]) for name, (_, truths) in known.items()
        }
        write(arguments.write, lines, curves, jumps, smoother, command, arguments.commit or git_commit())


def base_table(lines: list[str]) -> list[str]:
    """Return the table of the bases of all scenes."""
    return [
        "| scene | unknowns | shapes / points | modes | build time [s] | memory [MB] |",
        "|---|---|---|---|---|---|",
        *(f"| {' | '.join(row)} |" for row in dict.fromkeys(tuple(cells(line)[:6]) for line in lines)),
    ]


def error_table(lines: list[str]) -> list[str]:
    """Return error / estimate by load and scene, with the most modes of each scene."""
    rows = [cells(line) for line in lines]
    scenes = {row[0]: row[3] for row in rows}
    table = [f"| load | {' | '.join(f'{scene}, {modes}' for scene, modes in scenes.items())} |"]
    table.append("|---" * (1 + len(scenes)) + "|")
    for load in dict.fromkeys(row[6] for row in rows):
        found = {row[0]: (row[7].split(" / "), row[10].split(" / ")) for row in rows if row[6] == load}
        pairs = (f"{mine[0]} / {stated[0]}, {mine[1]} / {stated[1]}" for mine, stated in found.values())
        table.append(f"| {load} | {' | '.join(pairs)} |")
    return table


def write(page: Path, lines: list[str], curves: dict, jumps: dict, smoother: dict, command: str, commit: str) -> None:
    """Write the page with its picture.

    jumps: change of displacement and velocity of the full model by a shadow by points, by scene
    smoother: difference of the velocity of modes under it from that of the full model under the smooth shadow, by scene
    """
    picture = page.with_name("modes.png")
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.6), sharex=True, layout="constrained")
    first = next(iter(curves))[0]
    for (scene, name), points in curves.items():
        if scene != first:
            continue
        counts, *errors = np.array(points).T
        for axis, error in zip(axes, errors, strict=True):
            axis.semilogy(counts, 100 * error, "o-", label=name)
    for axis, what in zip(axes, ("displacement", "velocity"), strict=True):
        axis.set(xlabel="modes", ylabel=f"error of the {what} [%]")
        axis.grid(alpha=0.3)
    axes[1].legend(fontsize=7, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    figure.suptitle(f"{first}: modes for every load against the full model", fontsize=10)
    figure.savefig(picture, dpi=130)
    plt.close(figure)
    text = [
        "# Modes for every load of a class",
        "",
        "For developers. If the load of a skin cannot be predicted, palmfield uses modes for every sound of the arrays",
        "on a region (`palmfield/skin/reduction/modal_stepper.py`). This page has the errors of such modes under loads",
        "that were not used to make them. The reference is the full wedge model on the same mesh with the same step (a",
        "test of consistency; [skin](skin.md) has tests of accuracy).",
        "",
        f"Written by `python scripts/verification/check_modes.py {command} --write docs/bench/modes.md`, commit "
        f"{commit}, {processor()}, Python {platform.python_version()}.",
        "",
        "- `:sheets` has the sheets finger_pad, palm and forearm, with 0.1, 0.3 and 0.6 of the depth, and with three",
        "  relaxation laws.",
        "- `:contrast` has a sheet of 1 MPa (share 0.05) with low loss on a sheet of 10 kPa with high loss.",
        "- `:shadows` has modes that were made for shadows.",
        "",
        f"{keep_rows(page, base_table(lines), 'modes_bases')} has shapes, build times and memory. Each cell of the",
        "next table has four values in percent: error / estimate of the displacement, then error / estimate of the",
        "velocity. Errors are relative L2 errors over the surface and 50 ms, for the number of modes in the head of",
        f"the column. {keep_rows(page, [*ROWS, *lines])} has the parts of the estimate and fewer modes.",
        "",
        *error_table(lines),
        "",
        "*Finger's shadow*: the pressure acts on the lit share of the area of each point. *Shadow by points*: each",
        "point is lit or dark, as in a scene. When the edge of a shadow jumps, the mesh of the full model responds",
        "with clicks. The motion of the full model (displacement / velocity) differs between the two shadows by "
        + "; ".join(f"{100 * u:.1f} / {100 * v:.0f} % ({scene})" for scene, (u, v) in jumps.items())
        + ". Modes omit most clicks. The velocity of the modes under the shadow by points differs from the velocity of",
        "the full model under the smooth shadow by "
        + "; ".join(f"{100 * v:.0f} % ({scene})" for scene, v in smoother.items())
        + ".",
        "",
        "The estimate of the displacement covers all rows. The estimate of the velocity covers the smooth shadow, but",
        "usually not the shadow by points. If a larger part of a load than the target accuracy lies outside the class,",
        "`solver` `auto` changes to the full wedge model.",
        "",
        f"![Error against the number of modes]({picture.name})",
        "",
    ]
    page.write_text("\n".join(text))


if __name__ == "__main__":
    main()
