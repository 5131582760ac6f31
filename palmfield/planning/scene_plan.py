"""Report, before a run, which effects of a scene are modelled, which are ignored and why, and the cost."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from palmfield import terminal
from palmfield.estimate.bias import QUANTITY
from palmfield.estimate.sending import sending
from palmfield.planning.advice import advice
from palmfield.planning.costs import preparing_rows, run_s
from palmfield.planning.expected_error import expected_errors
from palmfield.planning.facts import first_drive
from palmfield.planning.modelled import effects_on_skin, modelled, other_effects
from palmfield.planning.rows import Row, merged
from palmfield.session.duration import check_duration, step_count
from palmfield.session.open_scene import Source
from palmfield.session.preview import Preview, preview
from palmfield.session.simulation import Simulation
from palmfield.simulation.emission import array_drives
from palmfield.stimulus.modulation import arp_lines

__all__ = ["Plan", "Row", "plan", "warnings"]
WIDTH = 130
"""Width of the tables in columns, unless the terminal is narrower."""
NOT_ESTIMATED = "not estimated"
"""Text for an ignored effect whose bias is unknown, see `palmfield.estimate.bias.Bias`."""
SHORT = ("sound field", "modulation", "sending", "skin layer", "elements", "error estimate", "preparing")
"""Names of the modelled effects in the short table, which also has the solver of each skin."""


def as_text(scene: str, parts: Mapping[str, Sequence[Row]], warnings: Sequence[str], seconds: float) -> str:
    """Return a text with the expected wall time [s], a titled table for each part, and the warnings."""
    every = [row for rows in parts.values() for row in rows]
    # If there is one of each kind, names are not needed
    named = any("," in row.instance for row in every) or (
        len({(row.what, row.instance) for row in every}) > len({row.what for row in every})
    )
    heads = ("what", "of", "size", "why") if named else ("what", "size", "why")
    tables = []
    for title, rows in parts.items():
        cells = ((row.what, *([row.instance] if named else []), row.size, row.why) for row in rows)
        tables.append(terminal.table(cells, heads, title=title, title_justify="left"))
    begin = f"Plan for {scene}. Expected time on two CPU cores: {seconds:.0f} s"
    return terminal.printed(begin, *tables, *(f"Warning: {warning}" for warning in warnings), most=WIDTH)


@dataclass(frozen=True)
class Plan:
    """Decisions for a scene.

    left_out: effects that are not modelled, with their bias on the skin displacement under the focus
    besides: other effects that are not modelled, whose bias is not estimated
    error: expected error of the skin displacement under the focus
    seconds: expected wall time of `palmfield run` on two CPU cores [s], pictures included
    """

    scene: str
    modelled: tuple[Row, ...]
    left_out: tuple[Row, ...]
    besides: tuple[Row, ...]
    error: tuple[Row, ...]
    seconds: float
    warnings: tuple[str, ...]
    numbers: Mapping[str, Any]

    def as_dict(self) -> dict[str, Any]:
        """Return the plan for JSON, with units in the names. Rows are texts; for `numbers` see `planning.numbers`."""
        rows = {"modelled": self.modelled, "left_out": self.left_out, "besides": self.besides}
        rows["expected_error"] = self.error
        return {
            "scene": self.scene,
            **{name: [asdict(row) for row in part] for name, part in rows.items()},
            "expected_wall_time_s": self.seconds,
            "warnings": list(self.warnings),
            **self.numbers,
        }

    def short(self) -> str:
        """Return the main decisions as a table without reasons (about 20 lines for one skin), and the warnings."""
        shown = [row for row in self.modelled if row.what in SHORT or row.what.startswith("skin solver")]
        rows = [(name, row.size) for name, row in zip(_names(shown), shown, strict=True)]
        left = [row for row in self.left_out if row.size != NOT_ESTIMATED]
        missing = [row.what for row in (*self.left_out, *self.besides) if row.size == NOT_ESTIMATED]
        rows.append(("not modelled, bias", _in_line(left) or "none"))
        if missing:
            rows.append((f"bias {NOT_ESTIMATED}", ", ".join(dict.fromkeys(missing))))
        rows.append(("expected error", _in_line(self.error)))
        begin = f"Plan for {self.scene}. Expected time on two CPU cores: {self.seconds:.0f} s. Reasons: --details"
        grid = terminal.table(rows)
        return terminal.printed(begin, grid, *(f"Warning: {warning}" for warning in self.warnings), most=WIDTH)

    def __str__(self) -> str:
        return as_text(
            self.scene,
            {
                "Modelled": self.modelled,
                f"Effects not modelled: bias (true minus computed) of the {QUANTITY}": self.left_out,
                "Other effects not modelled": self.besides,
                f"Expected error of the {QUANTITY}": self.error,
            },
            self.warnings,
            self.seconds,
        )


def _names(rows: Sequence[Row]) -> list[str]:
    """Return the names of rows. Where several rows have the same name, their instances are added."""
    names = [row.what for row in rows]
    return [row.what if names.count(row.what) == 1 else f"{row.what}, {row.instance}" for row in rows]


def _in_line(rows: Sequence[Row]) -> str:
    return "; ".join(f"{name} {row.size}" for name, row in zip(_names(rows), rows, strict=True))


def plan(
    scene: Source | Simulation,
    *,
    device: str | None = None,
    accuracy: float | None = None,
    board: str | None = None,
    keys: Mapping[str, object] | None = None,
    duration_s: float | None = None,
) -> Plan:
    """Decide which effects to model, from the stimuli, surfaces and accuracy of a scene, without simulation.

    scene: a path, an MjSpec, a compiled model or a Simulation
    duration_s: duration of the run [s]; the default is that of the scene
    Other arguments: see `palmfield.load`
    Raises SceneError like `palmfield.load`, if a skin layer cannot be built, and for a duration that is not > 0.
    """
    if duration_s is not None:
        check_duration(duration_s)
    view = preview(scene, device=device, accuracy=accuracy, board=board, keys=keys)
    if duration_s is not None:
        view = replace(view, duration_s=duration_s)
    model = view.runtime.model
    return Plan(
        view.name,
        merged([*modelled(model, view.duration_s, view.runtime.feedback), *preparing_rows(model)]),
        merged(effects_on_skin(model)),
        merged(other_effects(model)),
        merged(expected_errors(model)),
        run_s(view),
        tuple(advice(view)),
        plan_numbers(view),
    )


def warnings(scene: Source | Simulation, duration_s: float | None = None) -> list[str]:
    """Return the warnings before a run, in words.

    duration_s: duration of the run [s]; the default is that of the scene
    """
    view = preview(scene)
    return advice(view if duration_s is None else replace(view, duration_s=duration_s))


def plan_numbers(view: Preview) -> dict[str, Any]:
    """Return numbers of the run, and of each stimulus and skin by name.

    duration_s, steps (of MuJoCo), timestep_s, skin_step_s, transducers, device, board
    sending: for a board that takes bytes, as in `palmfield.estimate.sending.Sending`
    stimuli: name, drive_level (relative to full drive, at the loudest moment), pressure_Pa at the first focus, focus_m
        in the frame of the first array, modulation. The modulation is None, or has am_frequency_Hz (None for a file)
        and three numbers relative to the ARP at the loudest moment: arp_mean, and the peak amplitudes arp_first and
        arp_second of the lines at f and 2 f
    skins: name, solver, expected_solver_s, unknowns, edge_fine_m, edge_coarse_m, radius_m, depth_min_m, depth_max_m,
        spot_fwhm_m, max_frequency_Hz, accuracy_wanted_relative
    """
    model = view.runtime.model
    drives = array_drives(model, model.arrays)
    stimuli = []
    for number, stimulus in enumerate(model.stimuli):
        focus = stimulus.first_focus
        pressure = model.arrays.pressure64(focus[None], first_drive(model, number))
        lines = arp_lines(stimulus.config)
        modulation = None if lines is None else {"am_frequency_Hz": stimulus.config.am_frequency_Hz}
        if lines is not None and modulation is not None:
            modulation |= {"arp_mean": lines.mean, "arp_first": lines.first, "arp_second": lines.second}
        stimuli.append(
            {
                "name": stimulus.spec.name,
                "drive_level": float(drives[number].unit_drive(focus).level),
                "focus_m": focus.tolist(),
                "pressure_Pa": float(abs(pressure[0])),
                "modulation": modulation,
            }
        )
    skins = []
    for skin in model.skins:
        layer = skin.layer
        sizes, depth = layer.sizes, layer.patch.depth
        skins.append(
            {
                "name": skin.spec.name,
                "solver": skin.choice.name,
                "expected_solver_s": float(skin.choice.seconds),
                "unknowns": int(skin.solver.unknowns),
                "edge_fine_m": float(sizes.edge_fine_m),
                "edge_coarse_m": float(sizes.edge_coarse_m),
                "radius_m": float(sizes.radius_m),
                "depth_min_m": float(depth.min()),
                "depth_max_m": float(depth.max()),
                "spot_fwhm_m": float(layer.demand.spot_fwhm_m),
                "max_frequency_Hz": float(layer.demand.max_frequency_Hz),
                "accuracy_wanted_relative": skin.spec.config.accuracy,
            }
        )
    return {
        "duration_s": view.duration_s,
        "steps": step_count(view.duration_s, model.spec.timestep_s),
        "timestep_s": model.spec.timestep_s,
        "skin_step_s": float(model.step_s),
        "transducers": len(model.arrays),
        "device": model.spec.device,
        "board": model.board.name,
        "sending": None if model.board.exact else asdict(sending(model.board, model.configs)),
        "stimuli": stimuli,
        "skins": skins,
    }
