"""Find keys of a skin that make it coarser than the target accuracy needs."""

from palmfield.estimate.array_inputs import stimulus_of
from palmfield.simulation.model import HapticModel
from palmfield.skin.from_config import sheets_of
from palmfield.skin.scene_layer import layer_sizes
from palmfield.stimulus.schedule import main_frequencies

SLACK = 1.05
"""Largest accepted ratio of a size that a key sets to the size that palmfield would choose."""


def coarse_pins(model: HapticModel, number: int) -> list[str]:
    """Describe keys element_m, step_s and max_frequency_Hz of a skin that are coarser than its accuracy needs.

    Elements and steps of explicit solvers follow other rules and are not checked.
    """
    skin, stimulus = model.skins[number], model.stimuli[stimulus_of(model, number)]
    config, demand, result = skin.spec.config, skin.layer.demand, []
    highest_Hz = max(main_frequencies(stimulus.config), default=0.0)
    if config.max_frequency_Hz is not None and config.max_frequency_Hz < highest_Hz:
        result.append(f"max_frequency_Hz {config.max_frequency_Hz:g} (stimulus: {highest_Hz:g} Hz)")
    if skin.solver.own_mesh:
        return result
    free, sheets = config.model_copy(update={"element_m": None, "step_s": None}), sheets_of(config)
    chosen = layer_sizes(
        free, sheets, demand.spot_fwhm_m, demand.max_frequency_Hz, demand.path_reach_m, demand.timestep_s
    )
    if config.element_m is not None and config.element_m > SLACK * chosen.edge_fine_m:
        result.append(f"element_m {1e3 * config.element_m:.3g} mm (needed: {1e3 * chosen.edge_fine_m:.3g} mm)")
    if config.step_s is not None and config.step_s > SLACK * chosen.step_s:
        result.append(f"step_s {1e3 * config.step_s:.3g} ms (needed: {1e3 * chosen.step_s:.3g} ms)")
    return result
