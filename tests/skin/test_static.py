"""Rest under a held load: the same call for every body, true to what it states."""

import dataclasses

import numpy as np
import pytest

from palmfield.errors import SceneError
from palmfield.skin import Sheet, Slab, Spot, Springs, preset, solve, static
from palmfield.skin.analytic.layer_oracle import centre_response
from palmfield.skin.solvers.axisymmetric.solve import static_axisymmetric
from palmfield.skin.solvers.wedges import static_wedges

GEL = preset("ecoflex_00-10")
GRID = np.stack(np.meshgrid(*2 * [np.linspace(-0.04, 0.04, 9)]), axis=-1).reshape(-1, 2)
HELD = Spot(0.0103, [0.0], [1.0], law="held")


def disc(side: str, **changes) -> Slab:
    return dataclasses.replace(Slab((Sheet(GEL, 0.02),), shape="disc", side=side, radius_m=0.06), **changes)


def test_a_disc_is_solved_by_its_harmonics_within_what_they_state() -> None:
    """81 points took wedges minutes, which stated half of their error."""
    motion = static(disc("fixed"), HELD, GRID, accuracy=0.01)
    assert motion.solver.startswith("axisymmetric, static") and motion.error <= 0.01
    known = static_axisymmetric(disc("fixed"), HELD, GRID, accuracy=1e-3)
    size = np.linalg.norm(known.displacement_m[0], axis=1)
    off = np.linalg.norm((motion.displacement_m - known.displacement_m)[0], axis=1)
    assert (off / np.maximum(size, 1e-3 * size.max())).max() <= motion.error
    exact = centre_response(0.0, GEL, 0.02, 0.0103).real.item()
    assert -motion.displacement_m[0, 40, 2] == pytest.approx(exact, rel=0.01)
    assert not motion.velocity_m_s.any()


@pytest.mark.parametrize("centre", [(0.0, 0.0), (0.02, 0.01)])
def test_harmonics_at_rest_are_lateral_waves_and_wedges(centre: tuple[float, float]) -> None:
    load = dataclasses.replace(HELD, centre_m=np.array(centre))
    at = [[0.0, 0.0], [0.02, 0.01], [0.03, -0.02]]
    motion = static_axisymmetric(disc("roller"), load, at, accuracy=0.01)
    if centre == (0.0, 0.0):
        other = static(disc("roller"), load, at, accuracy=1e-4)
        assert other.solver.startswith("lateral_waves")
        bound = motion.error
    else:
        other = static_wedges(disc("roller"), load, at, accuracy=0.05)
        bound = motion.error + other.error
    size = np.linalg.norm(other.displacement_m[0], axis=1)
    assert (np.linalg.norm((motion.displacement_m - other.displacement_m)[0], axis=1) / size).max() <= bound


def test_many_points_are_judged_one_by_one() -> None:
    motion, finer = (static(disc("roller"), HELD, GRID, accuracy=a) for a in (0.05, 1e-4))
    assert motion.solver.startswith("lateral_waves")
    size = np.linalg.norm(finer.displacement_m[0], axis=1)
    off = np.linalg.norm((motion.displacement_m - finer.displacement_m)[0], axis=1)
    assert (off / np.maximum(size, 1e-3 * size.max())).max() <= motion.error


def test_a_disc_that_nothing_holds_is_refused() -> None:
    springs = Springs(1e6, 0.0)
    for body in (disc("free", base="free"), disc("roller", base="free"), disc("free", base=springs)):
        with pytest.raises(SceneError, match="free to move"):
            static_axisymmetric(body, HELD, GRID)
    assert static_axisymmetric(disc("roller", base=springs), HELD, [[0.0, 0.0]], accuracy=0.1).error <= 0.1


@pytest.mark.nightly
def test_a_late_time_is_not_rest_where_nothing_damps() -> None:
    elastic = dataclasses.replace(GEL, branches=())
    body = disc("fixed", sheets=(Sheet(elastic, 0.02),))
    with pytest.raises(
        SceneError, match=r"it still oscillates, because it has no damping. Use palmfield.skin.static"
    ) as refused:
        solve(body, HELD, [5.0], [[0.0, 0.0]], device="cpu")
    assert "times begin 5 s after" in str(refused.value)
    assert static(body, HELD, [[0.0, 0.0]]).displacement_m[0, 0, 2] < 0.0
    assert solve(body, HELD, [0.01, 5.0], [[0.0, 0.0]], solver="axisymmetric", device="cpu").error >= 0.0
    solve(disc("fixed"), HELD, [5.0], [[0.0, 0.0]], device="cpu")
