"""Estimate the cost of a run: field points, boundary elements, error estimate; and when stored modes save time."""

import math
from typing import NamedTuple

from palmfield import cache
from palmfield.acoustics.air import sound_speed
from palmfield.estimate.cost import estimate_s
from palmfield.planning.facts import force_samples
from palmfield.planning.rows import Row
from palmfield.session.preview import Preview
from palmfield.simulation.model import HapticModel, SkinModel
from palmfield.simulation.posed_scene import reference_scene
from palmfield.simulation.small_models import mode_estimate
from palmfield.skin.costs import modal_start_s, modal_step_s, modes_s
from palmfield.skin.reduction.modal_stepper import MOST_SHARE
from palmfield.stimulus.schedule import frame_rates

PAIRS_PER_S = 5e8
"""Rate of field computation with gradient: pairs of transducer and point per second, on two cores of a server CPU.

Measured in docs/bench/.
"""
START_AND_PICTURES_S = 12.0
SCATTER_PAIR_S = 2e-8
SCATTER_ELEMENT_S = 1e-4
"""Time of a boundary-element solution per element [s]: 20 iterations and set-up (docs/bench/scattering.md)."""
MOST_RUNS = 1000
"""Largest number of runs after which modes must have saved time; otherwise they are not proposed."""


def run_s(view: Preview) -> float:
    """Return the expected wall time of `palmfield run` on two CPU cores [s], including the pictures."""
    model = view.runtime.model
    pairs = points_a_step(model) * len(model.arrays) * view.duration_s / model.spec.timestep_s
    seconds = START_AND_PICTURES_S + pairs / PAIRS_PER_S
    seconds += sum(estimate_s(skin) + skin.choice.seconds for skin in model.skins)
    return seconds + sum(scattering.solutions * scattering.solution_s for scattering in scatterings(view))


class Scattering(NamedTuple):
    """Cost of the boundary elements on the body of a skin.

    Whether the body can move, number of solutions in a run, and time of each solution [s].
    """

    body: str
    moves: bool
    solutions: int
    solution_s: float


def scatterings(view: Preview) -> list[Scattering]:
    """Return the cost of boundary elements, for each skin that uses them."""
    model = view.runtime.model
    asking = [i for i, skin in enumerate(model.skins) if skin.spec.config.body_sound == "scattering"]
    if not asking:
        return []
    from palmfield.acoustics.body_scattering import boundary_mesh

    result = []
    for number in asking:
        skin, moves = model.skins[number], _can_move(view, number)
        poses = round(view.duration_s / model.spec.timestep_s) + 1 if moves else 1
        # The other mesh of a disc in the error estimate needs its own solution.
        solutions = poses + (skin.spec.config.shape == "disc")
        body = reference_scene(model).bodies[skin.body]
        wavelength_m = sound_speed(model.arrays.air) / model.arrays.array.frequency_Hz
        elements = len(boundary_mesh(body.vertices, body.faces, wavelength_m)[1])
        seconds = SCATTER_PAIR_S * elements**2 + SCATTER_ELEMENT_S * elements
        result.append(Scattering(skin.spec.config.body, moves, solutions, seconds))
    return result


def _can_move(view: Preview, skin: int) -> bool:
    """Return whether body or arrays have degrees of freedom, are mocap bodies, or are part of such a body."""
    scene, binding = view.runtime.view.model, view.runtime.binding
    sites = [*binding.array_sites, *(site for own in binding.transducer_sites for site in own)]
    bodies = {binding.skins[skin].body, *(scene.site_body(site) for site in sites)}
    return any(scene.can_move(part) for body in bodies for part in scene.ancestors(body))


def points_a_step(model: HapticModel) -> float:
    """Return the number of field points in one MuJoCo step."""
    skin = sum(6 * len(part.layer.mesh.surface_triangles6) + part.layer.mesh.surface_nodes for part in model.skins)
    configs = [stimulus.config for stimulus in model.stimuli]
    moving = any(config.path != "point" and not frame_rates(config) for config in configs)
    return (model.substeps if moving else 1) * skin + force_samples(model)


class Preparing(NamedTuple):
    """Predicted costs of the modes of a skin on one core.

    modes_s: time to make the modes, once [s]
    saved_s: time that the modes save in each later run with another stimulus [s]
    without: what a run without modes uses, a reduced model or the full layer
    runs: number of runs from which the modes save time
    """

    modes_s: float
    saved_s: float
    without: str
    runs: int


def preparing(skin: SkinModel, duration_s: float) -> Preparing | None:
    """Return what the modes of a skin would save in runs of this length [s].

    Returns None if they would save nothing, or if the cache would not keep them.
    """
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
