"""Spots beside a body and on curved layers, what absorbing sides send back, and layers made of bad numbers."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from coverage_draw import patch_of

from palmfield.errors import SceneError
from palmfield.skin import solve, static
from palmfield.skin.analytic.layer_oracle import centre_response
from palmfield.skin.approximation.truncate_domain import refusal_of_spot, trim_absorbing_rim
from palmfield.skin.materials.catalogue import preset
from palmfield.skin.materials.material import Sheet
from palmfield.skin.problem import Layer, SkinProblem, Slab, Spot, points_on_face
from palmfield.skin.solver_choice import choices
from palmfield.skin.solvers.lateral_waves import solve_lateral_waves
from palmfield.skin.solvers.wedges import static_wedges
from palmfield.types import Patch

ECOFLEX, PALM = preset("ecoflex_00-10"), preset("palm")
FLAT = np.array([np.inf, np.inf])


def held(x, fwhm=0.008):
    return Spot(fwhm, np.array([0.0]), np.array([1.0]), np.array([x, 0.0]), law="held")


@pytest.mark.parametrize("solver", ["wedges", "reduced", "spectral_elements"])
def test_a_spot_beside_the_body_does_not_press_it(solver):
    """Three widths outside, the bell is 1e-11 of its peak; it is not moved onto the rim."""
    body = Slab((Sheet(ECOFLEX, 0.006),), shape="box", size_m=(0.03, 0.03), side="free")
    times, at = np.array([0.002]), [[0.012, 0.0]]
    found = [solve(body, held(x), times, at, solver=solver, accuracy=0.2, device="cpu") for x in (0.039, 0.0)]
    assert np.abs(found[0].displacement_m).max() < 1e-6 * np.abs(found[1].displacement_m).max()


def curved_patch(sides, depth, radii, edge):
    return patch_of(
        {
            "size_m": sides, "radii_m": radii, "bump": [0.0, 0.0], "depth_m": depth, "edge_m": edge,
            "triangles_seed": None,
        }
    )  # fmt: skip


def test_where_a_dome_lies_along_z_changes_nothing():
    patch = curved_patch(np.array([0.03, 0.03]), 0.004, np.array([0.03, 0.03]), 0.003)
    at = np.array([[0.0, 0.0], [0.006, 0.002]])
    found = []
    for shift in (0.0, 0.05, -0.02):
        moved = replace(patch, vertices=patch.vertices + np.array([0.0, 0.0, shift]))
        body = Layer(moved, (Sheet(PALM, 0.004),))
        motion = static_wedges(body, held(0.004), at, accuracy=0.3)
        assert motion.points[:, 2] == pytest.approx(points_on_face(Layer(patch, body.sheets), at)[:, 2] + shift)
        found.append(motion.displacement_m)
    assert np.abs(found[0][0, :, 2]).min() > 0.0
    np.testing.assert_allclose(found[1], found[0], rtol=1e-5, atol=1e-6 * np.abs(found[0]).max())
    np.testing.assert_allclose(found[2], found[0], rtol=1e-5, atol=1e-6 * np.abs(found[0]).max())


def test_a_spot_on_a_face_that_does_not_look_along_z_is_refused():
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.03)
    count = len(ball.vertices)
    patch = Patch(
        vertices=np.array(ball.vertices),
        faces=np.array(ball.faces, dtype=np.int32),
        inward=-ball.vertices / np.linalg.norm(ball.vertices, axis=1, keepdims=True),
        depth=np.full(count, 0.006),
        rim=np.zeros(count, dtype=bool),
    )
    body = Layer(patch, (Sheet(PALM, 0.006),))
    reason = refusal_of_spot(body, held(0.0))
    assert reason is not None and "give pressures at points" in reason
    able = [c.name for c in choices(body, held(0.0), [0.01], [[0.0, 0.0, 0.03]], device="cpu") if c.refusal is None]
    assert able == [] or able == ["particles"]


@pytest.mark.nightly
def test_absorbing_sides_near_the_load_are_in_the_error():
    """A flat layer whose sides are 18 mm off against the endless slab: by quasi-static motion they err by 18 %."""
    times, asked = np.linspace(0.0, 0.02, 81), np.linspace(0.001, 0.02, 20)
    load = Spot(0.0103, times, np.sin(2.0 * np.pi * 100.0 * times) ** 2)
    at = np.array([[0.0, 0.0], [0.01, 0.0]])
    exact = solve_lateral_waves(
        SkinProblem(Slab((Sheet(ECOFLEX, 0.008),)), load, asked, at, accuracy=0.01)
    ).displacement_m
    flat = curved_patch(np.array([0.036, 0.036]), 0.008, FLAT, 0.006)
    body = Layer(flat, (Sheet(ECOFLEX, 0.008),), side="absorbing")
    found = solve(body, load, asked, at, solver="reduced", accuracy=0.2, device="cpu")
    apart = np.linalg.norm(found.displacement_m - exact, axis=(0, 2)) / np.linalg.norm(exact, axis=(0, 2))
    assert 0.05 < apart.max() <= found.error < 4.0 * apart.max()
    assert "two extents" in found.error_source


def test_the_belt_is_taken_from_the_rim_and_leaves_load_and_points():
    flat = curved_patch(np.array([0.04, 0.04]), 0.004, FLAT, 0.002)
    body = Layer(flat, (Sheet(PALM, 0.004),), side="absorbing")
    part = trim_absorbing_rim(body, held(0.0), np.array([[0.01, 0.0, 0.0]]), 0.7)
    assert isinstance(part, Layer)
    # 0.3 of 20 mm, but half of the 10 mm between the point and the side at most
    assert np.abs(part.patch.vertices[:, :2]).max() == pytest.approx(0.015, abs=0.0021)
    assert trim_absorbing_rim(body, held(0.0), np.array([[0.02, 0.0, 0.0]]), 0.7) is body


def test_few_times_at_few_points_are_judged_by_the_worst_point():
    body = Slab((Sheet(PALM, 0.003),))
    at = np.array([[0.0, 0.0], [0.012, 0.0], [0.02, 0.0]])
    load = held(0.0)
    found = static(body, load, at, accuracy=0.05)
    exact = -centre_response(0.0, PALM, 0.003, 0.008, None, at[:, 0]).real
    apart = np.abs(found.displacement_m[0, :, 2] - exact) / np.abs(exact)
    assert apart.max() <= found.error <= 0.05


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"vertices": np.nan}, r"vertices of its patch has \[nan"),
        ({"depth": np.inf}, "depth of its patch has inf at vertex 3"),
        ({"inward": 2.0}, "inward direction of vertex 3 has length 2"),
        ({"faces": 9999}, "faces name vertices 0 to 9999"),
    ],
)
def test_patches_of_bad_numbers(change, message):
    flat = curved_patch(np.array([0.02, 0.02]), 0.004, FLAT, 0.004)
    ((name, value),) = change.items()
    values = getattr(flat, name).copy()
    values[3] = values[3] * value if name == "inward" else value
    with pytest.raises(SceneError, match=message):
        Layer(replace(flat, **{name: values}), (Sheet(PALM, 0.004),))


def test_words_for_numbers_and_no_load():
    body = Slab((Sheet(PALM, 0.004),))
    for arguments in ({"times": ["soon"]}, {"at": [["here", 0.0]]}, {"accuracy": "high"}):
        given = {"times": [0.01], "at": [[0.0, 0.0]]} | arguments
        with pytest.raises(SceneError, match=r"soon|here|high"):
            solve(body, held(0.0), given.pop("times"), given.pop("at"), **given)
    nothing = Spot(0.008, np.array([0.0]), np.array([0.0]), law="held")
    found = solve(body, nothing, [0.01], [[0.0, 0.0]])
    assert not found.displacement_m.any() and found.error == 0.0 and "no load" in found.error_source
