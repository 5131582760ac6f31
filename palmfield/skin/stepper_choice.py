"""Choose the stepper of a skin in a scene by key `solver`, possible reductions and predicted time."""

from typing import NamedTuple

from palmfield.errors import SceneError
from palmfield.skin.costs import RUNS, scene_choices
from palmfield.skin.explicit_layer import LayerSolver, solver_class


class StepperChoice(NamedTuple):
    """The stepper with which a skin begins.

    name: name of the solver; why: reason in words
    seconds, wedges_s: predicted time to make and step it, and to factorise and step the whole layer [s]
    """

    name: str
    why: str
    seconds: float
    wedges_s: float

    @property
    def solver(self) -> type[LayerSolver]:
        """Return the class of the solver, available before the stepper is made."""
        return solver_class(self.name)


class LayerWork(NamedTuple):
    """Amount of work to step the layer of a scene on its wedges; see `palmfield.skin.costs.scene_choices`."""

    dofs: float
    substeps: float
    vectors: float
    refusal: str | None
    modes: float
    modal_refusal: str | None
    laws: int = 1


def chosen(requested: str, work: LayerWork, reason: str) -> StepperChoice:
    """Return the stepper on the wedges of a scene.

    requested: value of key `solver`; reason: reason in words if the key names a solver
    Raises SceneError if a reduced model or modes are requested but impossible.
    """
    missing = {"modal": ("modes for every load", work.modal_refusal), "reduced": ("reduced model", work.refusal)}
    what, why_not = missing.get(requested, ("", None))
    if why_not is not None:
        raise SceneError(f"there is no {what}: {why_not}: set it to auto", setting="solver")
    choices = scene_choices(*work)
    seconds = {choice.name: choice.seconds for choice in choices}
    if requested != "auto":
        name, why = requested, reason
    elif work.refusal is None:
        # The reduced model of a predicted load is smaller than general modes
        small_s, whole_s = seconds["reduced"], seconds["wedges"]
        name = "reduced" if small_s < whole_s else "wedges"
        why = f"the load is predictable; reduced about {small_s:.1f} s, wedges about {whole_s:.1f} s"
    else:
        name, why = choices[0].name, f"no reduced model: {work.refusal}"
        if name == "modal":
            why = f"{work.refusal}, so the load is not predictable"
        if name == "modal" and scene_choices(*work, cached=False)[0].name != name:
            why += (
                f"; building the modes counts as 1/{RUNS}, because the cache stores them; without a cache wedges "
                "would be chosen"
            )
        elif name == "wedges" and scene_choices(*work, cached=True)[0].name != name:
            why += "; there is no cache, so modes are too expensive; with a cache modal would be chosen"
    return StepperChoice(name, why, seconds[name], seconds["wedges"])
