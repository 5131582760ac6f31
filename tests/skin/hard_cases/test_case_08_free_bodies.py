"""Case 8, nothing holds the body: under a held spot its mean falls as F t^2 / 2 m, and rests before.

Momentum to round-off or tolerance, and no drift: test_momentum_of_a_free_body_is_exact (spectral elements),
test_free_body_keeps_its_momentum (particles, axisymmetric), test_free_body_keeps_momentum (wedges, in test_solver.py),
test_thrust_sets_a_free_slab_in_motion (lateral waves); at the rim, all of them: test_case_07_spots.py.
"""

import numpy as np
import pytest

from palmfield.errors import SceneError
from palmfield.skin.materials.material import Branch, Material, Sheet, bulk_from_poisson
from palmfield.skin.problem import Slab, Spot, spread
from palmfield.skin.solvers.lateral_waves import static_lateral_waves
from palmfield.skin.solvers.wedges import static_wedges

pytestmark = pytest.mark.numerics

GEL = Material("gel", 1030.0, 12.5e3, (Branch(25e3, 1e-3),), bulk_from_poisson(0.45, 12.5e3), "", bulk_relaxes=True)
RADIUS, DEPTH, WIDTH = 0.02, 0.008, 0.0103
FREE = Slab((Sheet(GEL, DEPTH),), "disc", "free", "roller", RADIUS)
HELD = Spot(WIDTH, np.zeros(1), np.ones(1), law="held")


@pytest.mark.parametrize(
    "name", ["lateral_waves", "axisymmetric", "wedges", "reduced", "spectral_elements", "particles"]
)
def test_a_held_spot_is_a_free_fall(name, solve_by):
    """Rollers let it move down only; asked late, it is far, and that is no error."""
    nodes, weights = np.polynomial.legendre.leggauss(8)
    at = np.column_stack([RADIUS * np.sqrt(0.5 + 0.5 * nodes), np.zeros(8)])
    times = np.array([0.02, 0.04, 0.06])
    how = {"spectral_elements": {"size_m": 0.008}, "wedges": {"step_s": 1e-3}}.get(name, {})
    motion = solve_by(name, FREE, HELD, times, at, **how)
    force = 2.0 * np.pi * spread(WIDTH) ** 2 * (1.0 - np.exp(-0.5 * (RADIUS / spread(WIDTH)) ** 2))
    pace = force / (GEL.density_kg_m3 * np.pi * RADIUS**2 * DEPTH)
    fallen, speed = (-part[..., 2] @ weights / 2.0 for part in (motion.displacement_m, motion.velocity_m_s))
    print(name, fallen / (0.5 * pace * times**2) - 1, speed / (pace * times) - 1)
    # Wedges fill a polygon, which weighs 1.2 % less than the disc.
    rough = {"wedges": 0.015, "reduced": 0.015, "particles": 5e-3}.get(name, 2e-3)
    np.testing.assert_allclose(speed, pace * times, rtol=rough)
    # The face is ahead of the middle by the layer's own squeeze.
    np.testing.assert_allclose(fallen[-1], 0.5 * pace * times[-1] ** 2, rtol=rough + 2e-3)


@pytest.mark.parametrize("solve", [static_lateral_waves, static_wedges])
def test_a_static_answer_needs_a_support(solve):
    with pytest.raises(SceneError, match=r"no static solution|needs a support"):
        solve(FREE, HELD, np.zeros((1, 2)))
