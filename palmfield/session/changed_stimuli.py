"""Continue a simulation with other keys of its stimuli, if modes for any load move its skins."""

from collections.abc import Mapping
from dataclasses import replace

from palmfield.session.simulation import Simulation
from palmfield.session.world_keys import BOUND, with_texts
from palmfield.simulation.build import build, demands_of
from palmfield.simulation.model import HapticModel
from palmfield.simulation.state import WHOLE, at_rest, claim, stepper_of

LEAST_SPOT = 0.8
"""Factor of the spot for which a layer is meshed: a smaller spot needs finer elements."""


def change_stimuli(sim: Simulation, texts: Mapping[str, Mapping[str, str]]) -> bool:
    """Change the keys of a running simulation's stimuli if its skins allow it; returns whether they do.

    texts: of all keys of some stimuli, by instance and key
    If so, time, poses and the skins' motion are unchanged, and the new keys hold from the next step on. Not allowed: a
    skin with a stepper for one load or for the whole layer, a key that names parts of the scene, and a sound that needs
    a finer mesh. Then the simulation is unchanged. MuJoCo's own model keeps the old texts. Raises SceneError or
    DeviceError for invalid values; the simulation is unchanged.
    """
    runtime = sim.runtime
    known, state = runtime.model, runtime.state
    stimuli = []
    for stimulus in known.spec.stimuli:
        own = texts.get(stimulus.name)
        new = stimulus if own is None else with_texts(stimulus, own, stimulus.element)
        if any(getattr(new.config, key) != getattr(stimulus.config, key) for key in BOUND):
            return False
        stimuli.append(new)
    made = replace(known.spec, stimuli=tuple(stimuli))
    other = build(made, known)
    steppers = []
    for number, begun in enumerate(known.begin):
        if not (begun.made and begun.value.of_class) or state.skins[number][0, 0] == WHOLE:
            return False
        steppers.append(None if at_rest(state, number) else stepper_of(known, state, number)[0])
    if not _meshed_for(known, other):
        return False
    model = replace(known, spec=made, stimuli=other.stimuli, response_on=other.response_on, board=other.board, marks={})
    runtime.exchange(model)
    for number, stepper in enumerate(steppers):
        if stepper is not None:
            # The motion is still valid: the modes serve any load, and only the mark depends on the old keys
            claim(model, state, number, stepper)
    return True


def _meshed_for(known: HapticModel, other: HapticModel) -> bool:
    """Whether the layers of a model are fine enough for the sound of another one on the same bodies."""
    carriers = [other.bodies[skin.body] for skin in other.skins]
    demands = demands_of(other.spec, other.stimuli, other.arrays, other.board, carriers)
    return all(
        demand.max_frequency_Hz <= skin.layer.demand.max_frequency_Hz
        and demand.spot_fwhm_m >= LEAST_SPOT * skin.layer.demand.spot_fwhm_m
        for skin, demand in zip(known.skins, demands, strict=True)
    )
