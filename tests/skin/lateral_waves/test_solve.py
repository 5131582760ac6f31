"""Whole answers against integrals over frequency and harmonics of the exact layer, closed forms, and one another."""

import dataclasses

import numpy as np
import pytest
from scipy.special import jv

from palmfield.errors import SceneError
from palmfield.skin.analytic.layer_oracle import centre_response, layer_compliance
from palmfield.skin.base import Springs
from palmfield.skin.materials.catalogue import PRESETS
from palmfield.skin.materials.material import Material, Sheet, bulk_from_poisson
from palmfield.skin.problem import SkinProblem, Slab, Spot, Traction
from palmfield.skin.solvers.lateral_waves import (
    cost_lateral_waves,
    refusal_lateral_waves,
    solve_lateral_waves,
    static_lateral_waves,
)
from palmfield.skin.solvers.lateral_waves.resolution import relative_error

pytestmark = pytest.mark.numerics

ECOFLEX = PRESETS["ecoflex_00-10"]
WIDTH, DEPTH = 0.0103, 0.02
C0 = Slab((Sheet(ECOFLEX, DEPTH),))
DISC = Slab((Sheet(ECOFLEX, DEPTH),), shape="disc", side="roller", radius_m=0.06)
AT = np.array([[0.0, 0.0], [0.01, 0.0]])
STILL = Spot(WIDTH, np.zeros(1), np.ones(1), law="held")


def pulse(times, width=4e-3):
    """A raised cosine, 0 outside [0, width], with its transform's content below 1 kHz."""
    return np.where(times < width, 0.5 * (1.0 - np.cos(2.0 * np.pi * times / width)), 0.0)


@pytest.mark.parametrize(("body", "radius"), [(C0, None), (DISC, 0.06)])
def test_static_is_the_series(body, radius):
    exact = centre_response(0.0, ECOFLEX, DEPTH, WIDTH, radius, np.array([0.0, 0.01])).real
    found = static_lateral_waves(body, STILL, AT, accuracy=1e-3)
    np.testing.assert_allclose(-found.displacement_m[0, :, 2], exact, rtol=1e-3)
    settled = solve_lateral_waves(SkinProblem(body, STILL, np.array([1.0]), AT, accuracy=1e-2))
    np.testing.assert_allclose(-settled.displacement_m[0, :, 2], exact, rtol=1e-2)


@pytest.mark.nightly
@pytest.mark.parametrize(("body", "radius"), [(C0, None), (DISC, 0.06)])
def test_pulse_is_the_integral_over_frequency(body, radius):
    """u(t) = sum over a fine comb of frequencies of U(f) P(f); the comb's period is long enough for all to die out."""
    period, count = 0.25, 256
    times = np.arange(0.0, 0.05, 5e-4)
    comb = np.arange(count) / period
    grid = np.linspace(0.0, 4e-3, 4001)
    force = np.trapezoid(pulse(grid) * np.exp(2j * np.pi * comb[:, None] * grid), grid, axis=1)
    at = np.array([0.0, 0.01])
    moved = np.array([centre_response(f, ECOFLEX, DEPTH, WIDTH, radius, at) for f in comb]) * force[:, None]
    turned = np.exp(-2j * np.pi * np.outer(times, comb))
    weight = np.where(comb == 0.0, 1.0, 2.0) / period
    exact = (turned @ (weight[:, None] * moved)).real
    load_times = np.arange(0.0, 0.0045, 1e-5)
    found = solve_lateral_waves(SkinProblem(body, Spot(WIDTH, load_times, pulse(load_times)), times, AT, accuracy=2e-3))
    error = relative_error(-found.displacement_m[:, :, 2:], exact[:, :, None])
    print("error", error, "estimate", found.error)
    assert error < 2e-3


def test_circling_spot_is_its_harmonics():
    """After the start has died out, u is the sum over n of e^{-in(wt - angle)} times the integral of C(k, n w)
    g(k) J_n(kR) J_n(kr) k dk / 2 pi."""
    rate, radius, r = 70.0, 0.01, 0.013
    step = 1.0 / rate / 200
    path = np.arange(0, 1401) * step
    turn = 2.0 * np.pi * rate * path
    spot = Spot(WIDTH, path, np.ones(len(path)), radius * np.stack([np.cos(turn), np.sin(turn)], axis=1))
    asked = path[1200::10]
    found = solve_lateral_waves(SkinProblem(C0, spot, asked, np.array([[r, 0.0]]), accuracy=0.01))
    nodes, weights = np.polynomial.legendre.leggauss(400)
    k = 0.5 * 1500.0 * (1.0 + nodes)
    s = WIDTH / np.sqrt(8.0 * np.log(2.0))
    ring = 0.5 * 1500.0 * weights * k * s**2 * np.exp(-0.5 * (k * s) ** 2)
    exact = np.zeros(len(asked))
    for n in range(16):
        coefficient = np.sum(ring * layer_compliance(k, n * rate, ECOFLEX, DEPTH) * jv(n, k * radius) * jv(n, k * r))
        exact += (1.0 if n == 0 else 2.0) * (coefficient * np.exp(-1j * n * 2.0 * np.pi * rate * asked)).real
    error = relative_error(-found.displacement_m[:, :, 2:], exact[:, None, None])
    print("error", error, "estimate", found.error)
    assert error < 2e-3


def test_column_echoes():
    """A box under uniform pressure is a column: d'Alembert's triangle wave between 0 and twice the static push, for an
    elastic body, of period 4 h / c_p."""
    material = dataclasses.replace(ECOFLEX, branches=())
    modulus = material.bulk_Pa + 4.0 / 3.0 * material.shear_relaxed_Pa
    speed = np.sqrt(modulus / material.density_kg_m3)
    box = Slab((Sheet(material, DEPTH),), shape="box", side="roller", size_m=(0.02, 0.02))
    middle = (np.arange(8) + 0.5) / 8 * 0.02 - 0.01
    x, y = np.meshgrid(middle, middle)
    points = np.stack([x.ravel(), y.ravel(), np.zeros(64)], axis=1)
    load = Traction(points, np.full(64, 0.02**2 / 64), np.zeros(1), np.ones((1, 64)), "held")
    times = np.linspace(0.0, 9.0 * DEPTH / speed, 40)[1:]
    found = solve_lateral_waves(SkinProblem(box, load, times, np.zeros((1, 2))), tolerance=1e-4)
    phase = np.mod(times * speed / DEPTH, 4.0)
    exact = np.where(phase < 2.0, phase, 4.0 - phase) * DEPTH / modulus
    error = np.linalg.norm(-found.displacement_m[:, 0, 2] - exact) / np.linalg.norm(exact)
    print("error", error)
    assert error < 5e-3


def test_box_is_like_the_endless_slab_before_anything_comes_back():
    """Within 4 ms shear waves go 15 mm; the sides are 40 mm from the spot. nu 0.3, so that pressure waves are slow."""
    material = dataclasses.replace(ECOFLEX, bulk_Pa=bulk_from_poisson(0.3, 12.5e3))
    sheets = (Sheet(material, 0.01),)
    box = Slab(sheets, shape="box", side="roller", size_m=(0.08, 0.09))
    times = np.linspace(0.0, 4e-3, 9)[1:]
    spot = Spot(WIDTH, np.array([0.0, 2e-3]), np.array([0.0, 1.0]), np.array([[0.0, 0.0], [0.004, 0.002]]))
    at = np.array([[0.0, 0.0], [0.006, -0.003]])
    boxed = solve_lateral_waves(SkinProblem(box, spot, times, at), tolerance=1e-3)
    endless = solve_lateral_waves(SkinProblem(Slab(sheets), spot, times, at), tolerance=1e-3)
    error = relative_error(boxed.displacement_m, endless.displacement_m)
    print("error", error)
    assert error < 2e-3


@pytest.mark.nightly
def test_moving_waves_and_axial_waves_agree():
    """A spot that hops, each hop a hold, is a sum of spots at rest that go on and off: plane waves against J0, and the
    vector's components against -J1."""
    times = np.array([0.0, 3e-3, 6e-3])
    centres = np.array([[0.0, 0.0], [0.008, 0.003], [-0.004, 0.006]])
    asked = np.linspace(1e-3, 12e-3, 12)
    at = np.array([[0.002, 0.001], [0.015, -0.01]])
    whole = solve_lateral_waves(
        SkinProblem(C0, Spot(WIDTH, times, np.ones(3), centres, "held"), asked, at), tolerance=5e-3
    )
    parts = []
    for number, centre in enumerate(centres):
        on = np.zeros(3)
        on[number] = 1.0
        parts.append(
            solve_lateral_waves(SkinProblem(C0, Spot(WIDTH, times, on, centre, "held"), asked, at), tolerance=5e-3)
        )
    total = sum(part.displacement_m for part in parts)
    error = relative_error(whole.displacement_m, total)
    print("error", error)
    assert error < 1e-3


def test_traction_of_a_spot_is_the_spot():
    times = np.linspace(0.0, 4e-3, 41)
    middle = np.arange(-15, 16) * 1e-3
    x, y = np.meshgrid(middle, middle)
    points = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    shape = np.exp(-4.0 * np.log(2.0) * (points**2).sum(axis=1) / WIDTH**2)
    given = Traction(points, np.full(x.size, 1e-6), times, pulse(times)[:, None] * shape)
    asked = np.linspace(5e-4, 8e-3, 16)
    found = solve_lateral_waves(SkinProblem(C0, given, asked, AT, accuracy=0.01))
    spot = solve_lateral_waves(SkinProblem(C0, Spot(WIDTH, times, pulse(times)), asked, AT, accuracy=0.001))
    error = relative_error(found.displacement_m, spot.displacement_m)
    print("error", error, "estimate", found.error)
    assert error < 0.01


def test_reciprocity():
    """A spot here seen there is a spot there seen here; both sets of wavenumbers depend on the places alone."""
    times = np.linspace(0.0, 4e-3, 41)
    asked = np.linspace(1e-3, 9e-3, 9)
    here, there = np.array([0.004, -0.002]), np.array([-0.009, 0.007])
    one = solve_lateral_waves(
        SkinProblem(C0, Spot(WIDTH, times, pulse(times), here), asked, there[None]), tolerance=1e-3
    )
    other = solve_lateral_waves(
        SkinProblem(C0, Spot(WIDTH, times, pulse(times), there), asked, here[None]), tolerance=1e-3
    )
    np.testing.assert_allclose(one.displacement_m[..., 2], other.displacement_m[..., 2], rtol=1e-9)


def test_velocity_is_the_slope_of_the_displacement():
    times = np.linspace(0.0, 4e-3, 41)
    middle = np.linspace(1e-3, 9e-3, 9)
    step = 1e-6
    asked = np.sort(np.concatenate([middle - step, middle, middle + step]))
    found = solve_lateral_waves(SkinProblem(C0, Spot(WIDTH, times, pulse(times)), asked, AT), tolerance=1e-3)
    slope = (found.displacement_m[2::3] - found.displacement_m[0::3]) / (2.0 * step)
    assert relative_error(found.velocity_m_s[1::3], slope) < 1e-4


def test_thrust_sets_a_free_slab_in_motion():
    """Momentum: under a force F the whole of a free disc, rho h A, gains F t. The mean over the face moves as the whole
    does once the pressure wave between its faces has died out; what bends has no mean."""
    damped, thickness, radius = dataclasses.replace(ECOFLEX, bulk_relaxes=True), 0.01, 0.03
    slab = Slab((Sheet(damped, thickness),), shape="disc", side="roller", base="free", radius_m=radius)
    nodes, weights = np.polynomial.legendre.leggauss(30)
    r = 0.5 * radius * (1.0 + nodes)
    asked = np.linspace(0.05, 0.2, 4)
    found = solve_lateral_waves(SkinProblem(slab, STILL, asked, np.stack([r, 0.0 * r], axis=1)), tolerance=1e-4)
    mean = -found.velocity_m_s[:, :, 2] @ (weights * r) / radius
    force = 2.0 * np.pi * WIDTH**2 / (8.0 * np.log(2.0))
    expected = force * asked / (damped.density_kg_m3 * thickness * np.pi * radius**2)
    print(mean / expected - 1)
    np.testing.assert_allclose(mean, expected, rtol=1e-4)


@pytest.mark.nightly
def test_estimate_covers_the_true_error():
    """Ten cases, against the same solver at 5e-4: the estimate is above the error in all but one, never far above it.

    That is consistency; the accuracy of such runs is held by the exact layer above.
    """
    rng = np.random.default_rng(4)
    ratios = []
    for _ in range(10):
        shear, nu = 10 ** rng.uniform(3.7, 4.7), rng.uniform(0.3, 0.49)
        branch = ECOFLEX.branches if rng.random() < 0.5 else ()
        material = Material("some", 1000.0, shear, branch, bulk_from_poisson(nu, shear), "", rng.uniform(0.5, 3.0))
        slab = Slab((Sheet(material, rng.uniform(4e-3, 2e-2)),), base=str(rng.choice(["bonded", "free_slip"])))
        times = np.linspace(0.0, 5e-3, 51)
        spot = Spot(rng.uniform(5e-3, 1.2e-2), times, pulse(times, rng.uniform(1e-3, 5e-3)))
        asked, at = np.linspace(5e-4, 1e-2, 20), rng.uniform(-0.015, 0.015, (2, 2))
        found = solve_lateral_waves(SkinProblem(slab, spot, asked, at, accuracy=0.05))
        exact = solve_lateral_waves(SkinProblem(slab, spot, asked, at), tolerance=5e-4)
        ratios.append(found.error / relative_error(found.displacement_m, exact.displacement_m))
        assert found.error <= 0.05
    print(np.round(ratios, 2))
    assert np.sum(np.array(ratios) >= 1.0) >= 9
    assert np.median(ratios) <= 4.0


def test_runs_are_alike_to_the_last_bit():
    times = np.linspace(0.0, 4e-3, 9)
    spot = Spot(WIDTH, times, np.ones(9), np.linspace([0.0, 0.0], [0.01, 0.0], 9))
    one, other = (solve_lateral_waves(SkinProblem(C0, spot, times, AT), tolerance=0.01) for _ in range(2))
    assert np.array_equal(one.displacement_m, other.displacement_m)
    assert np.array_equal(one.velocity_m_s, other.velocity_m_s)


def test_scaling_and_silence():
    times = np.linspace(0.0, 4e-3, 9)
    one = solve_lateral_waves(SkinProblem(C0, Spot(WIDTH, times, pulse(times)), times, AT), tolerance=0.01)
    many = solve_lateral_waves(SkinProblem(C0, Spot(WIDTH, times, 1000.0 * pulse(times)), times, AT), tolerance=0.01)
    np.testing.assert_allclose(many.displacement_m, 1000.0 * one.displacement_m, rtol=1e-12, atol=0.0)
    silent = solve_lateral_waves(SkinProblem(C0, Spot(WIDTH, times + 1.0, pulse(times)), times, AT))
    assert not silent.displacement_m.any()
    assert silent.error == 0.0


def test_refusals():
    fixed = dataclasses.replace(DISC, side="fixed")
    assert "roller" in str(refusal_lateral_waves(fixed, STILL))
    assert refusal_lateral_waves(DISC, STILL) is None
    assert "centre" in str(refusal_lateral_waves(DISC, dataclasses.replace(STILL, centre_m=np.array([0.01, 0.0]))))
    box = Slab((Sheet(ECOFLEX, DEPTH),), shape="box", side="roller", size_m=(0.03, 0.03))
    assert "0.015 m of a side" in str(refusal_lateral_waves(box, STILL))
    with pytest.raises(SceneError, match="roller"):
        solve_lateral_waves(SkinProblem(fixed, STILL, np.ones(1), AT))
    with pytest.raises(SceneError, match="outside the slab, a disc"):
        solve_lateral_waves(SkinProblem(DISC, STILL, np.ones(1), np.array([[0.1, 0.0]])))
    with pytest.raises(SceneError, match="accuracy is 2"):
        solve_lateral_waves(SkinProblem(C0, STILL, np.ones(1), AT, accuracy=2.0))
    with pytest.raises(SceneError, match="tolerance is 0"):
        solve_lateral_waves(SkinProblem(C0, STILL, np.ones(1), AT), tolerance=0.0)
    with pytest.raises(SceneError, match="rising"):
        solve_lateral_waves(SkinProblem(C0, STILL, np.array([1.0, 0.5]), AT))
    for base in ("free", Springs(0.0, 1e5)):
        with pytest.raises(SceneError, match="no static solution"):
            static_lateral_waves(dataclasses.replace(C0, base=base), STILL, AT)


def test_cost_rises_with_what_is_asked():
    times = np.linspace(0.0, 0.1, 1001)
    still = Spot(WIDTH, times, pulse(times))
    moving = dataclasses.replace(still, centre_m=np.linspace([0.0, 0.0], [0.05, 0.0], 1001))
    rough = cost_lateral_waves(SkinProblem(C0, still, times, AT, 0.05))
    assert cost_lateral_waves(SkinProblem(C0, still, times, AT, 0.001)) > rough
    assert cost_lateral_waves(SkinProblem(C0, moving, times, AT, 0.05)) > rough
