"""What an accuracy is of: displacement, velocity, or the displacement along the normal."""

import dataclasses
import math

import numpy as np
import pytest

from palmfield.errors import SceneError
from palmfield.skin import Layer, Sheet, Slab, Spot, preset, solve
from palmfield.skin.materials.material import Branch, Material
from palmfield.skin.mesh.disc import disc_patch
from palmfield.skin.problem import QUANTITIES, normals_on_face

GEL = preset("ecoflex_00-10")
DISC = Slab((Sheet(GEL, 0.02),), shape="disc", side="fixed", radius_m=0.06)
BOX = Slab((Sheet(GEL, 0.01),), shape="box", side="fixed", size_m=(0.05, 0.05))
SUDDEN = Spot(0.0103, [0.0], [1.0], law="held")
TIMES = 1e-3 * np.arange(1, 16)
AT = [[0.0, 0.0], [0.02, 0.005]]


def true_errors(motion, known) -> dict[str, float]:
    pairs = {
        "displacement": (motion.displacement_m, known.displacement_m),
        "velocity": (motion.velocity_m_s, known.velocity_m_s),
        "normal": (motion.displacement_m[..., 2:], known.displacement_m[..., 2:]),
    }
    return {
        name: float((np.linalg.norm(a - b, axis=(0, 2)) / np.linalg.norm(b, axis=(0, 2))).max())
        for name, (a, b) in pairs.items()
    }


@pytest.mark.nightly
@pytest.mark.parametrize("solver", ["axisymmetric", "spectral_elements", "wedges", "reduced"])
def test_each_solver_states_three_errors_that_cover(solver: str) -> None:
    load = Spot(0.0103, [0.0, 4e-3], [0.0, 1.0])
    known = solve(DISC, load, TIMES, AT, solver="axisymmetric", accuracy=1e-3, device="cpu", degree=8, fine=1.0)
    motion = solve(DISC, load, TIMES, AT, solver=solver, accuracy=0.1, device="cpu")
    found = true_errors(motion, known)
    print(solver, {name: (getattr(motion, f"{name}_error"), found[name]) for name in QUANTITIES})
    assert motion.accuracy_of == "displacement" and motion.error == motion.displacement_error
    for name in QUANTITIES:
        assert found[name] <= getattr(motion, f"{name}_error") + getattr(known, f"{name}_error")


def of_shear(shear_Pa: float, viscosity_Pa_s: float = 0.0, branches: tuple[Branch, ...] = ()) -> Material:
    return Material("test", 1000.0, shear_Pa, branches, 20.0 * shear_Pa, "test", viscosity_Pa_s)


HARD_SHEETS = {
    "stiff Kelvin-Voigt": (Sheet(of_shear(50e3, 100.0), 0.01),),
    "branch of 1 us": (Sheet(of_shear(50e3, branches=(Branch(5e6, 1e-6),)), 0.01),),
    "soft on hard": (Sheet(of_shear(5e3, 3.0), 0.004), Sheet(of_shear(1.5e6, 3.0), 0.006)),
    "on and off": (Sheet(of_shear(10e3, 1.0), 0.008),),
}


@pytest.mark.nightly
@pytest.mark.parametrize("name", HARD_SHEETS)
def test_the_error_of_a_sudden_velocity_is_covered(name: str) -> None:
    disc = Slab(HARD_SHEETS[name], shape="disc", side="fixed", radius_m=0.02)
    load = Spot(0.01, [0.0, 3e-3], [1.0, 0.0], law="held") if name == "on and off" else SUDDEN
    times, at = 3.75e-4 * np.arange(1, 41), [[0.0, 0.0], [0.006, 0.003]]
    known = solve(disc, load, times, at, solver="axisymmetric", accuracy=0.01, accuracy_of="velocity", device="cpu")
    for solver in ("spectral_elements", "axisymmetric"):
        motion = solve(disc, load, times, at, solver=solver, accuracy=0.1, accuracy_of="velocity", device="cpu")
        true = true_errors(motion, known)["velocity"]
        assert true <= motion.velocity_error + known.velocity_error and motion.velocity_error < 0.3


def viscous(shear_Pa: float, bulk_Pa: float, viscosity_Pa_s: float, branches: tuple[Branch, ...] = ()) -> Material:
    return Material("test", 1100.0, shear_Pa, branches, bulk_Pa, "test", viscosity_Pa_s)


def test_what_two_runs_have_in_common_is_in_the_error_too() -> None:
    """Hard on soft: models of one size met both runs' tolerances, whose difference was a tenth of the error."""
    sheets = Sheet(viscous(93e3, 1.33e6, 41.8), 1.95e-3), Sheet(viscous(6.66e3, 95e3, 3.0), 1.61e-3)
    body = Slab(sheets, shape="disc", side="free", radius_m=0.0139)
    load, times = Spot(0.0083, [0.0, 4.8e-4], [0.0, 1.0]), 2.16e-4 * np.arange(1, 41)
    at = [[0.0, 0.0], [3.16e-3, 9.9e-4]]
    known = solve(body, load, times, at, solver="axisymmetric", accuracy=5e-4, accuracy_of="velocity", device="cpu")
    motion = solve(body, load, times, at, solver="axisymmetric", accuracy=0.138, accuracy_of="velocity", device="cpu")
    found = true_errors(motion, known)
    print({name: (getattr(motion, f"{name}_error"), found[name]) for name in QUANTITIES})
    assert found["velocity"] > 3e-3
    for name in QUANTITIES:
        assert found[name] <= getattr(motion, f"{name}_error")


def test_a_velocity_that_falls_slowly_with_the_tolerance_is_covered() -> None:
    """Lateral waves after a sudden load and its sudden end, against elements."""
    sheets = (Sheet(viscous(12.5e3, 1.246e6, 19.25, (Branch(20e3, 1.71e-4),)), 6.75e-3),)
    body = Slab(sheets, shape="disc", side="roller", radius_m=0.01856)
    load = Spot(0.01047, [0.0, 1.231e-3], [1.0, 0.0], law="held")
    times, at = 1.385e-4 * np.arange(1, 41), [[0.0, 0.0], [-4.34e-3, -4.72e-3]]
    known = solve(body, load, times, at, solver="axisymmetric", accuracy=2e-3, accuracy_of="velocity", device="cpu")
    for accuracy in (0.1, 0.058, 0.02):
        motion = solve(body, load, times, at, solver="lateral_waves", accuracy=accuracy, device="cpu")
        found = true_errors(motion, known)
        print(accuracy, {name: (getattr(motion, f"{name}_error"), found[name]) for name in QUANTITIES})
        assert found["velocity"] <= motion.velocity_error + known.velocity_error


def test_lateral_waves_state_them_too() -> None:
    slab = Slab(DISC.sheets)
    known = solve(slab, SUDDEN, TIMES, AT, solver="lateral_waves", tolerance=5e-4, device="cpu")
    motion = solve(slab, SUDDEN, TIMES, AT, accuracy=0.02, device="cpu")
    found = true_errors(motion, known)
    for name in QUANTITIES:
        assert found[name] <= 1.05 * getattr(motion, f"{name}_error")


def test_refinement_goes_by_what_was_asked_for() -> None:
    load = Spot(0.0103, [0.0, 4e-3], [0.0, 1.0])
    plain = solve(DISC, load, TIMES, AT, solver="axisymmetric", accuracy=0.02, device="cpu")
    target = 0.7 * plain.velocity_error
    assert plain.displacement_error < target
    swift = solve(DISC, load, TIMES, AT, solver="axisymmetric", accuracy=target, accuracy_of="velocity", device="cpu")
    assert swift.accuracy_of == "velocity" and swift.error == swift.velocity_error <= target


def test_a_normal_of_a_bent_layer_is_the_surfaces_own() -> None:
    patch = disc_patch(0.03, 0.005, 0.001, 0.001, 0.01)
    flat = patch.vertices[:, :2]
    bent = np.column_stack([flat, -(flat**2).sum(axis=1) / 0.2])
    layer = Layer(dataclasses.replace(patch, vertices=bent), (Sheet(GEL, 0.005),))
    place = np.array([[0.01, 0.005, -(0.01**2 + 0.005**2) / 0.2]])
    slope = np.array([0.01, 0.005]) / 0.1
    exact = np.array([*slope, 1.0]) / math.sqrt(1.0 + (slope**2).sum())
    np.testing.assert_allclose(normals_on_face(layer, place)[0], exact, atol=0.012)
    np.testing.assert_array_equal(normals_on_face(BOX, place), [[0.0, 0.0, 1.0]])


def test_another_quantity_is_refused() -> None:
    with pytest.raises(SceneError, match="accuracy_of is 'strain'; use one of displacement, velocity, normal"):
        solve(DISC, SUDDEN, TIMES, AT, accuracy_of="strain", device="cpu")
