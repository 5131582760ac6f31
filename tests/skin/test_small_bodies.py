"""Estimates on bodies smaller than the spot, held against the harmonics of a disc."""

import numpy as np
import pytest

from palmfield.skin import Sheet, Slab, Spot, preset, solve
from palmfield.skin.materials.material import Material


def true_and_stated(body: Slab, load: Spot, duration: float, solver: str, accuracy: float) -> tuple[float, float]:
    times, middle = np.linspace(0.0, duration, 25)[1:], [[0.0, 0.0]]
    known = solve(body, load, times, middle, solver="axisymmetric", accuracy=0.003, device="cpu").displacement_m
    found = solve(body, load, times, middle, solver=solver, accuracy=accuracy, device="cpu")
    return float(np.linalg.norm(found.displacement_m - known) / np.linalg.norm(known)), found.error


@pytest.mark.parametrize("solver", ["wedges", "reduced"])
def test_meshes_of_almost_the_same_triangles_do_not_pass_for_two(solver) -> None:
    """On a disc of five edges the meshes that tell the error had 41 and 43 triangles."""
    body = Slab((Sheet(preset("gelatin_2"), 0.003835),), "disc", "free_slip", "roller", 0.004849)
    load = Spot(0.006323, [0.0, 0.002135], [0.0, 1.0])
    true, stated = true_and_stated(body, load, 0.004077, solver, 0.046)
    assert stated >= true


def test_a_load_of_few_steps_does_not_hide_what_they_cost() -> None:
    """A ramp as short as the wanted accuracy's step: two steps' difference over 3 told 0.6 of the error."""
    body = Slab((Sheet(preset("gelatin_2"), 0.005076),), "disc", "bonded", "fixed", 0.008728)
    load = Spot(0.00931, [0.0, 0.001978], [0.0, 1.0])
    true, stated = true_and_stated(body, load, 0.004124, "wedges", 0.146)
    assert stated >= true


def test_a_column_is_resolved_by_its_width_where_that_is_less_than_its_depth() -> None:
    """Sides hold within a radius of 2.9 mm what elements of the depth, 7.7 mm, don't see."""
    soft = Material("made up", 1051.7, 16785.0, (), 8826200.0, "drawn at random", viscosity_Pa_s=0.983)
    body = Slab((Sheet(soft, 0.007685),), "disc", "free_slip", "fixed", 0.002889)
    load = Spot(0.00735, [0.0, 0.001419], [0.0, 1.0])
    true, stated = true_and_stated(body, load, 0.004797, "spectral_elements", 0.074)
    assert stated >= true
