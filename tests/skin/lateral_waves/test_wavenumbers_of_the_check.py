"""The run that an answer is held against has a wavenumber more, also where a fifth of the tolerance asks for none."""

import numpy as np
import pytest

from palmfield.skin import Sheet, Slab, Spot
from palmfield.skin.materials.material import Branch, Material
from palmfield.skin.problem import SkinProblem
from palmfield.skin.solvers.lateral_waves.resolution import relative_error
from palmfield.skin.solvers.lateral_waves.solve import run, settings_of, solve_lateral_waves

SOFT = Material(
    name="soft", density_kg_m3=1030.0, shear_relaxed_Pa=12.5e3, bulk_Pa=1.2458e6,
    viscosity_Pa_s=0.0, branches=(Branch(20e3, 1.71e-4),), source="as drawn in a coverage run",
)  # fmt: skip


@pytest.mark.parametrize("shape", ["disc", "box"])
def test_a_slab_of_few_wavenumbers_states_what_the_next_one_changes(shape: str) -> None:
    """Five wavenumbers at tolerances of 3.9 and 0.8 %: their difference told a fifth of the error."""
    width = 0.002298
    size = {"radius_m": 0.004435} if shape == "disc" else {"size_m": (0.0089, 0.0089)}
    body = Slab((Sheet(SOFT, 0.001173),), shape=shape, side="roller", **size)
    times = 4.111e-5 * np.arange(1, 25)
    period, knots = 5.427e-4, 2.2613e-5 * np.arange(45)
    load = Spot(width, knots, 0.5 - 0.5 * np.cos(2.0 * np.pi * knots / period))
    at = np.array([[0.0, 0.0], [0.5 * width, 0.0]])
    for accuracy in (0.0783, 0.04):
        motion = solve_lateral_waves(SkinProblem(body, load, times, at, accuracy=accuracy))
        fine = run(body, load, times, at, 1e-6, settings_of(None, "cpu", 1))
        true = relative_error(motion.displacement_m, fine.displacement)
        assert true < motion.displacement_error < max(10.0 * true, 0.02)
