"""Case 6, motion of nanometres 0.2 m from the origin: the load times 1000 moves 1000 times as far, to 1e-5."""

import dataclasses

import numpy as np
import pytest

from palmfield.skin.materials.material import Branch, Material, Sheet, bulk_from_poisson
from palmfield.skin.mesh.disc import disc_patch
from palmfield.skin.problem import Layer, Slab, Spot

GEL = Material("gel", 1030.0, 12.5e3, (Branch(25e3, 1e-3),), bulk_from_poisson(0.45, 12.5e3), "")
TIMES = np.linspace(1e-3, 5e-3, 5)
FAR = np.array([0.2, -0.2, 0.2])


def push(peak, centre=(0.0, 0.0)):
    return Spot(0.0103, np.array([0.0, 2e-3]), np.array([0.0, peak]), np.array(centre))


def body(name):
    """Layers far from the origin; a disc's axis is the origin of its frame, an endless slab has its spot far off."""
    sheet = (Sheet(GEL, 0.008),)
    if name == "lateral_waves":
        return Slab(sheet), FAR[:2], FAR[None, :2]
    if name == "axisymmetric":
        return Slab(sheet, "disc", "bonded", "fixed", 0.02), np.zeros(2), np.zeros((1, 2))
    patch = disc_patch(0.02, 0.008, 0.006, 0.006, 0.02)
    moved = dataclasses.replace(patch, vertices=patch.vertices + FAR)
    return Layer(moved, sheet, "bonded", "fixed"), FAR[:2], FAR[None]


@pytest.mark.parametrize(
    "name", ["lateral_waves", "axisymmetric", "wedges", "reduced", "spectral_elements", "particles"]
)
def test_a_thousandfold_load_moves_a_thousand_times_as_far(name, solve_by, sizes_like):
    """1e-5 and 1e-2 Pa: some 0.1 and 100 pm, for the particles within what their strain may be to stay linear."""
    where, centre, at = body(name)
    how = {"sizes": sizes_like(refinements=0)} if name in ("wedges", "reduced") else {}
    if name == "axisymmetric":
        how = {"degree": 4}
    if name == "spectral_elements":
        how = {"order": 2, "size_m": None}
    small, large = (solve_by(name, where, push(peak, centre), TIMES, at, **how).displacement_m for peak in (1e-5, 1e-2))
    gap = np.linalg.norm(large - 1e3 * small) / np.linalg.norm(large)
    print(name, gap, np.abs(large).max())
    assert gap < 1e-5


@pytest.mark.parametrize("name", ["wedges", "spectral_elements", "particles"])
def test_far_off_is_as_near(name, solve_by, sizes_like):
    """The same layer at the origin and 0.35 m from it."""
    how = {"wedges": {"sizes": sizes_like(refinements=0)}, "spectral_elements": {"order": 2, "size_m": None}}.get(
        name, {}
    )
    far, centre, at = body(name)
    near = dataclasses.replace(far, patch=dataclasses.replace(far.patch, vertices=far.patch.vertices - FAR))
    here = solve_by(name, near, push(1e-2), TIMES, at - FAR, **how).displacement_m
    there = solve_by(name, far, push(1e-2, centre), TIMES, at, **how).displacement_m
    print(name, np.linalg.norm(here - there) / np.linalg.norm(here))
    assert np.linalg.norm(here - there) < 2e-5 * np.linalg.norm(here)
