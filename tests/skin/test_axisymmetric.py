"""The round disc by harmonics against the exact series, statics, conservation and its own convergence."""

import dataclasses
import math

import numpy as np
import pytest

from palmfield.errors import SceneError
from palmfield.skin.analytic.layer_oracle import centre_response
from palmfield.skin.base import Springs
from palmfield.skin.materials.catalogue import preset
from palmfield.skin.materials.material import Sheet, bulk_from_poisson
from palmfield.skin.problem import SkinProblem, Slab, Spot, Traction, spread
from palmfield.skin.reduction.dynamic_stiffness import DynamicStiffness
from palmfield.skin.solvers.axisymmetric.element import DiscGrid, Line, graded
from palmfield.skin.solvers.axisymmetric.samples import sample
from palmfield.skin.solvers.axisymmetric.solve import cost_axisymmetric, refusal_axisymmetric, solve_axisymmetric

ECOFLEX = preset("ecoflex_00-10")
FWHM = 0.0103
STATIC = Spot(FWHM, np.array([0.0]), np.array([1.0]), law="held")
LATE = np.array([1.0])


def disc(material=ECOFLEX, depth=0.02, radius=0.06, side="roller", base="bonded"):
    return Slab((Sheet(material, depth),), shape="disc", radius_m=radius, side=side, base=base)


def push(body, degree, f_Hz, r, fine=1.8):
    """Complex push per pascal of a centred spot at distances r, without any reduced model."""
    s = spread(FWHM)
    radial = Line(graded(body.radius_m, lambda x: fine * s + 0.0 * x), degree)
    depth = Line(-graded(body.thickness_m, lambda z: fine * s + 0.4 * z)[::-1], degree)
    grid = DiscGrid(body, radial, depth, np.zeros(depth.elements, dtype=int))
    system = grid.system(0)
    force = system.spread.T @ grid.pressure_force(lambda x: np.exp(-0.5 * (x / s) ** 2)[:, None])
    stiffness = DynamicStiffness(system)
    u = stiffness.factor(-2j * math.pi * f_Hz if f_Hz else 0.0).solve(force.astype(complex if f_Hz else float))
    return -(grid.face_reader(np.asarray(r)) @ (system.spread @ u))[2::3, 0]


@pytest.mark.parametrize("degree", [1, 4, 7])
def test_line_holds_polynomials(degree):
    line = Line(np.array([0.0, 0.3, 1.0]), degree)
    x, weights, _ = line.rule(degree + 1)
    nodes = np.array([0.0, 0.1, 0.55, 0.9, 1.0])
    mass = line.values(x).T @ (weights[:, None] * line.values(x))
    coefficients = np.linalg.solve(mass, line.values(x).T @ (weights * x**degree))
    np.testing.assert_allclose(line.values(nodes) @ coefficients, nodes**degree, atol=1e-12)
    np.testing.assert_allclose(line.values(nodes, 1) @ coefficients, degree * nodes ** (degree - 1), atol=1e-11)


@pytest.mark.parametrize("base", ["bonded", "free_slip"])
@pytest.mark.parametrize("f_Hz", [0.0, 70.0, 200.0, 400.0])
def test_roller_disc_is_the_exact_series(base, f_Hz):
    r = np.array([0.0, 0.01, 0.03])
    exact = centre_response(f_Hz, ECOFLEX, 0.02, FWHM, 0.06, at=r, base=base)
    errors = [np.linalg.norm(push(disc(base=base), p, f_Hz, r) - exact) / np.linalg.norm(exact) for p in (4, 6, 8)]
    print(base, f_Hz, errors)
    assert errors[1] < 1e-3
    assert errors[2] < 5e-5
    assert errors[2] < 0.1 * errors[0]


@pytest.mark.parametrize("nu", [0.45, 0.495, 0.4999, 0.499999])
@pytest.mark.parametrize("depth", [0.02, 0.003])
def test_no_locking(nu, depth):
    """From 0.4999 to 0.499999 the bulk modulus grows a hundredfold: elements that lock would follow it."""
    material = dataclasses.replace(ECOFLEX, bulk_Pa=bulk_from_poisson(nu, 12.5e3))
    for f in (0.0, 200.0):
        exact = complex(centre_response(f, material, depth, FWHM, 0.06))
        errors = [abs(push(disc(material, depth), p, f, [0.0])[0] / exact - 1) for p in (5, 6)]
        print(nu, depth, f, errors)
        assert errors[0] < 0.01
        assert errors[1] < 0.003


def test_ramp_in_time_is_the_series_transformed():
    """A 1 ms rise and fall; window of 0.25 s, by which the layer's 438 Hz compression has died to 1e-5."""
    window, top = 0.25, 3000.0
    f = np.arange(1, round(top * window)) / window
    compliance = np.array([complex(centre_response(g, ECOFLEX, 0.02, FWHM, 0.06)) for g in f])
    t = np.linspace(0.0, 2e-3, 401)
    shape = 0.5 * (1 - np.cos(math.pi * t / 1e-3))
    # The pulse and its slope vanish at both ends: the trapezoid rule is spectrally exact.
    w = 2 * math.pi * f
    spectrum = np.exp(1j * np.outer(w, t)) @ shape * (t[1] - t[0])
    times = np.arange(0.0, 0.03, 2e-4)
    mean = float(centre_response(0.0, ECOFLEX, 0.02, FWHM, 0.06).real) * 1e-3 / window
    series = mean + 2.0 / window * (compliance * spectrum * np.exp(-1j * np.outer(times, w))).real.sum(axis=1)
    motion = solve_axisymmetric(SkinProblem(disc(), Spot(FWHM, t, shape), times, np.zeros((1, 2)), accuracy=0.002))
    error = np.linalg.norm(-motion.displacement_m[:, 0, 2] - series) / np.linalg.norm(series)
    print("ramp", error, motion.error)
    assert error < 2e-3


def test_spot_off_the_axis_sinks_as_on_it():
    """All harmonics: on a wide thin disc the answer depends on the distance from the spot only, and points from it."""
    spot = dataclasses.replace(STATIC, centre_m=np.array([0.006, 0.008]))
    offsets = np.array([[0.0, 0.0], [0.005, 0.0], [-0.003, 0.004], [0.0, -0.005], [0.008, 0.006]])
    motion = solve_axisymmetric(SkinProblem(disc(depth=0.008), spot, LATE, spot.centre_m + offsets, accuracy=0.002))
    moved = motion.displacement_m[0]
    exact = centre_response(0.0, ECOFLEX, 0.008, FWHM, None, at=np.hypot(*offsets.T)).real
    print(-moved[:, 2] / exact - 1, motion.error, motion.solver)
    np.testing.assert_allclose(-moved[:, 2], exact, atol=1e-3 * exact[0])
    along = np.einsum("nd,nd->n", moved[1:, :2], offsets[1:]) / np.hypot(*offsets[1:].T)
    across = moved[1:, 0] * offsets[1:, 1] - moved[1:, 1] * offsets[1:, 0]
    np.testing.assert_allclose(along[:3], along[0], rtol=0.01)
    assert np.abs(across).max() < 1e-4 * np.abs(along).max()
    assert np.abs(moved[0, :2]).max() < 2e-3 * exact[0]


def test_slow_circle_follows_the_static_answer():
    """A quarter turn in 25 s: at each time the static answer at the distance from where the spot then is."""
    t = np.linspace(0.0, 25.0, 41)
    angle = 0.5 * math.pi * t / t[-1]
    path = 0.008 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    spot = Spot(FWHM, t, np.full(len(t), 2.0), path)
    points = np.array([[0.0, 0.0], [0.006, 0.003], [-0.002, 0.007]])
    times = t[8::8]
    motion = solve_axisymmetric(SkinProblem(disc(depth=0.008), spot, times, points, accuracy=0.005))
    distance = np.linalg.norm(path[8::8, None] - points, axis=2)
    exact = 2.0 * centre_response(0.0, ECOFLEX, 0.008, FWHM, None, at=distance).real
    error = np.linalg.norm(-motion.displacement_m[..., 2] - exact) / np.linalg.norm(exact)
    print("slow circle", error, motion.error)
    assert error < 3e-3


@pytest.mark.nightly
@pytest.mark.parametrize("side", ["fixed", "free"])
def test_turning_the_path_turns_the_motion(side):
    """A straight fast path: several radial shapes, all harmonics; a turn by 40 degrees must change nothing."""
    t = np.array([0.0, 2e-3, 4e-3])
    path = np.array([[-0.008, 0.004], [0.0, 0.004], [0.008, 0.004]])
    points = np.array([[0.002, 0.006], [0.01, -0.004]])
    c, s = math.cos(0.7), math.sin(0.7)
    turn = np.array([[c, s], [-s, c]])
    body = disc(radius=0.025, depth=0.01, side=side)
    times = np.linspace(0.0, 6e-3, 13)
    straight, turned = (
        solve_axisymmetric(
            SkinProblem(body, Spot(FWHM, t, np.array([0.0, 1.0, 0.5]), p), times, q, accuracy=0.05), degree=5
        )
        for p, q in ((path, points), (path @ turn, points @ turn))
    )
    expected = straight.displacement_m.copy()
    expected[..., :2] = expected[..., :2] @ turn
    assert np.linalg.norm(turned.displacement_m - expected) < 1e-6 * np.linalg.norm(expected)


@pytest.mark.parametrize("side", ["fixed", "free", "roller"])
def test_error_estimate_covers_what_a_finer_run_shows(side):
    t = np.linspace(0.0, 0.02, 401)
    spot = Spot(FWHM, t, 0.5 * (1 + np.sin(2 * math.pi * 200 * t)))
    body = disc(side=side)
    points = np.array([[0.0, 0.0], [0.01, 0.0]])
    motion, finer = (
        solve_axisymmetric(SkinProblem(body, spot, t[::4], points, accuracy=a), degree=p)
        for a, p in ((0.02, 5), (0.002, 7))
    )
    missed = np.sqrt(((motion.displacement_m - finer.displacement_m) ** 2).sum(axis=(0, 2)))
    true = (missed / np.sqrt((finer.displacement_m**2).sum(axis=(0, 2)))).max()
    print(side, "true", true, "estimate", motion.error, motion.error_source)
    assert true <= motion.error <= 0.02


def test_free_body_keeps_its_momentum():
    """Nothing holds it: after a pulse and its waves, it flies with impulse / mass."""
    t = np.array([0.0, 1e-3, 2e-3])
    body = disc(radius=0.02, depth=0.01, base="free", side="free")
    motion = solve_axisymmetric(
        SkinProblem(body, Spot(FWHM, t, np.array([0.0, 1.0, 0.0])), np.array([2.0, 2.2]), np.zeros((1, 2)))
    )
    s = spread(FWHM)
    impulse = 1e-3 * 2 * math.pi * s**2 * (1 - math.exp(-0.5 * (0.02 / s) ** 2))
    mass = 1030.0 * math.pi * 0.02**2 * 0.01
    np.testing.assert_allclose(-motion.velocity_m_s[:, 0, 2], impulse / mass, rtol=1e-6)
    np.testing.assert_allclose(np.diff(-motion.displacement_m[:, 0, 2]), 0.2 * impulse / mass, rtol=1e-6)


def test_base_of_springs_and_dashpots():
    still = solve_axisymmetric(SkinProblem(disc(), STATIC, LATE, np.zeros((1, 2))), degree=5).displacement_m
    stiff = solve_axisymmetric(
        SkinProblem(disc(base=Springs(1e14, 1e14)), STATIC, LATE, np.zeros((1, 2))), degree=5
    ).displacement_m
    np.testing.assert_allclose(stiff, still, rtol=1e-5, atol=1e-5 * np.abs(still).max())
    s = spread(FWHM)
    force = 2 * math.pi * s**2 * (1 - math.exp(-0.5 * (0.06 / s) ** 2))
    oil = disc(base=Springs(0.0, 0.0, 5e4, 0.0))
    motion = solve_axisymmetric(SkinProblem(oil, STATIC, np.array([4.0]), np.zeros((1, 2))), degree=5)
    assert -motion.velocity_m_s[0, 0, 2] == pytest.approx(force / (5e4 * math.pi * 0.06**2), rel=1e-5)


def test_sheets():
    """Two halves of a sheet are the sheet; under even pressure rollers make columns, one on another."""
    soft = dataclasses.replace(ECOFLEX, name="soft", shear_relaxed_Pa=3e3, bulk_Pa=8e4, density_kg_m3=900.0)
    whole = solve_axisymmetric(SkinProblem(disc(), STATIC, LATE, np.zeros((1, 2))), degree=6).displacement_m
    halves = dataclasses.replace(disc(), sheets=(Sheet(ECOFLEX, 0.008), Sheet(ECOFLEX, 0.012)))
    np.testing.assert_allclose(
        solve_axisymmetric(SkinProblem(halves, STATIC, LATE, np.zeros((1, 2))), degree=6).displacement_m,
        whole,
        rtol=2e-4,
        atol=1e-12,
    )
    body = dataclasses.replace(disc(), sheets=(Sheet(ECOFLEX, 0.004), Sheet(soft, 0.006)))
    even = dataclasses.replace(STATIC, fwhm_m=100.0)
    motion = solve_axisymmetric(SkinProblem(body, even, np.array([5.0]), np.array([[0.0, 0.0], [0.05, 0.0]])), degree=5)
    column = sum(x.thickness_m / (x.material.bulk_Pa + 4 / 3 * x.material.shear_relaxed_Pa) for x in body.sheets)
    np.testing.assert_allclose(-motion.displacement_m[0, :, 2], column, rtol=1e-5)


def test_repeats_bit_by_bit_and_scales():
    t = np.linspace(0.0, 5e-3, 26)
    path = 0.005 * np.stack([np.cos(500 * t), np.sin(500 * t)], axis=1)
    spot = Spot(FWHM, t, np.ones(26), path)
    runs = [solve_axisymmetric(SkinProblem(disc(radius=0.03), s, t, path[:2]), degree=4) for s in (spot, spot)]
    np.testing.assert_array_equal(runs[0].displacement_m, runs[1].displacement_m)
    large = solve_axisymmetric(
        SkinProblem(disc(radius=0.03), dataclasses.replace(spot, peak_Pa=np.full(26, 1e3)), t, path[:2]), degree=4
    )
    np.testing.assert_allclose(large.displacement_m, 1e3 * runs[0].displacement_m, rtol=1e-9, atol=1e-16)


def test_load_starts_late_and_is_held():
    """Before its first time nothing moves; held values are steps, so a later copy is the same motion shifted."""
    at = np.zeros((1, 2))
    t = np.array([0.0, 1e-3, 3e-3])
    asked = np.linspace(0.0, 6e-3, 13)
    early = Spot(FWHM, t, np.array([1.0, -0.5, 2.0]), law="held")
    late = dataclasses.replace(early, times_s=t + 0.01)
    first = solve_axisymmetric(SkinProblem(disc(), early, asked, at), degree=4)
    second = solve_axisymmetric(SkinProblem(disc(), late, np.concatenate([[0.004], asked + 0.01]), at), degree=4)
    assert not second.displacement_m[0].any()
    np.testing.assert_allclose(
        second.displacement_m[1:], first.displacement_m, atol=1e-6 * np.abs(first.displacement_m).max()
    )


def test_samples_of_a_moving_spot():
    """The load between samples is linear to the asked share of its peak."""
    spot = Spot(0.01, np.array([0.0, 1.0]), np.array([1.0, 1.0]), np.array([[-0.02, 0.0], [0.02, 0.0]]))
    samples = sample(spot, np.array([0.5, 0.7]), 1e-3)
    assert samples.times_s[-1] == 0.7
    x = samples.distance_m * np.cos(samples.angle_rad)
    middle = 0.5 * (x[1:] + x[:-1])
    s = spread(0.01)
    between = np.exp(-0.5 * (middle / s) ** 2) - 0.5 * (
        np.exp(-0.5 * (x[1:] / s) ** 2) + np.exp(-0.5 * (x[:-1] / s) ** 2)
    )
    assert 2e-4 < np.abs(between).max() < 1e-3


def test_bad_input():
    endless = Slab((Sheet(ECOFLEX, 0.02),))
    points = np.zeros((1, 3))
    load = Traction(points, np.ones(1), np.array([0.0]), np.ones((1, 1)))
    for body, given, reason in (
        (endless, STATIC, "shape 'disc' only"),
        (disc(side="absorbing"), STATIC, "not absorbing"),
        (disc(), load, "Spot loads only"),
    ):
        assert reason in (refusal_axisymmetric(body, given) or "")
        with pytest.raises(SceneError, match=reason):
            solve_axisymmetric(SkinProblem(body, given, LATE, points))
        with pytest.raises(SceneError, match=reason):
            cost_axisymmetric(SkinProblem(body, given, LATE, points, 0.05))
    assert refusal_axisymmetric(disc(), STATIC) is None
    for times, at, keys, reason in (
        (np.array([1.0, 0.5]), points, {}, "rising"),
        (LATE, np.array([[0.07, 0.0]]), {}, "outside the slab, a disc of 0.06 m"),
        (LATE, np.zeros((1, 4)), {}, "finite positions"),
        (LATE, points, {"degree": 2}, "lock"),
    ):
        with pytest.raises(SceneError, match=reason):
            solve_axisymmetric(SkinProblem(disc(), STATIC, times, at), **keys)
    with pytest.raises(SceneError, match="accuracy"):
        solve_axisymmetric(SkinProblem(disc(), STATIC, LATE, points, 0.0))
