"""A smaller bulk modulus: what it is said to change, by the exact layer at run time, is what other solvers see."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from palmfield.errors import SceneError
from palmfield.skin.approximation.reduce_bulk_modulus import RATIOS, SHARE, reduce_bulk_modulus, relative_change
from palmfield.skin.approximation.richardson import relative_difference
from palmfield.skin.base import Springs
from palmfield.skin.materials.catalogue import preset
from palmfield.skin.materials.material import Sheet, bulk_from_poisson
from palmfield.skin.problem import SkinProblem, Slab, Spot
from palmfield.skin.solvers.lateral_waves import solve_lateral_waves
from palmfield.types import Float

TIMES = np.linspace(0.0, 0.04, 321)
PUSH = Spot(0.0103, TIMES, np.sin(np.pi * TIMES / 0.04) ** 2 * (0.5 + 0.5 * np.cos(2.0 * np.pi * 150.0 * TIMES)))
AT = np.array([[0.0, 0.0], [0.008, 0.0]])


def endless(nu: float, depth_m: float) -> Slab:
    material = preset("palm")
    bulk = bulk_from_poisson(nu, material.shear_instant_Pa)
    return Slab((Sheet(replace(material, bulk_Pa=bulk), depth_m),))


@cache
def moved(nu: float, depth_m: float) -> Float:
    return solve_lateral_waves(SkinProblem(endless(nu, depth_m), PUSH, TIMES[1:], AT, accuracy=1e-3)).displacement_m


@pytest.mark.parametrize(("depth_m", "nu", "points"), [(0.012, 0.49, 2), (0.012, 0.497, 2), (0.004, 0.495, 1)])
def test_the_change_is_that_of_lateral_waves(depth_m: float, nu: float, points: int) -> None:
    """That layer compares normal motion: beside the spot of a thin layer, which moves along, it says too much."""
    hard, soft, at = endless(0.4999, depth_m), endless(nu, depth_m), AT[:points]
    said = relative_change(hard, PUSH, TIMES[-1], at)(soft.sheets[0].material)
    seen = relative_difference(moved(nu, depth_m)[:, :points], moved(0.4999, depth_m)[:, :points])
    print(depth_m, nu, "said", said, "seen", seen)
    assert 0.6 * said < seen < 1.5 * said


def test_the_softest_that_the_accuracy_allows_is_taken() -> None:
    body = endless(0.4999, 0.012)
    for accuracy in (0.2, 0.02):
        soft, change = reduce_bulk_modulus(body, PUSH, TIMES[-1], AT, accuracy, None)
        assert change <= SHARE * accuracy
        bulks = [bulk_from_poisson(nu, body.sheets[0].material.shear_instant_Pa) for nu in RATIOS]
        assert soft.sheets[0].material.bulk_Pa in bulks or soft is body
    assert reduce_bulk_modulus(body, PUSH, TIMES[-1], AT, 0.2, 0.5) == (body, 0.0)


def test_what_that_layer_does_not_know_is_refused_or_left() -> None:
    body = endless(0.4999, 0.012)
    two = Slab(body.sheets * 2)
    sprung = Slab(body.sheets, base=Springs(1e6, 1e6))
    for other in (two, sprung):
        assert reduce_bulk_modulus(other, PUSH, TIMES[-1], AT, 0.1, None) == (other, 0.0)
        with pytest.raises(SceneError, match="one sheet on a plain base"):
            reduce_bulk_modulus(other, PUSH, TIMES[-1], AT, 0.1, 0.49)
    thin = endless(0.4999, 0.001)
    with pytest.raises(SceneError, match=r"nu_at_most 0\.49 would change"):
        reduce_bulk_modulus(thin, PUSH, TIMES[-1], AT, 0.01, 0.49)
