"""Estimate the cost of a run: field points, boundary elements, error estimate."""

from typing import NamedTuple

from palmfield.acoustics.air import sound_speed
from palmfield.estimate.cost import estimate_s
from palmfield.planning.facts import force_samples
from palmfield.session.preview import Preview
from palmfield.simulation.model import HapticModel
from palmfield.simulation.posed_scene import reference_scene
from palmfield.stimulus.schedule import frame_rates

PAIRS_PER_S = 5e8
"""Pairs of transducer and point per second, with gradient, measured on two cores of a server CPU (docs/bench/)."""
START_AND_PICTURES_S = 12.0
SCATTER_PAIR_S = 2e-8
SCATTER_ELEMENT_S = 1e-4
"""Time of a boundary-element solution per element [s]: 20 iterations and set-up (docs/bench/scattering.md)."""


def run_s(view: Preview) -> float:
    """Return the expected wall time of `palmfield run` on two CPU cores [s], pictures included."""
    model = view.runtime.model
    pairs = points_a_step(model) * len(model.arrays) * view.duration_s / model.spec.timestep_s
    seconds = START_AND_PICTURES_S + pairs / PAIRS_PER_S
    seconds += sum(estimate_s(skin) + skin.choice.seconds for skin in model.skins)
    return seconds + sum(scattering.solutions * scattering.solution_s for scattering in scatterings(view))


class Scattering(NamedTuple):
    """Boundary elements on the body of a skin: whether it can move, number of solutions in a run, time of each [s]."""

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
