"""The stepper of a skin: its whole layer, a small model for a predicted load, modes, or the one of key `solver`."""

from collections.abc import Sequence

from palmfield.drive.response import Pole
from palmfield.errors import SceneError
from palmfield.simulation.model import HapticModel, StepperChoice, StimulusModel
from palmfield.simulation.small_models import known_load, load_class
from palmfield.simulation.spec import SceneSpec, SkinSpec
from palmfield.skin.costs import RUNS, scene_choices, wedges_s
from palmfield.skin.explicit_layer import explicit_layer
from palmfield.skin.scene_layer import SceneLayer
from palmfield.skin.stepper import SkinStepper

MOST_SMALL_MODELS = 8
"""Most predicted loads for which a skin gets a small model each: each of a palm takes some 5 s and holds 14 MB."""


def choose_stepper(
    spec: SceneSpec,
    skin: SkinSpec,
    layer: SceneLayer,
    stimuli: tuple[StimulusModel, ...],
    pole: Pole,
    response_on: bool,
) -> StepperChoice:
    """Choose by key `solver`, by what can be reduced, and by predicted time.

    Raises SceneError where a small model or modes are requested but impossible.
    """
    substeps = spec.duration_s / layer.sizes.step_s
    explicit = explicit_layer(layer)
    if explicit is not None:
        explicit.refuse()
        own_s = explicit.seconds(spec.duration_s, spec.device)
        return StepperChoice(skin.config.solver, "set by key solver", own_s, wedges_s(layer.dofs, substeps))
    reason = known_load.refusal(skin, layer, stimuli, pole, response_on)
    requested = skin.config.solver
    modal_reason = load_class.refusal(skin, layer)
    missing = {"modal": ("modes for every load", modal_reason), "reduced": ("small model", reason)}
    what, why_not = missing.get(requested, ("", None))
    if why_not is not None:
        raise SceneError(
            f"{layer.element}: key 'solver' has value '{requested}', but there is no {what}: {why_not}: set it to auto"
        )
    sounding = [stimulus for stimulus in stimuli if not stimulus.silent]
    vectors = 0 if reason is not None else known_load.expected_vectors(sounding[0], pole, response_on)
    modes = load_class.expected_modes(skin, layer)
    size = (layer.dofs, substeps, vectors, reason, modes, modal_reason, load_class.laws(layer))
    choices = scene_choices(*size)
    seconds = {choice.name: choice.seconds for choice in choices}
    name: str = requested
    if requested != "auto":
        why = "set by key solver" if reason is None or requested != "wedges" else f"no reduced model: {reason}"
    elif reason is None:
        # If the load is predicted, a model for it alone is smaller than one for every load
        name = "reduced" if seconds["reduced"] < seconds["wedges"] else "wedges"
        small_s, whole_s = seconds["reduced"], seconds["wedges"]
        why = f"the load is predictable; reduced about {small_s:.1f} s, wedges about {whole_s:.1f} s"
    else:
        name, why = choices[0].name, f"no reduced model: {reason}"
        if name == "modal":
            why = f"{reason}, so the load is not predictable"
        if name == "modal" and scene_choices(*size, kept=False)[0].name != name:
            why += (
                f"; building the modes counts as 1/{RUNS}, because the cache stores them; without a cache wedges "
                "would be chosen"
            )
        elif name == "wedges" and scene_choices(*size, kept=True)[0].name != name:
            why += "; there is no cache, so modes are too expensive; with a cache modal would be chosen"
    return StepperChoice(name, why, seconds[name], seconds["wedges"])


def common_choice(
    spec: SceneSpec, skin: SkinSpec, layer: SceneLayer, choices: Sequence[StepperChoice], loads: int
) -> StepperChoice:
    """The stepper of a skin in all worlds.

    choices: what would step it in each that sounds, by itself; loads: how many of their loads are different
    """
    names = {choice.name for choice in choices}
    if len(names) == 1 and (names != {"reduced"} or loads <= MOST_SMALL_MODELS or skin.config.solver != "auto"):
        return choices[0]
    why = f"{loads} different loads; reduced models are limited to {MOST_SMALL_MODELS}"
    substeps = len(choices) * spec.duration_s / layer.sizes.step_s
    modes, refusal = load_class.expected_modes(skin, layer), load_class.refusal(skin, layer)
    ranked = scene_choices(layer.dofs, substeps, 0.0, why, modes, refusal, load_class.laws(layer))
    seconds = {choice.name: choice.seconds for choice in ranked}
    return StepperChoice(ranked[0].name, why, ranked[0].seconds, seconds["wedges"])


def first_stepper(model: HapticModel, skin: int) -> SkinStepper:
    """The stepper with which a skin begins: the one of key `solver`, a small model for the predicted load in the
    reference pose, or its whole layer.

    Raises SceneError for a small model that is requested but fails.
    """
    part = model.skins[skin]
    if part.explicit is not None:
        return part.explicit.stepper(model.spec.device)
    try:
        if part.choice.name == "reduced":
            return known_load.known_stepper(model, skin)
        if part.choice.name == "modal":
            return load_class.class_stepper(model, skin)
    except SceneError as error:
        if part.spec.config.solver != "auto":
            raise SceneError(f"{part.layer.element}: {error}") from None
    return model.whole[skin].value
