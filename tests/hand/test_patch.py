import functools

import numpy as np
import pytest
import trimesh
from hypothesis import example, given, settings
from hypothesis import strategies as st

from palmfield.errors import SceneError
from palmfield.hand.layer import inward_directions, wedge_quality
from palmfield.hand.patch import surface_patch
from palmfield.hand.preset import load_preset
from palmfield.hand.surface import hand_surface
from palmfield.hand.triangles import corner_angles, unique_edges, vertex_normals
from palmfield.types import Surface

hand = functools.cache(lambda name: hand_surface(load_preset(name)))


def as_surface(mesh):
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int32)
    return Surface(vertices, faces, vertex_normals(vertices, faces))


def signed_volume(patch):
    """Volume of the extruded layer by the divergence theorem over its closed boundary."""
    bottom = patch.vertices + patch.depth[:, None] * patch.inward
    n = len(bottom)
    directed = np.concatenate([patch.faces[:, [0, 1]], patch.faces[:, [1, 2]], patch.faces[:, [2, 0]]])
    keys = {(int(a), int(b)) for a, b in directed}
    sides = np.array([(a, b) for a, b in keys if (b, a) not in keys])
    a, b = sides.T
    walls = np.concatenate([np.stack([b, a, a + n], axis=1), np.stack([b, a + n, b + n], axis=1)])
    faces = np.concatenate([patch.faces, patch.faces[:, ::-1] + n, walls])
    closed = trimesh.Trimesh(np.concatenate([patch.vertices, bottom]), faces, process=False)
    assert closed.is_watertight and closed.is_winding_consistent
    return closed.volume


@pytest.mark.parametrize("radius_m", [0.06, 0.08])
@pytest.mark.parametrize("sections", [64, 200])
def test_disc_phantom(radius_m, sections):
    disc = as_surface(trimesh.creation.cylinder(0.06, 0.02, sections=sections))
    patch = surface_patch(
        disc, 0.02, (0, 0, 0.01), radius_m, 0.003, 0.005, 0.02, max_depth_m=0.03, axis=(0, 0, 1), max_fraction=1.0
    )
    face_area = 0.5 * sections * 0.06**2 * np.sin(2 * np.pi / sections)
    assert patch.report["area_m2"] == pytest.approx(face_area, rel=0.01)
    rim = np.linalg.norm(patch.vertices[patch.rim][:, :2], axis=1)
    assert rim.min() > 0.06 * 0.995 and rim.max() < 0.06 * 1.005
    assert np.abs(patch.depth - 0.02).max() < 1e-12
    assert np.abs(patch.inward - [0, 0, -1]).max() < 1e-12
    assert np.abs(patch.vertices[:, 2] - 0.01).max() < 1e-12
    assert patch.axis == pytest.approx([0, 0, 1])
    assert patch.report["share_thinned"] == 0.0
    assert patch.report["angle_min_deg"] > 25
    assert signed_volume(patch) == pytest.approx(patch.report["area_m2"] * 0.02, rel=1e-9)


def test_edges_are_graded_as_asked():
    disc = as_surface(trimesh.creation.cylinder(0.06, 0.02, sections=200))
    patch = surface_patch(disc, 0.02, (0, 0, 0.01), 0.06, 0.002, 0.006, 0.015, max_depth_m=0.02, max_fraction=1.0)
    edges, _ = unique_edges(patch.faces)
    length = np.linalg.norm(patch.vertices[edges[:, 0]] - patch.vertices[edges[:, 1]], axis=1)
    r = np.linalg.norm(patch.vertices[edges].mean(axis=1)[:, :2], axis=1)
    assert length[r < 0.014].mean() == pytest.approx(0.002, rel=0.1)
    assert length[r > 0.055].mean() == pytest.approx(0.0057, rel=0.12)
    middle = 0.002 + 0.004 * (0.0375 - 0.015) / 0.045
    assert length[(r > 0.035) & (r < 0.04)].mean() == pytest.approx(middle, rel=0.12)


@pytest.mark.parametrize("subdivisions", [3, 5])
def test_cap_of_a_sphere(subdivisions):
    """Coarsens a fine sphere and refines a coarse one; the cap's area is 2 pi R h."""
    radius, reach = 0.04, 0.02
    ball = as_surface(trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius))
    patch = surface_patch(ball, 0.006, (0, 0, radius), reach, 0.002, 0.002, 0.0, max_depth_m=0.01, facing=(0, 0, 1))
    cap = 2 * np.pi * radius * (radius - np.sqrt(radius**2 - reach**2))
    assert patch.report["area_m2"] == pytest.approx(cap, rel=0.015)
    outward = patch.vertices / np.linalg.norm(patch.vertices, axis=1, keepdims=True)
    cosine = -np.einsum("ij,ij->i", patch.inward, outward)
    assert np.rad2deg(np.arccos(np.clip(cosine, -1, 1))).max() < 8.0
    assert patch.depth == pytest.approx(0.006, rel=1e-12)
    shell = cap * 0.006 * (1 - 0.006 / radius + (0.006 / radius) ** 2 / 3)
    assert signed_volume(patch) == pytest.approx(shell, rel=0.03)


def test_patch_area_converges_with_the_edge_length():
    ball = as_surface(trimesh.creation.icosphere(subdivisions=6, radius=0.04))
    cap = 2 * np.pi * 0.04 * (0.04 - np.sqrt(0.04**2 - 0.03**2))
    errors = [
        abs(
            surface_patch(ball, 0.005, (0, 0, 0.04), 0.03, e, e, 0.0, max_depth_m=0.005, facing=(0, 0, 1)).report[
                "area_m2"
            ]
            - cap
        )
        for e in (0.006, 0.003)
    ]
    assert errors[0] / errors[1] > 2.8, "second order: 4 in the limit"


def test_far_side_limits_the_thickness():
    plate = trimesh.creation.box(extents=[0.08, 0.08, 0.004])
    patch = surface_patch(as_surface(plate), 0.01, (0, 0, 0.002), 0.02, 0.003, 0.005, 0.01, max_depth_m=0.01)
    assert patch.depth == pytest.approx(0.45 * 0.004, rel=1e-9)
    assert patch.report["share_thinned"] == 1.0


def test_rim_follows_the_end_of_the_region():
    """A square plate smaller than the radius: its edge is the rim and no spike or hole is left."""
    plate = trimesh.creation.box(extents=[0.06, 0.05, 0.02])
    patch = surface_patch(as_surface(plate), 0.005, (0, 0, 0.01), 0.06, 0.002, 0.003, 0.02, max_depth_m=0.005)
    assert patch.report["area_m2"] == pytest.approx(0.06 * 0.05, rel=0.02)
    x, y = np.abs(patch.vertices[patch.rim][:, :2]).T
    assert np.minimum(np.abs(x - 0.03), np.abs(y - 0.025)).max() < 1.5e-3
    edges, count = unique_edges(patch.faces)
    assert len(patch.vertices) - len(edges) + len(patch.faces) == 1
    assert set(np.unique(count)) == {1, 2}


@pytest.mark.parametrize("name", ["open_men_p50", "open_women_p50"])
@pytest.mark.parametrize("fine_m, coarse_m", [(0.003, 0.006), (0.004, 0.004), (0.0015, 0.006)])
def test_palm_patch(name, fine_m, coarse_m):
    skin = hand(name)
    patch = surface_patch(skin.surface, skin.depth_to_bone, (0, 0, 0), 0.035, fine_m, coarse_m, 0.01, max_depth_m=0.012)
    quality = wedge_quality(patch.vertices, patch.faces, patch.inward, patch.depth)
    assert quality.min() >= 0.05 and quality.min() == patch.report["quality_min"]
    assert patch.report["depth_got_p10_m"] >= 0.6 * patch.report["depth_asked_p10_m"]
    assert patch.report["angle_min_deg"] > 18
    assert np.abs(np.linalg.norm(patch.inward, axis=1) - 1).max() < 1e-12
    assert signed_volume(patch) > 0
    assert np.rad2deg(np.median(corner_angles(patch.vertices, patch.faces).min(axis=1))) > 42


@settings(max_examples=15, deadline=None)
@example(x=0.0, y=0.0078125, radius=0.044921875, edge=0.0034602625212804077)
@given(
    x=st.floats(-0.02, 0.02), y=st.floats(-0.035, 0.03), radius=st.floats(0.012, 0.045), edge=st.floats(0.002, 0.005)
)
def test_any_place_on_the_palm(x, y, radius, edge):
    skin = hand("open_women_p50")
    v = skin.surface.vertices
    palmar = np.flatnonzero(skin.surface.normals[:, 2] < -0.5)
    centre = v[palmar[np.argmin(np.linalg.norm(v[palmar, :2] - [x, y], axis=1))]]
    try:
        patch = surface_patch(
            skin.surface, skin.depth_to_bone, centre, radius, edge, 1.5 * edge, 0.01, max_depth_m=0.01
        )
    except SceneError as refusal:
        # A patch that reaches round the palm's edge may fold there, and is refused with the place
        assert radius > 0.035 and "skin layer folds at (" in str(refusal)
        return
    assert wedge_quality(patch.vertices, patch.faces, patch.inward, patch.depth).min() >= 0.05
    assert (patch.depth > 0).all() and (patch.depth <= 0.01 + 1e-12).all()
    assert signed_volume(patch) > 0
    assert set(np.unique(unique_edges(patch.faces)[1])) == {1, 2}


def test_a_finger_pad_and_a_web_give_sound_wedges():
    skin = hand("open_men_p50")
    web = np.array([0.0, skin.landmarks["middle_knuckle"][1] + 0.012, 0.0])
    nearest = skin.surface.vertices[np.argmin(np.linalg.norm(skin.surface.vertices - web, axis=1))]
    for centre, radius, facing in ((skin.landmarks["index_pad"], 0.008, None), (nearest, 0.03, (0, 0, -1))):
        patch = surface_patch(
            skin.surface, skin.depth_to_bone, centre, radius, 0.0015, 0.003, 0.004, max_depth_m=0.02, facing=facing
        )
        assert patch.report["quality_min"] >= 0.05


def test_wedge_quality_of_known_wedges():
    side = np.array([[0, 0, 0], [1, 0, 0], [0.5, np.sqrt(0.75), 0]])
    face = np.array([[0, 1, 2]], dtype=np.int32)
    down = np.tile([0.0, 0.0, -1.0], (3, 1))
    assert wedge_quality(side, face, down, np.ones(3)) == pytest.approx([1.0])
    assert wedge_quality(side, face, -down, np.ones(3)) == pytest.approx([-1.0])
    crossing = side.mean(axis=0) - np.array([0, 0, 0.5]) - side
    crossing /= np.linalg.norm(crossing, axis=1, keepdims=True)
    assert wedge_quality(side, face, crossing, np.full(3, 0.3))[0] > 0
    for past_the_apex in (1.0, 2.0):
        assert wedge_quality(side, face, crossing, np.full(3, past_the_apex))[0] < 0


def test_inward_directions_at_a_sharp_ridge_see_both_sides():
    ridge = np.array([[0, 0, 0], [0, 1, 0], [1, 0, -2.0], [1, 1, -2.0], [-1, 0, -2.0], [-1, 1, -2.0]])
    faces = np.array([[0, 2, 3], [0, 3, 1], [0, 1, 5], [0, 5, 4]], dtype=np.int32)
    inward = inward_directions(ridge, faces)
    assert inward[:2, 2] == pytest.approx(-1.0, abs=0.05)


@pytest.mark.parametrize(
    "change, says",
    [
        ({"centre": (0, 0, -0.02)}, "mm from the surface; allowed: at most 5 mm"),
        ({"centre": (0, 0, np.nan)}, "three finite numbers"),
        ({"radius_m": 0.004}, "below two fine edges"),
        ({"coarse_m": 0.001}, "below fine_m"),
        ({"fine_m": -0.001}, "fine_m -0.001 must be a positive length"),
        ({"max_depth_m": 0.0}, "max_depth_m 0 must be"),
        ({"fine_radius_m": -1.0}, "must not be negative"),
        ({"max_fraction": 1.5}, "max_fraction is 1.5"),
        ({"depth": np.ones(3)}, "skin depth has shape"),
        ({"depth": -0.001}, r"skin depth is -0\.001 m at vertex 0"),
        ({"facing": (0, 0, 0)}, "facing .* not all zero"),
        ({"facing": (0, 0, 1)}, "more than 75 degrees"),
    ],
)
def test_errors(change, says):
    skin = hand("open_men_p50")
    use = {
        "depth": 0.01, "centre": (0, 0, 0), "radius_m": 0.03, "fine_m": 0.003, "coarse_m": 0.005, "fine_radius_m": 0.01,
        "max_depth_m": 0.01,
    } | change  # fmt: skip
    with pytest.raises(SceneError, match=says) as caught:
        surface_patch(skin.surface, **use)
    assert "\n" not in str(caught.value)


def test_a_part_too_narrow_for_the_edges_is_refused():
    rod = as_surface(trimesh.creation.cylinder(0.003, 0.1, sections=48))
    with pytest.raises(SceneError, match=r"narrower than 9\.0 mm"):
        surface_patch(rod, 0.001, (0.003, 0, 0), 0.02, 0.004, 0.006, 0.01, max_depth_m=0.001)


def test_edges_are_fine_round_the_place_that_is_asked_for():
    ball = as_surface(trimesh.creation.icosphere(5, 0.08))
    place = np.array([0.02, 0.01, 0.0768])
    patch = surface_patch(
        ball, 0.006, (0, 0, 0.08), 0.05, 0.003, 0.009, 0.008, max_depth_m=0.01, facing=(0, 0, 1), fine_at=place
    )
    corners = patch.vertices[patch.faces]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean(axis=1)
    away = np.linalg.norm(corners.mean(axis=1) - place, axis=1)
    assert edges[away < 0.007].mean() == pytest.approx(0.003, rel=0.25)
    middle = np.linalg.norm(corners.mean(axis=1) - [0, 0, 0.08], axis=1) < 0.006
    assert edges[middle].mean() > 1.2 * edges[away < 0.007].mean()
