"""Choose the stepper of a skin: full layer, reduced model for a predicted load, modes, or the one of key `solver`."""

from collections.abc import Sequence

from palmfield.blas import one_blas_thread
from palmfield.errors import SceneError
from palmfield.phases import phase
from palmfield.simulation.model import HapticModel, StimulusModel
from palmfield.simulation.small_models import known_load, mode_estimate
from palmfield.simulation.spec import SceneSpec, SkinSpec
from palmfield.skin.costs import scene_choices, wedges_s
from palmfield.skin.explicit_layer import layer_solver
from palmfield.skin.scene_layer import SceneLayer
from palmfield.skin.stepper import SkinStepper
from palmfield.skin.stepper_choice import LayerWork, StepperChoice, chosen

BY_KEY = "set by key solver"
MOST_SMALL_MODELS = 8
"""Largest number of reduced models of a skin, one for each predicted load. One model of a palm takes 5 s and 14 MB."""


def choose_stepper(
    spec: SceneSpec, skin: SkinSpec, layer: SceneLayer, stimuli: tuple[StimulusModel, ...]
) -> StepperChoice:
    """Choose the stepper: by key `solver`, by the reductions that are possible, and by predicted time.

    Raises SceneError if a reduced model or modes are requested but impossible.
    """
    substeps, requested = spec.duration_s / layer.sizes.step_s, skin.config.solver
    with skin.naming("solver"):
        own = None if requested == "auto" else layer_solver(layer, requested)
        if own is not None:
            own.refuse()
    if own is not None and own.own_mesh:
        own_s = own.seconds(spec.duration_s, spec.device)
        return StepperChoice(requested, BY_KEY, own_s, wedges_s(layer.dofs, substeps))
    refusal = known_load.refusal(skin, layer, stimuli)
    sounding = [stimulus for stimulus in stimuli if not stimulus.silent]
    vectors = 0 if refusal is not None else known_load.expected_vectors(sounding[0])
    modes, modal_refusal = mode_estimate.expected_modes(skin, layer), mode_estimate.refusal(skin, layer)
    work = LayerWork(layer.dofs, substeps, vectors, refusal, modes, modal_refusal, mode_estimate.laws(layer))
    with skin.naming():
        return chosen(requested, work, BY_KEY)


def common_choice(
    spec: SceneSpec, skin: SkinSpec, layer: SceneLayer, choices: Sequence[StepperChoice], loads: int
) -> StepperChoice:
    """Choose one kind of stepper for a skin in all worlds.

    choices: for each world with sound, the choice if it were alone; loads: number of different loads of these worlds
    """
    few = choices[0].solver.any_pose or loads <= MOST_SMALL_MODELS or skin.config.solver != "auto"
    if few and len({choice.name for choice in choices}) == 1:
        return choices[0]
    why = f"{loads} different loads; reduced models are limited to {MOST_SMALL_MODELS}"
    substeps = len(choices) * spec.duration_s / layer.sizes.step_s
    modes, modal_refusal = mode_estimate.expected_modes(skin, layer), mode_estimate.refusal(skin, layer)
    first, *_ = scene_choices(layer.dofs, substeps, 0.0, why, modes, modal_refusal, mode_estimate.laws(layer))
    return StepperChoice(first.name, why, first.seconds, wedges_s(layer.dofs, substeps))


@phase("reduced model, modes or full wedge model")
def first_stepper(model: HapticModel, skin: int) -> SkinStepper:
    """Return the first stepper of a skin.

    It is that of key `solver`, or a reduced model for the predicted load in the reference pose, or the full layer.
    Raises SceneError for a reduced model that is requested but fails.
    """
    part = model.skins[skin]
    if (own := part.solver.stepper(model.spec.device)) is not None:
        return own
    with part.spec.naming(), one_blas_thread:
        try:
            if not part.choice.solver.any_pose:
                return known_load.known_stepper(model, skin)
            if part.choice.solver.of_class:
                from palmfield.simulation.small_models.load_class import class_stepper

                return class_stepper(model, skin)
        except SceneError:
            if part.spec.config.solver != "auto":
                raise
    return model.whole[skin].value
