"""A layer on the palmar side of a hand: response, decay, error of its mesh, and what is refused.

A patch cut out of the same skin, with a rim that transmits waves, is the comparison: its outline, triangles, base and
sides are others, and it does not contain the fingers.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import trimesh
from pydantic import ValidationError

from palmfield.config.skin import SkinConfig
from palmfield.errors import SceneError, naming
from palmfield.estimate.numerics.mesh_error import meshes_to_compare
from palmfield.hand.preset import load_preset
from palmfield.hand.surface import hand_surface
from palmfield.skin.fem.generalised_alpha import branch_weights
from palmfield.skin.fem.solver import harmonic, static
from palmfield.skin.scene_layer import LayerDemand, SceneLayer
from palmfield.types import Surface

HAND = {"shape": "hand", "patch_site": "palm_centre", "accuracy": 0.1}
DEMAND = LayerDemand(0.0103, 200.0, 200.0, (0.02, 0.0), 1e-3)
SPOT = 0.0103


@cache
def layer(at=(0.0, 0.0, 0.0), of=(0.0, 0.0, 0.0), **keys):
    """Return a layer about `at`, with fine elements about `of` [m]."""
    hand, demand = hand_surface(load_preset("open_men_p50")), replace(DEMAND, offset_m=of)
    return SceneLayer(SkinConfig(**HAND, **keys), hand.surface, hand.depth_to_bone, np.array(at), demand)


@cache
def responses(of, place=(0.0, 0.0, 0.0)):
    """Return the static and the 200 Hz displacement under a spot of 1 Pa on the skin at a place [m]."""
    skin = of.patch.vertices
    near = skin[np.linalg.norm(skin - place, axis=1).argmin()]
    distance = np.linalg.norm(of.quadrature.points - near, axis=1)
    force = of.quadrature.assemble(np.exp(-4.0 * np.log(2.0) * (distance / SPOT) ** 2))
    read = of.probe(near).operator
    return np.array([(read @ static(of.system, force))[0], (read @ harmonic(of.system, force, 200.0))[0]])


def far_off(one, other, place=(0.0, 0.0, 0.0)):
    return np.abs(responses(one, place) - responses(other, place)) / np.abs(responses(other, place))


def test_the_centre_moves_like_that_of_a_patch():
    patch = layer(patch_radius_m=0.037, side="absorbing", element_m=0.0035)
    for side in ("fixed", "absorbing"):
        assert (far_off(layer(cover="palmar", element_m=0.005, side=side), patch) < [0.02, 0.05]).all()


def test_a_pulp_moves_like_that_of_a_patch():
    hand = hand_surface(load_preset("open_men_p50"))
    skin = hand.surface.vertices
    pad = tuple(skin[np.linalg.norm(skin - hand.landmarks["index_pad"], axis=1).argmin()].tolist())
    keys = {"side": "absorbing", "element_m": 0.003}
    assert (
        far_off(layer(cover="palmar", of=pad, **keys), layer(at=pad, patch_radius_m=0.02, **keys), pad) < 0.02
    ).all()


def test_a_free_motion_never_gains_energy(nodal_stepper):
    """rho_inf = 1: a theorem at any step; see test_foundation for the stored energy of the branch."""
    of = layer(cover="palmar")
    system, (weight, tau) = of.system, of.sheets[0].material.relaxation.branches[0]
    solver = nodal_stepper(system, of.step_s, rho_inf=1.0)
    state, rest = solver.new_state(), np.zeros(system.ndof)
    state[1] = np.random.default_rng(3).normal(size=system.ndof)
    e, _, b = branch_weights(of.step_s, tau)
    weight *= (1.0 + e) / (2.0 * (1.0 - b))
    stiffness, levels = system.parts[0].stiffness, []
    for _ in range(60):
        u, v, _, q = state
        stored = u @ (system.elastic @ u) + u @ (stiffness @ u) + weight * ((u - q) @ (stiffness @ (u - q)))
        levels.append(0.5 * (v @ (system.mass @ v) + stored))
        solver.step(state, rest, rest)
    assert np.all(np.diff(levels) <= 1e-12 * levels[0])
    assert levels[-1] < 0.7 * levels[0]


def test_its_error_is_estimated_by_another_mesh():
    of = layer(cover="palmar")
    other, ratio, _, rows = meshes_to_compare(of, finer=False)
    assert ratio > 1.1 and rows is not None
    assert other.patch.report["area_m2"] == pytest.approx(of.patch.report["area_m2"], rel=0.05)
    finest = layer(cover="palmar", element_m=0.004)
    assert np.abs(far_off(of, finest)).max() < 0.13 and np.abs(far_off(other, finest)).max() > far_off(of, finest).max()


def test_elements_are_fine_where_the_foci_are():
    of = layer(cover="palmar", element_m=0.004)
    corners = of.patch.vertices[of.patch.faces]
    edge = np.linalg.norm(corners[:, 0] - corners[:, 1], axis=1)
    away = np.linalg.norm(corners.mean(axis=1), axis=1)
    assert np.median(edge[away < 0.02]) < 0.0045 and np.median(edge[away > 0.08]) > 0.006
    assert of.dofs / of.expected_dofs == pytest.approx(1.0, abs=0.35)


@pytest.mark.parametrize(
    "keys, words",
    [
        (
            {"shape": "cylinder", "cylinder_radius_m": 0.03, "cylinder_length_m": 0.1},
            "cover applies to shape 'hand' or",
        ),
        ({"cover": "all"}, "cover"),
    ],
)
def test_keys_that_contradict_a_cover(keys, words):
    with pytest.raises(ValidationError, match=words):
        SkinConfig(**(HAND | {"cover": "palmar"} | keys))


def test_a_radius_contradicts_a_cover():
    with pytest.raises(SceneError, match=r"patch_radius_m 0\.03 is the radius of a patch, but cover is 'palmar'"):
        _ = layer(cover="palmar", patch_radius_m=0.03).patch


def test_the_skin_of_a_whole_preset_is_refused_with_its_unknowns():
    with pytest.raises(SceneError, match=r"about 1\.5e\+05 unknowns; allowed: at most 1e\+05.*set cover to palmar"):
        _ = layer(cover="whole").sizes


def test_a_centre_on_the_back_is_refused():
    hand = hand_surface(load_preset("open_men_p50"))
    back = hand.surface.vertices[np.linalg.norm(hand.surface.vertices - [0.0, 0.0, 0.03], axis=1).argmin()]
    config = SkinConfig(**HAND, cover="palmar")
    wrong = SceneLayer(config, hand.surface, hand.depth_to_bone, back, DEMAND, named=naming("skin 'palm'"))
    with pytest.raises(SceneError, match=r"skin 'palm': the skin at the patch centre is tilted") as caught:
        _ = wrong.patch
    assert "patch_site" in caught.value.mends


def test_all_skin_of_a_coarse_mesh_has_a_layer():
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.02)
    surface = Surface(np.array(ball.vertices), np.array(ball.faces, np.int32), np.array(ball.vertex_normals))
    config = SkinConfig(shape="mesh", mesh="body.ply", mesh_unit="m", patch_site="side", cover="whole", accuracy=0.3)
    of = SceneLayer(config, surface, 0.004, np.array([0.02, 0.0, 0.0]), DEMAND)
    assert not of.patch.rim.any() and of.patch.report["volume_share"] == pytest.approx(1.0, abs=0.02)
    assert of.dofs / of.expected_dofs == pytest.approx(1.0, abs=0.35)
    with pytest.raises(SceneError, match="cannot be coarser"):
        meshes_to_compare(of, finer=False)
    assert len(of.resized(0.3).patch.faces) > 1.5 * len(of.patch.faces)
