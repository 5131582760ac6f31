"""Leaving out of a layer what load and points do not notice."""

import numpy as np
import pytest

from palmfield.skin.approximation.bands import bands, resonance
from palmfield.skin.approximation.truncate_domain import SHARE, part_of, reach, truncate_domain
from palmfield.skin.base import Springs
from palmfield.skin.materials.catalogue import preset
from palmfield.skin.materials.material import Sheet, elastic
from palmfield.skin.mesh.disc import disc_patch
from palmfield.skin.problem import Layer, SkinProblem, Slab, Spot, Traction, spread
from palmfield.skin.solvers.axisymmetric.solve import solve_axisymmetric

GRID = np.arange(0.0, 0.03, 5e-5)


def modulated(f_Hz: float, width: float = 0.0103) -> Spot:
    return Spot(width, GRID, 0.5 * (1.0 + np.sin(2.0 * np.pi * f_Hz * GRID)))


def flat(name: str, thickness: float, radius: float = 0.04) -> Layer:
    patch = disc_patch(radius, thickness, 0.004, 0.004, radius)
    return Layer(patch, (Sheet(preset(name), thickness),))


@pytest.mark.parametrize(
    ("name", "thickness", "width", "f_Hz"),
    [("finger_pad", 0.002, 0.0103, 200.0), ("finger_pad", 0.002, 0.006, 200.0), ("ecoflex_00-10", 0.004, 0.0103, 90.0)],
)
def test_a_fixed_edge_at_the_reach_changes_no_more_than_is_said(name: str, thickness: float, width: float, f_Hz: float):
    load = modulated(f_Hz, width)
    found = reach(flat(name, thickness), load, GRID[-1], 0.1)
    assert found is not None
    radius, change = found
    assert change <= SHARE * 0.1
    at = np.array([[0.0, 0.0], [0.5 * width, 0.0]])
    near, far = (
        solve_axisymmetric(
            SkinProblem(
                Slab((Sheet(preset(name), thickness),), "disc", "bonded", "fixed", radius_m=r),
                load,
                GRID[1:],
                at,
                accuracy=0.02,
            )
        ).displacement_m
        for r in (radius, 2.5 * radius)
    )
    moved = np.linalg.norm(near - far, axis=(0, 2)) / np.linalg.norm(far, axis=(0, 2))
    assert moved.max() < change


def test_waves_that_the_layer_guides_need_far_more() -> None:
    still, quick = flat("palm", 0.003), modulated(100.0)
    assert reach(flat("finger_pad", 0.003), quick, GRID[-1], 0.1)[0] < 0.5 * reach(still, quick, GRID[-1], 0.1)[0]


def test_what_is_kept_is_round_the_path_and_the_points() -> None:
    body = flat("finger_pad", 0.002)
    load = modulated(200.0, 0.006)
    part, same, change = truncate_domain(body, load, GRID[-1], np.array([[0.0, 0.0, 0.0]]), 0.1)
    assert same is load and 0.0 < change <= SHARE * 0.1
    radius = reach(body, load, GRID[-1], 0.1)[0]
    away = np.hypot(*part.patch.vertices[:, :2].T)
    assert len(part.patch.faces) < 0.5 * len(body.patch.faces)
    assert radius < away[part.patch.rim].min() + 0.004 and away.max() < radius + 0.008
    wide, _, _ = truncate_domain(body, load, GRID[-1], np.array([[0.03, 0.0, 0.0]]), 0.1)
    across = wide.patch.vertices[np.abs(wide.patch.vertices[:, 1]) < 0.004]
    assert across[:, 0].max() > 0.035 and across[:, 0].min() < -0.012
    # No gap on the way to a point far off
    assert np.diff(np.sort(across[:, 0])).max() < 0.004


def test_points_without_pressure_go_with_what_they_lie_on() -> None:
    body = flat("finger_pad", 0.002)
    points = body.patch.vertices
    pressure = np.exp(-((np.hypot(*points[:, :2].T) / 0.004) ** 2))
    pressure[pressure < 1e-3] = 0.0
    load = Traction(points, np.full(len(points), 1e-5), GRID, np.outer(np.sin(400.0 * np.pi * GRID), pressure))
    part, cut, change = truncate_domain(body, load, GRID[-1], np.zeros((1, 2)), 0.1)
    assert change > 0.0 and len(part.patch.faces) < len(body.patch.faces)
    # Those that bound the pressure stay, or it would be linear over the gap
    assert np.count_nonzero(pressure) < len(cut.points) < len(points)
    assert cut.pressure_Pa.any(axis=0).sum() == np.count_nonzero(pressure)
    assert truncate_domain(flat("palm", 0.003), load, GRID[-1], np.zeros((1, 2)), 0.001)[1] is load


def test_parts_that_hang_together_by_nothing_stay_whole() -> None:
    body = flat("finger_pad", 0.002)
    points = np.array([[-0.03, 0.0, 0.0], [0.03, 0.0, 0.0]])
    load = Traction(points, np.full(2, 1e-5), GRID, np.outer(np.sin(400.0 * np.pi * GRID), np.ones(2)))
    same, _, change = truncate_domain(body, load, GRID[-1], points, 0.1)
    assert same is body and change == 0.0


def test_a_load_that_never_presses_leaves_all_as_it_is() -> None:
    body, none = flat("finger_pad", 0.002), Spot(0.0103, GRID, np.zeros_like(GRID))
    assert truncate_domain(body, none, GRID[-1], np.zeros((1, 2)), 0.1) == (body, none, 0.0)


def test_the_rim_of_a_part_is_its_outline() -> None:
    patch = disc_patch(0.02, 0.002, 0.004, 0.004, 0.02)
    kept = np.hypot(*patch.vertices[patch.faces].mean(axis=1)[:, :2].T) < 0.012
    part = part_of(patch, kept)
    assert part.faces.max() + 1 == len(part.vertices) and len(part.faces) == kept.sum()
    assert np.hypot(*part.vertices[part.rim, :2].T).min() > 0.008
    whole = part_of(patch, np.ones(len(patch.faces), dtype=bool))
    assert np.array_equal(whole.rim, patch.rim)


def test_bodies_that_stay_whole() -> None:
    load, at = modulated(200.0), np.zeros((1, 2))
    layer = flat("finger_pad", 0.002)
    endless = Slab(layer.sheets)
    on_springs = Layer(layer.patch, layer.sheets, Springs(1e6, 1e6))
    lossless = Layer(layer.patch, (Sheet(elastic("glass", 1000.0, 1e4, 0.49), 0.002),))
    for body in (endless, on_springs, lossless):
        assert truncate_domain(body, load, GRID[-1], at, 0.1) == (body, load, 0.0)


def test_bands_hold_the_energy_of_the_course() -> None:
    times = np.arange(0.0, 1.0, 2e-4)
    load = Spot(0.0103, times, 0.5 * (1.0 + np.sin(2.0 * np.pi * 200.0 * times)))
    frequencies, energies = bands(load, 1.0, resonance(preset("finger_pad"), 0.002))
    assert np.all(np.diff(frequencies) > 0.0) and frequencies[0] == 0.0
    # A mean of 1/2 and an amplitude of 1/2: a third of the square is the modulation's
    assert energies[frequencies > 100.0].sum() / energies.sum() == pytest.approx(1.0 / 3.0, rel=0.03)
    passing = Spot(0.006, [0.0, 0.02], [1.0, 1.0], [[-0.08, 0.0], [0.08, 0.0]])
    # At 8 m/s the pressure is exp(-t^2 / 2 T^2): half of its energy lies below erf(2 pi f T) = 1/2
    middle = 0.4769 / (2.0 * np.pi * spread(0.006) / 8.0)
    rates, weights = bands(passing, 0.02, middle / 1.075)
    below = (np.cumsum(weights) - 0.5 * weights) / weights.sum()
    assert float(np.interp(0.5, below, rates)) == pytest.approx(middle, rel=0.05)
