"""Case 7, a spot smaller than an element, a spot at the rim, a load that switches on in one step."""

import dataclasses

import numpy as np
import pytest
from scipy.integrate import dblquad

from palmfield.errors import SceneError
from palmfield.skin.analytic.layer_oracle import centre_response
from palmfield.skin.materials.material import Branch, Material, Sheet, bulk_from_poisson
from palmfield.skin.problem import GAUSSIAN, Slab, Spot

ALL = ["lateral_waves", "axisymmetric", "wedges", "reduced", "spectral_elements", "particles"]
GEL = Material("gel", 1030.0, 12.5e3, (Branch(25e3, 1e-3),), bulk_from_poisson(0.45, 12.5e3), "", bulk_relaxes=True)
AT = np.array([[0.0, 0.0]])


def disc(**changes):
    return dataclasses.replace(Slab((Sheet(GEL, 0.008),), "disc", "bonded", "roller", 0.02), **changes)


@pytest.mark.parametrize("name", ["lateral_waves", "axisymmetric"])
def test_a_spot_of_four_millimetres(name, solve_by):
    """Sizes follow the spot: its own static dip by the series."""
    load = Spot(4e-3, np.array([0.0, 2e-3]), np.array([0.0, 1.0]))
    found = -solve_by(name, disc(), load, np.array([0.1]), AT).displacement_m[0, 0, 2]
    exact = centre_response(0.0, GEL, 0.008, 4e-3, 0.02).real
    print(name, found / exact - 1)
    assert found == pytest.approx(exact, rel=5e-3, abs=0.0)


def test_implicit_refuses_elements_that_a_spot_falls_through(solve_by):
    """Pinned edges of 5.5 mm, a spot of 1.4: the far field missed by 480 % where 31 % were stated."""
    with pytest.raises(SceneError, match=r"do not resolve a spot 0\.0014 m wide"):
        solve_by("wedges", disc(), Spot(1.4e-3, np.zeros(1), np.ones(1), law="held"), np.array([0.05]), AT)


@pytest.mark.parametrize("name", ["spectral_elements", "particles"])
def test_error_of_a_spot_smaller_than_an_element_is_told(name, solve_by):
    """A spot a quarter as wide as an element, and half as wide as particles lie apart."""
    load = Spot(1.4e-3, np.array([0.0, 2e-3]), np.array([0.0, 1.0]))
    at = np.array([[0.0, 0.0], [0.007, 0.0]])
    how = {
        "spectral_elements": {"size_m": 5.6e-3, "estimate": True},
        "particles": {"spacing_m": 2.5e-3},
    }[name]
    motion = solve_by(name, disc(), load, np.array([0.03, 0.04, 0.05]), at, **how)
    exact = centre_response(0.0, GEL, 0.008, 1.4e-3, 0.02, at[:, 0]).real
    error = np.abs(-motion.displacement_m[-1, :, 2] / exact - 1.0)
    print(name, error, motion.error)
    assert motion.error > error.max() > 0.1


@pytest.mark.parametrize("name", ["axisymmetric", "wedges", "reduced", "spectral_elements", "particles"])
def test_a_spot_at_the_rim_presses_with_what_falls_on_the_body(name, solve_by, sizes_like):
    """Momentum of a disc that nothing holds: mass times the mean of its motion, by a rule over its face.

    Rigid motion is fitted to the face at a late time, when branches have taken the waves out.
    """
    radius, depth, width = 0.02, 0.008, 0.0103
    free = disc(base="free", side="free")
    centre = np.array([radius, 0.0])
    load = Spot(width, np.array([0.0, 1e-3, 2e-3]), np.array([0.0, 1.0, 0.0]), centre)
    # Gauss rule in r^2, even rule in the angle: exact for the rigid motion and for low modes of vibration.
    nodes, weights = np.polynomial.legendre.leggauss(4)
    r, turn = np.meshgrid(radius * np.sqrt(0.5 + 0.5 * nodes), 2.0 * np.pi * np.arange(8) / 8, indexing="ij")
    at = np.column_stack([(r * np.cos(turn)).ravel(), (r * np.sin(turn)).ravel()])
    share = np.repeat(weights, 8) / 16.0
    how = (
        {"sizes": sizes_like(fine_radius_m=0.04, fine_m=0.0055, coarse_m=0.0055)}
        if name in ("wedges", "reduced")
        else {}
    )
    if name == "axisymmetric":
        # Its mean along the axis is the harmonic 0; the spot's others, some twenty, only tilt and bend.
        how = {"harmonics": 2}
    motion = solve_by(name, free, load, np.array([0.05, 0.06]), at, **how)
    mean = -(motion.velocity_m_s[..., 2] @ share)

    def falls(y, x):
        return np.exp(-GAUSSIAN * ((x - radius) ** 2 + y * y) / width**2)

    force, _ = dblquad(
        falls, -radius, radius, lambda x: -np.sqrt(radius**2 - x * x), lambda x: np.sqrt(radius**2 - x * x)
    )
    expected = 1e-3 * force / (GEL.density_kg_m3 * np.pi * radius**2 * depth)
    print(name, mean / expected - 1)
    np.testing.assert_allclose(mean, expected, rtol={"axisymmetric": 2e-3, "spectral_elements": 5e-3}.get(name, 0.05))


def test_spectral_refuses_the_rim(refusal_by):
    near = Spot(0.0103, np.array([0.0]), np.array([1.0]), np.array([0.02, 0.0]), "held")
    assert "stationary spot at the centre" in refusal_by("lateral_waves", disc(), near)
    box = Slab((Sheet(GEL, 0.008),), "box", "bonded", "roller", size_m=(0.04, 0.04))
    assert "of a side" in refusal_by("lateral_waves", box, near)


@pytest.mark.parametrize("name", ALL)
def test_a_load_that_switches_on_at_once(name, solve_by, sizes_like):
    """An even pressure, held from the first instant, on a column of an elastic solid: d'Alembert's triangle wave of
    period 4 h / c_p between 0 and twice the static push; with kinks at its ends that elements round off."""
    elastic = dataclasses.replace(GEL, branches=())
    depth = 0.008
    modulus = elastic.bulk_Pa + 4.0 / 3.0 * elastic.shear_relaxed_Pa
    load = Spot(1e2, np.zeros(1), np.ones(1), law="held")
    body = Slab((Sheet(elastic, depth),), "disc", "bonded", "roller", 0.01)
    speed = np.sqrt(modulus / elastic.density_kg_m3)
    times = np.linspace(0.0, 4.0 * depth / speed, 40)[1:]
    how = {
        "wedges": {"sizes": sizes_like(fine_m=0.005, coarse_m=0.01, row_m=1e-3, deepest_row_m=1e-3), "step_s": 4e-5},
        "reduced": {
            "sizes": sizes_like(fine_m=0.01, coarse_m=0.01, row_m=1.6e-3, deepest_row_m=1.6e-3),
            "band_Hz": (0, 4e3),
            "tolerance": 0.01,
        },
        "spectral_elements": {"deep": (4,), "size_m": 0.01},
        "axisymmetric": {"degree": 8},
        "particles": {"spacing_m": 1e-3},
    }.get(name, {})
    motion = solve_by(name, body, load, times, AT, **how)
    phase = np.mod(times * speed / depth, 4.0)
    exact = np.where(phase < 2.0, phase, 4.0 - phase) * depth / modulus
    found = -motion.displacement_m[:, 0, 2]
    error = np.linalg.norm(found - exact) / np.linalg.norm(exact)
    print(name, error, motion.error, found.max() / exact.max())
    assert error < {"particles": min(0.1, motion.error), "axisymmetric": min(0.03, motion.error), "wedges": 0.03}.get(
        name, 0.02
    )
    assert found.max() < 1.03 * exact.max()
