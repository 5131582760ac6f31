"""Continue a simulation with changed keys of its stimuli. Its skins must use modes that are valid for every load."""

from collections.abc import Mapping
from dataclasses import replace

from palmfield.session.simulation import Simulation
from palmfield.session.worlds import BOUND, with_texts
from palmfield.simulation.build import build, demands_of
from palmfield.simulation.model import HapticModel
from palmfield.simulation.state import WHOLE, at_rest, claim, stepper_of

LEAST_SPOT = 0.8
"""Smallest spot, relative to the spot for which a layer was meshed. A smaller spot needs finer elements."""


def change_stimuli(sim: Simulation, texts: Mapping[str, Mapping[str, str]]) -> bool:
    """Change keys of the stimuli of a running simulation if its skins allow it; return whether they do.

    texts: texts of all keys of some stimuli, by instance and key
    Time, poses and the motion of the skins do not change. The new keys apply from the next step.
    A change is not possible in these cases: a skin has a stepper for one load, or the full wedge model; a key names
    parts of the scene; the sound needs a finer mesh. The simulation is then unchanged. The MuJoCo model keeps the old
    texts. Raises SceneError or DeviceError for invalid values; the simulation is then unchanged.
    """
    runtime = sim.runtime
    old, state = runtime.model, runtime.state
    stimuli = []
    for stimulus in old.spec.stimuli:
        own = texts.get(stimulus.name)
        new = stimulus if own is None else with_texts(stimulus, own, stimulus.element)
        if any(getattr(new.config, key) != getattr(stimulus.config, key) for key in BOUND):
            return False
        stimuli.append(new)
    made = replace(old.spec, stimuli=tuple(stimuli))
    other = build(made, old)
    steppers = []
    for number, begun in enumerate(old.begin):
        if not (begun.made and begun.value.of_class) or state.skins[number][0, 0] == WHOLE:
            return False
        steppers.append(None if at_rest(state, number) else stepper_of(old, state, number)[0])
    if not _meshed_for(old, other):
        return False
    model = replace(old, spec=made, stimuli=other.stimuli, board=other.board, marks={})
    runtime.exchange(model)
    for number, stepper in enumerate(steppers):
        if stepper is not None:
            # The motion is still valid, because the modes are for any load; only the mark depends on the old keys
            claim(model, state, number, stepper, of_any_owner=True)
    return True


def _meshed_for(present: HapticModel, other: HapticModel) -> bool:
    """Return whether the layers of a model are fine enough for the sound of another model with the same bodies."""
    carriers = [other.bodies[skin.body] for skin in other.skins]
    demands = demands_of(other.spec, other.stimuli, other.arrays, other.board, carriers)
    return all(
        demand.max_frequency_Hz <= skin.layer.demand.max_frequency_Hz
        and demand.spot_fwhm_m >= LEAST_SPOT * skin.layer.demand.spot_fwhm_m
        for skin, demand in zip(present.skins, demands, strict=True)
    )
