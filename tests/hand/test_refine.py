import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from palmfield.errors import SceneError
from palmfield.hand.preset import load_preset
from palmfield.hand.refine import bisected, refine, target_edges
from palmfield.hand.surface import hand_surface
from palmfield.hand.triangles import corner_angles, unique_edges, vertex_normals
from palmfield.hand.wholelayer import hand_layer
from palmfield.types import Surface


def as_surface(mesh):
    vertices, faces = np.array(mesh.vertices, dtype=float), np.array(mesh.faces, dtype=np.int32)
    return Surface(vertices, faces, vertex_normals(vertices, faces))


def lengths(surface):
    edges, uses = unique_edges(surface.faces)
    ends = surface.vertices[edges]
    return np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1), ends.mean(axis=1), uses


def test_a_hand_refined_at_a_fingertip():
    """Edges as asked, no hanging nodes, the same shape to round-off, and a layer on it."""
    hand = hand_surface(load_preset("open_men_p50"), 0.004)
    surface, pad = hand.surface, hand.landmarks["index_pad"]

    def wanted(points):
        return target_edges(np.linalg.norm(points - pad, axis=1), 0.028, per_acoustic=8.0)

    fine = refine(surface, wanted)
    length, middle, uses = lengths(fine)
    assert (length <= wanted(middle)).all() and set(uses) == {2}
    assert len(fine.vertices) - len(length) + len(fine.faces) == 2
    before, after = (trimesh.Trimesh(s.vertices, s.faces, process=False) for s in (surface, fine))
    assert after.area == pytest.approx(before.area, rel=1e-12)
    assert after.volume == pytest.approx(before.volume, rel=1e-12)
    far = np.linalg.norm(surface.vertices[surface.faces].mean(axis=1) - pad, axis=1) > 0.03
    kept = {tuple(face) for face in fine.faces.tolist()}
    share = np.mean([tuple(face) in kept for face in surface.faces[far].tolist()])
    assert share > 0.3 and len(fine.faces) < 4 * len(surface.faces), "it is fine where asked, not everywhere"
    report = hand_layer(fine, 0.003).report
    assert report["quality_min"] > 0.0 and report["area_thinned"] < 0.15 and report["p10_share"] > 0.6


def test_positions_lie_on_the_given_triangles_and_values_are_carried_linearly():
    box = as_surface(trimesh.creation.box(extents=[0.06, 0.04, 0.02]))
    carry, faces = bisected(box.vertices, box.faces, 0.004)
    points = carry @ box.vertices
    assert np.abs(np.abs(points) / [0.03, 0.02, 0.01]).max(axis=1) == pytest.approx(np.ones(len(points)), abs=1e-12)
    assert carry @ (box.vertices @ [1.0, -2.0, 0.5]) == pytest.approx(points @ [1.0, -2.0, 0.5])
    assert np.asarray(carry.sum(axis=1)) == pytest.approx(np.ones(len(points)))
    normals = np.cross(points[faces[:, 1]] - points[faces[:, 0]], points[faces[:, 2]] - points[faces[:, 0]])
    assert (np.abs(normals).max(axis=1) > 0.999 * np.linalg.norm(normals, axis=1)).all(), "faces stay in the planes"


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 10**6), place=st.tuples(*[st.floats(-0.03, 0.03)] * 3), fine=st.floats(0.0005, 0.01),
    growth=st.floats(0.05, 1.0),
)  # fmt: skip
def test_angles_stay_above_half_of_the_smallest(seed, place, fine, growth):
    """Rivara's bound, on random convex bodies with poor triangles and any grading."""
    hull = trimesh.convex.convex_hull(np.random.default_rng(seed).normal(0.0, 0.01, (25, 3)))
    body = as_surface(hull)

    def wanted(points):
        return fine + growth * np.linalg.norm(points - np.array(place), axis=1)

    out = refine(body, wanted)
    length, middle, uses = lengths(out)
    assert (length <= wanted(middle)).all() and set(uses) == {2}
    least = corner_angles(body.vertices, body.faces).min()
    assert corner_angles(out.vertices, out.faces).min() >= 0.5 * least * (1.0 - 1e-6)
    assert trimesh.Trimesh(out.vertices, out.faces, process=False).volume == pytest.approx(hull.volume, rel=1e-9)


def test_an_open_surface_and_lengths_by_vertex():
    flat = Surface(
        np.array([[0.0, 0, 0], [0.02, 0, 0], [0.02, 0.02, 0], [0, 0.02, 0]]),
        np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32),
        np.tile([0.0, 0.0, 1.0], (4, 1)),
    )
    out = refine(flat, np.array([0.001, 0.01, 0.01, 0.01]))
    length, middle, uses = lengths(out)
    assert set(uses) == {1, 2}
    assert length[np.linalg.norm(middle, axis=1) < 0.002].max() < 0.0025
    assert length[np.linalg.norm(middle - [0.02, 0.02, 0.0], axis=1) < 0.006].max() > 0.004
    assert out.normals == pytest.approx(np.tile([0.0, 0.0, 1.0], (len(out.vertices), 1)))
    same = refine(flat, 1.0)
    assert np.array_equal(same.faces, flat.faces) and np.array_equal(same.vertices, flat.vertices)


def test_wanted_edges_are_the_wavelengths_over_their_numbers():
    distance = np.array([0.0, 0.0086, 0.0186, 1.0])
    edges = target_edges(distance, 0.02, per_acoustic=8.6, per_shear=4.0, growth=0.3)
    assert edges == pytest.approx([0.001, 0.001, 0.004, 0.005])
    assert target_edges(distance, 0.002, per_acoustic=4.0, per_shear=4.0) == pytest.approx(np.full(4, 0.0005))


@pytest.mark.parametrize(
    "wanted, says",
    [
        (np.ones(3), r"shape \(3,\); give one length for each of 8 places"),
        (0.0, "wanted edge 0 m must be finite"),
        (np.nan, "wanted edge nan m"),
        (lambda points: np.full(len(points), -1.0), "wanted edge -1 m"),
        (lambda points: 0.001, r"shape \(\)"),
        (1e-6, "more than 2000000 vertices"),
    ],
)
def test_errors(wanted, says):
    with pytest.raises(SceneError, match=says) as caught:
        refine(as_surface(trimesh.creation.box(extents=[0.02, 0.02, 0.02])), wanted)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "change, says",
    [
        ({"shear_wavelength_m": 0.0}, "shear_wavelength_m is 0"),
        ({"per_shear": -1.0}, "per_shear is -1"),
        ({"near_m": np.inf}, "near_m is inf"),
        ({"growth": -0.1}, "growth is -0.1"),
        ({"distance_m": np.array([-1.0])}, "a distance is -1 m"),
    ],
)
def test_errors_of_wanted_edges(change, says):
    with pytest.raises(SceneError, match=says):
        target_edges(**({"distance_m": np.zeros(1), "shear_wavelength_m": 0.02} | change))
