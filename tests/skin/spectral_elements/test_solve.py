"""Solver spectral_elements as a whole, against the exact layer."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from palmfield.errors import SceneError
from palmfield.skin.analytic.layer_oracle import centre_response
from palmfield.skin.base import Foundation
from palmfield.skin.materials.catalogue import preset
from palmfield.skin.materials.material import Branch, Material, Sheet, bulk_from_poisson
from palmfield.skin.problem import ONLY_WEDGES, Layer, SkinProblem, Slab, Spot
from palmfield.skin.solvers.spectral_elements.mesh import build, plan
from palmfield.skin.solvers.spectral_elements.model import SAFETY
from palmfield.skin.solvers.spectral_elements.solve import (
    cost_spectral_elements,
    finer_spectral_elements,
    likely_step,
    prepared,
    refusal_spectral_elements,
    solve_spectral_elements,
)
from palmfield.types import Patch

SPOT, DEPTH, RADIUS = 0.0103, 0.02, 0.06
PLACES = np.array([[0.0, 0.0], [0.01, 0.0]])
ECOFLEX = preset("ecoflex_00-10")
MATERIALS = {
    "one branch": ECOFLEX,
    "dashpot": Material("voigt", 1030.0, 15e3, (), bulk_from_poisson(0.49, 15e3), "test", viscosity_Pa_s=4.0),
    "three branches": Material(
        "prony", 1050.0, 12e3, (Branch(8e3, 3e-3), Branch(10e3, 4e-4), Branch(5e3, 2e-6)), 1.2e6, "test"
    ),
    "bulk follows": replace(ECOFLEX, bulk_Pa=bulk_from_poisson(0.49, 12.5e3), bulk_relaxes=True),
}


def burst(times):
    """A push of 8 ms that carries 200 Hz, smooth at both ends."""
    inside = np.clip(times / 0.008, 0.0, 1.0)
    return 0.5 * (1.0 - np.cos(2.0 * np.pi * inside)) * (1.0 + 0.5 * np.sin(2.0 * np.pi * 200.0 * times))


@cache
def series(material, radius, places=(0.0, 0.01)):
    """Times, and displacement into the layer by the exact frequency response up to 1000 Hz, where the burst has 5e-4.

    Its period is long enough to forget the one before.
    """
    period, top = 0.16, 1000.0
    count = 4096
    grid = np.arange(count) * period / count
    spectrum = np.fft.rfft(burst(grid))
    responses = np.zeros((len(spectrum), len(places)), dtype=complex)
    for index in range(round(top * period)):
        responses[index] = centre_response(index / period, material, DEPTH, SPOT, radius, np.array(places)).conj()
    return grid, np.fft.irfft(spectrum[:, None] * responses, n=count, axis=0)


def exact(material, times, radius):
    grid, moved = series(material, radius)
    return np.stack([np.interp(times, grid, column) for column in moved.T], axis=1)


def pressed(times=0.012):
    grid = np.arange(0.0, times, 5e-5)
    return Spot(SPOT, grid, burst(grid))


def relative(found, wanted):
    return np.linalg.norm(found - wanted, axis=0) / np.linalg.norm(wanted, axis=0)


@pytest.mark.parametrize("name", MATERIALS)
def test_disc_with_rollers_follows_the_exact_series(name):
    """Centre and a place 10 mm off within what was asked, and the estimate of the error holds."""
    material = MATERIALS[name]
    body = Slab((Sheet(material, DEPTH),), "disc", "bonded", "roller", radius_m=RADIUS)
    times = np.linspace(0.0005, 0.015, 60)
    motion = solve_spectral_elements(SkinProblem(body, pressed(), times, PLACES, accuracy=0.03))
    wanted = exact(material, times, RADIUS)
    assert relative(-motion.displacement_m[:, :, 2], wanted).max() < 0.03
    total = np.linalg.norm(-motion.displacement_m[:, :, 2] - wanted) / np.linalg.norm(wanted)
    assert total < motion.error < 0.05
    slope = np.gradient(-motion.displacement_m[:, :, 2], times, axis=0)[1:-1]
    assert relative(-motion.velocity_m_s[1:-1, :, 2], slope).max() < 0.03


def test_endless_slab_follows_the_exact_integral():
    """What the sponge sends back stays below 1 % at 10 mm."""
    times = np.linspace(0.0005, 0.03, 90)
    motion = solve_spectral_elements(
        SkinProblem(Slab((Sheet(ECOFLEX, DEPTH),)), pressed(), times, PLACES, accuracy=0.03)
    )
    wanted = exact(ECOFLEX, times, None)
    assert relative(-motion.displacement_m[:, :, 2], wanted).max() < 0.015
    assert motion.error > np.linalg.norm(-motion.displacement_m[:, :, 2] - wanted) / np.linalg.norm(wanted)


def test_sides_that_absorb_do_as_no_sides():
    times = np.linspace(0.0005, 0.02, 60)
    body = Slab((Sheet(ECOFLEX, DEPTH),), "box", "bonded", "absorbing", size_m=(0.1, 0.08))
    motion = solve_spectral_elements(SkinProblem(body, pressed(), times, PLACES, accuracy=0.05), estimate=False)
    assert np.isnan(motion.error)
    assert relative(-motion.displacement_m[:, :, 2], exact(ECOFLEX, times, None)).max() < 0.02


def disc_of_triangles(place=(0.0, 0.0, 0.0)):
    """Rings of triangles, 30 mm across."""
    vertices, faces = [[0.0, 0.0, 0.0]], []
    rings, around = 4, 16
    for ring in range(1, rings + 1):
        angle = 2.0 * np.pi * np.arange(around) / around
        vertices += list(0.03 * ring / rings * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(around)]))
    for k in range(around):
        after = (k + 1) % around
        faces.append([0, 1 + k, 1 + after])
        for ring in range(rings - 1):
            low, high = 1 + around * ring, 1 + around * (ring + 1)
            faces += [[low + k, high + k, high + after], [low + k, high + after, low + after]]
    points = np.array(vertices) + np.array(place)
    count = len(points)
    rim = np.arange(count) > around * (rings - 1)
    down = np.tile([0.0, 0.0, -1.0], (count, 1))
    return Patch(points, np.array(faces, dtype=np.int32), down, np.full(count, DEPTH), rim, np.array([0.0, 0.0, 1.0]))


def test_a_patch_of_triangles_moves_like_the_disc():
    times = np.linspace(0.0005, 0.01, 30)
    patch = Layer(disc_of_triangles(), (Sheet(ECOFLEX, DEPTH),), "bonded", "roller")
    disc = Slab((Sheet(ECOFLEX, DEPTH),), "disc", "bonded", "roller", radius_m=0.03)
    at = np.column_stack([PLACES, np.zeros(2)])
    found = solve_spectral_elements(SkinProblem(patch, pressed(), times, at), order=3, estimate=False)
    wanted = solve_spectral_elements(SkinProblem(disc, pressed(), times, at, accuracy=0.01), estimate=False)
    # 16 straight sides hold 2.6 % less than the circle
    assert relative(found.displacement_m[:, :, 2], wanted.displacement_m[:, :, 2]).max() < 0.02


def test_far_from_the_origin_single_precision_keeps_its_digits():
    times = np.linspace(0.0005, 0.006, 20)
    motions = []
    for place in ((0.0, 0.0, 0.0), (0.2, -0.2, 0.2)):
        body = Layer(disc_of_triangles(place), (Sheet(ECOFLEX, DEPTH),), "bonded", "fixed")
        grid = np.arange(0.0, 0.007, 5e-5)
        load = Spot(SPOT, grid, burst(grid), np.array(place[:2]))
        at = np.column_stack([PLACES, np.zeros(2)]) + np.array(place)
        motions.append(
            solve_spectral_elements(SkinProblem(body, load, times, at), order=2, estimate=False).displacement_m
        )
    assert np.linalg.norm(motions[0] - motions[1]) < 2e-5 * np.linalg.norm(motions[0])


def test_repeats_are_identical_and_a_thousandfold_load_moves_a_thousand_times_as_much():
    times = np.linspace(0.0005, 0.006, 20)
    body = Slab((Sheet(ECOFLEX, DEPTH),), "disc", "bonded", "free", radius_m=RADIUS)
    load = pressed()
    first, again = (solve_spectral_elements(SkinProblem(body, load, times, PLACES), estimate=False) for _ in range(2))
    assert np.array_equal(first.displacement_m, again.displacement_m)
    assert np.array_equal(first.velocity_m_s, again.velocity_m_s)
    strong = solve_spectral_elements(
        SkinProblem(body, replace(load, peak_Pa=1000.0 * load.peak_Pa), times, PLACES), estimate=False
    )
    gap = np.linalg.norm(strong.displacement_m - 1000.0 * first.displacement_m)
    assert gap < 1e-5 * np.linalg.norm(strong.displacement_m)


def test_before_the_load_everything_rests():
    grid = np.array([0.002, 0.003])
    body = Slab((Sheet(ECOFLEX, DEPTH),), "disc", "bonded", "fixed", radius_m=RADIUS)
    motion = solve_spectral_elements(
        SkinProblem(body, Spot(SPOT, grid, np.ones(2)), np.array([0.0, 0.001, 0.0025]), PLACES)
    )
    assert not motion.displacement_m[:2].any() and not motion.velocity_m_s[:2].any()
    assert motion.displacement_m[2, 0, 2] < 0.0


def test_what_it_cannot_take():
    stiff = Material("stiff", 1000.0, 1e4, (), 2e9, "test")
    body = Slab((Sheet(stiff, 0.01),))
    load, times = pressed(), np.array([0.001])
    reason = refusal_spectral_elements(body, load)
    assert reason is not None and "bulk modulus of 2e+05 times its shear modulus" in reason
    with pytest.raises(SceneError, match="bulk modulus of 2e"):
        solve_spectral_elements(SkinProblem(body, load, times, PLACES))
    assert refusal_spectral_elements(Slab((Sheet(ECOFLEX, 0.01),)), load) is None
    disc = Slab((Sheet(ECOFLEX, DEPTH),), "disc", "bonded", "fixed", radius_m=RADIUS)
    for arguments, message in (
        ({"times": np.array([0.002, 0.001])}, "must be finite, rising"),
        ({"order": 0}, "order is 0"),
        ({"deep": (0,)}, "deep is"),
        ({"deep": (2, 2)}, "deep is"),
        ({"precision": "half"}, "precision is 'half'"),
        ({"step_s": 1e-3}, "step_s is 0.001 s; allowed: above 0, at most the stable step"),
        ({"at": np.array([[0.5, 0.0]])}, "from the face"),
    ):
        given = {"times": times, "at": PLACES} | arguments
        with pytest.raises(SceneError, match=message):
            solve_spectral_elements(
                SkinProblem(disc, load, given.pop("times"), given.pop("at")), estimate=False, **given
            )


def test_a_softer_bulk_is_used_only_where_it_changes_little():
    """2 mm bonded to bone: 0.495 moves far more than 0.4999; 20 mm: within a few percent."""
    tissue = Material("tissue", 1100.0, 2e4, (Branch(1e4, 1e-3),), bulk_from_poisson(0.4999, 3e4), "test")
    times = np.linspace(0.0005, 0.004, 8)
    with pytest.raises(SceneError, match=r"nu_at_most 0\.495 would change"):
        solve_spectral_elements(SkinProblem(Slab((Sheet(tissue, 0.002),)), pressed(), times, PLACES), nu_at_most=0.495)
    disc = Slab((Sheet(tissue, DEPTH),), "disc", "bonded", "fixed", radius_m=0.03)
    motion = solve_spectral_elements(SkinProblem(disc, pressed(0.005), times, PLACES), nu_at_most=0.495)
    assert "for a bulk modulus of 2.99e+06 Pa" in motion.error_source


@pytest.mark.parametrize("viscosity", [0.0, 50.0])
def test_the_step_of_a_cost_is_the_one_that_is_taken(viscosity):
    # With 50 Pa s the dashpot makes the step 10 times as short
    soft = Material("kelvin_voigt", 1000.0, 20e3, (), bulk_from_poisson(0.49, 20e3), "test", viscosity)
    body = Slab((Sheet(soft, 0.005),), "disc", "bonded", "roller", radius_m=0.02)
    made = prepared(body, plan(body, pressed(), PLACES, 0.05), "cpu", "float32")
    likely = likely_step(made[0].solid, body.sheets)
    assert 0.9 < likely / (SAFETY * made[2]) < 1.7


def test_cost_grows_with_what_is_asked():
    body = Slab((Sheet(ECOFLEX, DEPTH),), "disc", "bonded", "fixed", radius_m=RADIUS)
    asked = ((0.2, 0.05), (0.4, 0.05), (0.2, 0.005))
    costs = [cost_spectral_elements(SkinProblem(body, pressed(), np.array([t]), PLACES, a)) for t, a in asked]
    assert costs[1] == pytest.approx(2.0 * costs[0], rel=0.1)
    assert costs[2] > 3.0 * costs[0]


@pytest.mark.parametrize("layer", [False, True])
def test_elements_that_missed_give_way_to_as_many_more_as_the_miss_needs(layer):
    """They were the same ones again, or had ten times the cost."""
    sheets = (Sheet(ECOFLEX, DEPTH),)
    slab = Slab(sheets, "disc", "bonded", "fixed", radius_m=0.03)
    body = Layer(disc_of_triangles(), sheets, "bonded", "fixed") if layer else slab

    def nodes(**given):
        return len(build(body, plan(body, pressed(), PLACES, 0.1, **given))[0].nodes)

    problem = SkinProblem(body, pressed(), np.array([0.2]), PLACES, 0.1)
    first = nodes()
    second = finer_spectral_elements(problem, 1.05)
    assert 1.19 * first < nodes(**second) < 3.0 * first
    third = finer_spectral_elements(problem, 1.05, **second)
    assert nodes(**third) > 1.19 * nodes(**second)
    # With the error by nodes^-1.5, 0.8 of the target
    assert nodes(**finer_spectral_elements(problem, 4.0)) > (4.0 / 0.8) ** (2.0 / 3.0) * first


def test_a_run_of_hours_is_refused_with_the_element_to_blame():
    body = Slab((Sheet(ECOFLEX, 1e-4),), "disc", "bonded", "fixed", radius_m=RADIUS)
    with pytest.raises(SceneError, match=r"would take about .* s; allowed: 3600 s; the smallest element is near \("):
        solve_spectral_elements(SkinProblem(body, pressed(), np.array([1000.0]), PLACES), size_m=0.01, estimate=False)
    mixed = Layer(disc_of_triangles(), (Sheet(ECOFLEX, DEPTH),), Foundation((Sheet(ECOFLEX, DEPTH),)), "fixed")
    assert refusal_spectral_elements(mixed, pressed()) == ONLY_WEDGES
