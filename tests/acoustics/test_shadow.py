"""Shadows against plane geometry: horizons of spheres, plates in the way, the sum over what is seen."""

import numpy as np
import pytest
from rigid_sphere import geodesic
from shadow_rays import lit, shadowed_pressure

from palmfield.acoustics.arrays import layout
from palmfield.acoustics.focus import focus
from palmfield.acoustics.reference import pressure64
from palmfield.acoustics.shadow import shadow_mesh, visibility
from palmfield.errors import PalmfieldError
from palmfield.hand.triangles import face_normals, vertex_normals
from palmfield.types import Air, Float, Int, Surface

AIR = Air()
RADIUS = 0.02


def surface(vertices: Float, faces: Int) -> Surface:
    return Surface(vertices, faces, vertex_normals(vertices, faces))


@pytest.fixture(scope="module")
def ball() -> Surface:
    return surface(*geodesic(RADIUS, 24))


def middle(body: Surface) -> tuple[Float, Float]:
    return body.vertices[body.faces].mean(axis=1), face_normals(body.vertices, body.faces)[0]


def test_a_sphere_sees_a_source_down_to_its_horizon(ball: Surface) -> None:
    """The horizon of a source at distance D is cos = a/D."""
    points, normals = middle(ball)
    source = np.array([[0.0, 0.03, -0.04]])
    cosine = points @ source[0] / np.linalg.norm(points, axis=1) / 0.05
    seen = visibility(points, normals, shadow_mesh(ball, "cpu"), source)
    clear = np.abs(cosine - RADIUS / 0.05) > 0.06  # a facet's tilt and the clearance
    np.testing.assert_array_equal(seen[clear], (cosine > RADIUS / 0.05)[clear])
    assert seen.mean() == pytest.approx((1 - RADIUS / 0.05) / 2, abs=0.01)


def test_weights_count(ball: Surface) -> None:
    points, normals = middle(ball)
    mesh = shadow_mesh(ball, "cpu")
    sources = np.array([[0.0, 0.0, -0.5], [0.0, 0.0, 0.5], [0.5, 0.0, 0.0]])
    each = [visibility(points, normals, mesh, s[None]) for s in sources]
    weights = np.array([1.0, 0.5, 2.5])
    together = visibility(points, normals, mesh, sources, weights=weights)
    np.testing.assert_allclose(together, weights @ each / 4.0, atol=1e-6)


def test_a_ball_in_the_way_casts_a_round_shadow() -> None:
    """Parallel sound along z, a ball above a disc: dark inside its radius, lit outside."""
    vertices, faces = geodesic(RADIUS, 20)
    mesh = shadow_mesh(surface(vertices - [0.0, 0.0, 0.06], faces), "cpu")
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-0.04, 0.04, (4000, 2)), np.zeros(4000)])
    radius = np.hypot(points[:, 0], points[:, 1])
    got = lit(points, np.array([0.0, 0.0, 3.0]), mesh)
    clear = np.abs(radius - RADIUS) > 2e-4
    np.testing.assert_array_equal(got[clear], (radius > RADIUS)[clear])
    tilted = np.array([np.tan(0.3), 0.0, 1.0])
    shifted = np.hypot(points[:, 0] - 0.06 * np.tan(0.3), points[:, 1])
    # along a slanted ray the shadow is an ellipse; on its short axis it is the ball's own radius
    on_axis = np.abs(points[:, 0] - 0.06 * np.tan(0.3)) < 1e-3
    clear = on_axis & (np.abs(shifted - RADIUS) > 5e-4)
    np.testing.assert_array_equal(lit(points, tilted, mesh)[clear], (shifted > RADIUS)[clear])


def test_lit_on_a_body_is_where_sound_enters(ball: Surface) -> None:
    points, normals = middle(ball)
    flux = np.array([0.6, 0.0, 0.8])
    inward = -normals @ flux
    got = lit(points, flux, shadow_mesh(ball, "cpu"))
    clear = np.abs(inward) > 0.1
    np.testing.assert_array_equal(got[clear], (inward > 0)[clear])
    assert not lit(points[:3], np.zeros(3), shadow_mesh(ball, "cpu")).any()


def test_shadowed_pressure_is_the_sum_over_what_is_seen(ball: Surface) -> None:
    """Points in full view, in full shadow and between, against the float64 sum with the hidden transducers off."""
    array = layout("uhev1")
    drive = focus(array, AIR, (0.0, 0.0, 0.1))
    lifted = surface(ball.vertices + np.array([0.01, 0.0, 0.12]), ball.faces)
    points, normals = middle(lifted)
    mesh = shadow_mesh(lifted, "cpu")
    field = shadowed_pressure(points, normals, mesh, array, drive, AIR)
    share = visibility(points, normals, mesh, array.positions)
    assert field.gradient is not None
    assert np.all(field.pressure[share == 0.0] == 0.0)
    whole = share > 0.9999
    partly = np.flatnonzero((share > 0.02) & (share < 0.98))[::40]
    assert min(np.count_nonzero(share == 0.0), np.count_nonzero(whole), 5 * len(partly)) > 40
    exact, slope = pressure64(points[whole], array, drive, AIR, gradient=True)
    assert slope is not None
    assert np.linalg.norm(field.pressure[whole] - exact) < 2e-5 * np.linalg.norm(exact)
    assert np.linalg.norm(field.gradient[whole] - slope) < 2e-5 * np.linalg.norm(slope)
    for i in partly:
        seen = np.array([visibility(points[[i]], normals[[i]], mesh, s[None])[0] for s in array.positions])
        exact, slope = pressure64(points[[i]], array, seen * drive, AIR, gradient=True)
        assert slope is not None
        loudest = array.p0_Pa_m * seen.sum() / 0.1  # in phase; of it float32 leaves kd 2^-24 = 5e-6
        assert field.pressure[i] == pytest.approx(exact[0], abs=float(5e-6 * loudest))
        np.testing.assert_allclose(field.gradient[i], slope[0], atol=5e-6 * 733 * loudest)


def test_coarse_mesh_does_not_shade_the_fine_one() -> None:
    """Points of a smooth ball lie up to 0.06 mm above the facets of a coarse one and below those of one blown up."""
    coarse = surface(*geodesic(RADIUS * 1.003, 16))
    points, normals = middle(surface(*geodesic(RADIUS, 40)))
    front = normals[:, 2] < -0.5
    seen = visibility(points[front], normals[front], shadow_mesh(coarse, "cpu"), np.array([[0.0, 0.0, -1.0]]))
    assert np.all(seen == 1.0)


def test_what_cannot_be_used_is_refused(ball: Surface) -> None:
    mesh = shadow_mesh(ball, "cpu")
    points, normals = middle(ball)
    with pytest.raises(PalmfieldError, match="one normal per point"):
        visibility(points[:4], normals[:3], mesh, np.zeros((1, 3)))
    with pytest.raises(PalmfieldError, match="weights"):
        visibility(points[:4], normals[:4], mesh, np.zeros((2, 3)), weights=[0.0, 0.0])
    with pytest.raises(PalmfieldError, match="weights"):
        visibility(points[:4], normals[:4], mesh, np.zeros((2, 3)), weights=[1.0, -0.5])
    with pytest.raises(PalmfieldError, match=r"flux_direction\[2\]"):
        lit(points[:4], np.where(np.arange(4)[:, None] == 2, np.nan, np.ones((4, 3))), mesh)
    with pytest.raises(PalmfieldError, match="drive"):
        shadowed_pressure(points[:4], normals[:4], mesh, layout("uhev1"), np.ones(3), AIR)
