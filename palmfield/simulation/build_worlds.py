"""Models of worlds with different stimuli. All share one set of arrays, bodies, layers and full-layer steppers.

The model of each world is a HapticModel, so the same code steps a scene and a world. Equal worlds share one model.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

from palmfield.locked import Lazy
from palmfield.simulation.build import (
    Responses,
    at_any_level,
    demands_of,
    layers_for,
    model_of,
    stimuli_of,
    whole_of,
)
from palmfield.simulation.model import HapticModel, SkinModel, StimulusModel
from palmfield.simulation.small_models.choice import choose_stepper, common_choice, first_stepper
from palmfield.simulation.spec import SceneSpec
from palmfield.skin.scene_layer import LayerDemand, SceneLayer
from palmfield.skin.stepper import SkinStepper


@dataclass(frozen=True)
class Shared:
    """Data that a world shares with worlds outside its group.

    Results then do not depend on the other worlds of the group.

    demands: requirements on the layer of each skin; None for the requirements of this scene alone
    modal: whether skins with predicted loads also use general modes, if key `solver` is auto
    """

    demands: tuple[LayerDemand, ...] | None = None
    modal: bool = False


def build_worlds(
    specs: Sequence[SceneSpec], scene: SceneSpec | None = None, shared: Shared | None = None
) -> tuple[HapticModel, ...]:
    """Build the model of each world. The specs differ only in the keys of their stimuli.

    scene: spec of MuJoCo's model, which differs only in such keys; by default the first of the specs
    shared: data shared with other worlds; without it, the requirements of these worlds are used
    The layers are made for the strictest requirements of the worlds with sound. With equal requirements, each world has
    the same layer as in a simulation of its own. A skin gets reduced models if every world with sound would have a
    reduced model and there are at most MOST_SMALL_MODELS different ones. Loads that differ only in level share a model.
    Otherwise one stepper is used for all worlds: modes or the full layer. Raises SceneError or DeviceError as
    `palmfield.simulation.build.build`.
    """
    first = model_of(scene or specs[0])
    carriers = [first.bodies[skin.body] for skin in first.skins]
    stimuli = {first.spec: first.stimuli} if scene is None else {}
    responses: Responses = {}
    for spec in specs:
        if spec not in stimuli:
            stimuli[spec] = stimuli_of(spec, first.arrays, first.board, carriers, responses)
    loads = {spec: load_key(made, first.board.exact) for spec, made in stimuli.items()}
    sounding = {spec: parts for spec, parts in stimuli.items() if loads[spec] is not None}
    own = [skin.layer.demand for skin in first.skins]
    if shared is None:
        demands: dict[object, list[LayerDemand]] = {}
        for spec, made in (sounding or stimuli).items():
            if loads[spec] not in demands:
                demands[loads[spec]] = demands_of(spec, made, first.arrays, first.board, carriers)
        demanded = [strictest(of_skin) for of_skin in zip(*demands.values(), strict=True)]
        same = demanded == demands.get(loads[specs[0]])
    else:
        demanded = own if shared.demands is None else list(shared.demands)
        same = demanded == own
    layers = [skin.layer for skin in first.skins] if same else layers_for(first.spec, first.stimuli, demanded, carriers)
    skins = _skins(first, layers, sounding, len(set(loads.values()) - {None}), shared is not None and shared.modal)
    whole = first.whole if same else tuple(whole_of(layer) for layer in layers)
    begins: dict[tuple[int, object], Lazy[SkinStepper]] = {}
    for number, skin in enumerate(skins):
        if scene is not None and skin is first.skins[number]:
            # Worlds with the same sound as MuJoCo's model reuse its data
            own_load = load_key(first.stimuli, first.board.exact) if not skin.choice.solver.any_pose else None
            begins[number, own_load] = first.begin[number]
    models: dict[SceneSpec, HapticModel] = {}
    # Worlds with sound come first: a silent world can use any of their steppers
    fallback = next((load for load in loads.values() if load is not None), None)
    for spec in sorted(stimuli, key=lambda spec: loads[spec] is None):
        model = replace(first, spec=spec, stimuli=stimuli[spec], skins=skins, whole=whole)
        begin = []
        for number, skin in enumerate(skins):
            # A reduced model is made for its load; any other stepper of a skin can take all loads
            key = number, None if skin.choice.solver.any_pose else loads[spec] or fallback
            if key not in begins:
                begins[key] = Lazy(partial(first_stepper, model, number))
            begin.append(begins[key])
        models[spec] = replace(model, begin=tuple(begin), marks={})
    return tuple(models[spec] for spec in specs)


def _skins(
    first: HapticModel,
    layers: Sequence[SceneLayer],
    sounding: Mapping[SceneSpec, tuple[StimulusModel, ...]],
    loads: int,
    modal: bool,
) -> tuple[SkinModel, ...]:
    """Return the skins that all worlds share.

    sounding: stimuli of the worlds with sound
    loads: number of different loads
    modal: see Shared
    """
    skins = []
    for skin, layer in zip(first.skins, layers, strict=True):
        if modal and skin.spec.config.solver == "auto":
            choice = skin.choice._replace(name="modal", why="there are many different loads")
            settles = not skin.choice.solver.any_pose
        else:
            choices = [choose_stepper(spec, skin.spec, layer, made) for spec, made in sounding.items()]
            choice = common_choice(first.spec, skin.spec, layer, choices, loads) if choices else skin.choice
            # As for each world simulated alone with a predicted load: in a still pose its field is stored
            settles = not (choice.solver.factorises or any(own.solver.any_pose for own in choices))
        if layer is skin.layer and choice == skin.choice:
            skins.append(skin)
        else:
            skins.append(SkinModel(skin.spec, skin.body, skin.carrier, layer, choice, settles))
    return tuple(skins)


def strictest(demands: Sequence[LayerDemand]) -> LayerDemand:
    """Return one requirement that covers several requirements on a layer. The first frequency sets the absorbing sides.

    Elements are fine around the focus of the first requirement, and as far as the foci of the others.
    """
    near, far = zip(*(demand.path_reach_m for demand in demands), strict=True)
    near = tuple(
        reach + math.dist(demand.offset_m, demands[0].offset_m) for reach, demand in zip(near, demands, strict=True)
    )
    return replace(
        demands[0],
        spot_fwhm_m=min(demand.spot_fwhm_m for demand in demands),
        max_frequency_Hz=max(demand.max_frequency_Hz for demand in demands),
        path_reach_m=(max(near), max(far)),
        corner_Hz=max(demand.corner_Hz for demand in demands),
    )


def load_key(stimuli: Sequence[StimulusModel], exact: bool) -> tuple[object, ...] | None:
    """Return a key that is equal for stimuli whose loads differ only in level; None for silence.

    exact: whether the board plays every level unchanged; if not, the shape of the field may depend on the level
    """
    if all(stimulus.silent for stimulus in stimuli):
        return None
    parts = []
    for stimulus in stimuli:
        parts.append((at_any_level(stimulus.config) if exact else stimulus.config, stimulus.silent))
    return tuple(parts)
