"""Give the numbers of a plan for other programs, with units in the names."""

from dataclasses import asdict
from typing import Any

from palmfield.estimate.sending import sending
from palmfield.planning.facts import first_drive
from palmfield.session.duration import step_count
from palmfield.session.preview import Preview
from palmfield.simulation.emission import array_drives
from palmfield.stimulus.modulation import arp_lines


def plan_numbers(view: Preview) -> dict[str, Any]:
    """Return numbers of the run, and of each stimulus and skin by name.

    duration_s, steps (of MuJoCo), timestep_s, skin_step_s, transducers, device, board
    sending: for a board that takes bytes, as in `palmfield.estimate.sending.Sending`
    stimuli: name, drive_level (of full, at the loudest moment) and pressure_Pa at the first focus, focus_m in the frame
        of the first array, modulation: None, or am_frequency_Hz (None for a file) and the ARP relative to that at the
        loudest moment, arp_mean and the peak amplitudes arp_first and arp_second of its lines at f and 2 f
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
