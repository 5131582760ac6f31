"""Say when modes that `palmfield prepare` makes once would save time over a model for each stimulus."""

import math
from typing import NamedTuple

from palmfield import cache
from palmfield.estimate.cost import estimate_s
from palmfield.planning.rows import Row
from palmfield.simulation.model import HapticModel, SkinModel
from palmfield.simulation.small_models import mode_estimate
from palmfield.skin.costs import modal_start_s, modal_step_s, modes_s
from palmfield.skin.reduction.modal_stepper import MOST_SHARE

MOST_RUNS = 1000
"""If modes save time from more runs than this, they are not proposed."""


class Preparing(NamedTuple):
    """Predicted costs of the modes of a skin on one core.

    modes_s: time to make them, once [s]; saved_s: time that they save in each later run with another stimulus [s]
    without: replacement in a run without them, a reduced model or the full layer; runs: number of runs from which they
    save time
    """

    modes_s: float
    saved_s: float
    without: str
    runs: int


def preparing(skin: SkinModel, duration_s: float) -> Preparing | None:
    """Return what modes of a skin would save in runs of this length [s]; None if they save nothing or are not kept."""
    layer, modes = skin.layer, mode_estimate.expected_modes(skin.spec, skin.layer)
    if cache.folder() is None or skin.solver.own_mesh or mode_estimate.refusal(skin.spec, layer) is not None:
        return None
    if modes > MOST_SHARE * layer.dofs:
        return None
    laws = mode_estimate.laws(layer)
    reduced = not skin.solver.any_pose
    without_s = skin.choice.seconds if reduced else skin.choice.wedges_s
    with_s = modal_start_s(layer.dofs, modes) + duration_s / layer.sizes.step_s * modal_step_s(modes, laws)
    # A reduced model also serves the error estimate, modes do not
    modal = SkinModel(skin.spec, skin.body, skin.carrier, layer, skin.choice._replace(name="modal"))
    saved_s = without_s + estimate_s(skin) - with_s - estimate_s(modal)
    made_s = modes_s(layer.dofs, modes, laws)
    if made_s > MOST_RUNS * saved_s:
        return None
    return Preparing(made_s, saved_s, "reduced model" if reduced else "full layer", math.ceil(made_s / saved_s))


def preparing_rows(model: HapticModel) -> list[Row]:
    """Return a row for each skin whose modes would save time."""
    rows = []
    for skin in model.skins:
        costs = preparing(skin, model.spec.duration_s)
        if costs is None:
            continue
        when = "1 run" if costs.runs == 1 else f"{costs.runs} runs"
        size = f"pays from {when}: modes {costs.modes_s:.2g} s once, then {costs.saved_s:.2g} s less for each run"
        which = "" if skin.solver.of_class else f" --set {skin.spec.name}.solver=modal, also in these runs,"
        why = (
            f"palmfield prepare{which} makes modes for all foci of the region, frequencies of the band and levels; "
            f"without them each run for another focus makes its own {costs.without}"
        )
        rows.append(Row("preparing", size, why, skin.spec.name))
    return rows
