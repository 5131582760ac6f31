"""The stated error against the true one, over random discs, spots and bursts with an exact answer."""

import math

import numpy as np
import pytest

from palmfield.skin.materials.material import Branch, Material, Sheet, bulk_from_poisson
from palmfield.skin.problem import SkinProblem, Slab, Spot
from palmfield.skin.solvers.lateral_waves import solve_lateral_waves
from palmfield.skin.solvers.particles import solve_particles


def case(rng):
    """A roller disc of a damped material under a smooth burst: body, load, asked times and points."""
    width, depth = rng.uniform(6e-3, 14e-3), rng.uniform(4e-3, 20e-3)
    shear = rng.uniform(8e3, 3e4)
    branch = Branch(rng.uniform(0.5, 2.0) * shear, rng.uniform(2e-4, 1.5e-3))
    bulk = bulk_from_poisson(rng.choice([0.3, 0.45, 0.49, 0.495]), shear)
    material = Material("random", 1050.0, shear, (branch,), bulk, "")
    frequency, radius = rng.uniform(40.0, 250.0), 2.2 * width
    times = np.linspace(0.0, 2.0 / frequency, 201)
    pulse = 0.5 * (1.0 - np.cos(2.0 * math.pi * frequency * times))
    at = np.column_stack([np.array([0.0, 0.5, 1.0]) * width, np.zeros(3)])
    body = Slab((Sheet(material, depth),), "disc", "bonded", "roller", radius_m=radius)
    return body, Spot(width, times, pulse), np.linspace(0.0, 3.0 / frequency, 61)[1:], at


def ratio(seed):
    """Stated over true error, L2 over times, the worst point."""
    rng = np.random.default_rng(seed)
    body, load, times, at = case(rng)
    motion = solve_particles(SkinProblem(body, load, times, at, accuracy=rng.uniform(0.15, 0.4)))
    exact = solve_lateral_waves(SkinProblem(body, load, times, at, accuracy=1e-3)).displacement_m
    miss = np.linalg.norm(motion.displacement_m - exact, axis=(0, 2)) / np.linalg.norm(exact, axis=(0, 2))
    return motion.error / miss.max()


@pytest.mark.slow
def test_stated_error_covers_the_true_one():
    found = np.array([ratio(seed) for seed in range(20)])
    print(np.round(np.sort(found), 2))
    assert np.mean(found >= 1.0) >= 0.9
    assert np.median(found) <= 4.0
