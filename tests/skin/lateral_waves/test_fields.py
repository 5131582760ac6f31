import numpy as np
import pytest
from scipy.special import jvp

from palmfield.errors import SceneError
from palmfield.skin import Sheet, Slab, Spot
from palmfield.skin.materials.material import kelvin_voigt
from palmfield.skin.problem import SkinProblem
from palmfield.skin.solvers.lateral_waves import solve_lateral_waves
from palmfield.skin.solvers.lateral_waves.fields import PeriodicSlab, WalledDisc, wall_wavenumbers

SHEET = Sheet(kelvin_voigt("plate", 923.5, 23087.5, 0.3), 0.01)
FWHM = 0.01
TIMES = np.linspace(0.0, 0.01, 41)


def running(speed: float = 7.0) -> Spot:
    places = np.stack([-0.035 + speed * TIMES, np.full(len(TIMES), 0.003)], axis=1)
    return Spot(FWHM, TIMES, np.ones(len(TIMES)), places)


def apart(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.sqrt(((one - other) ** 2).sum() / (other**2).sum()))


@pytest.mark.nightly
@pytest.mark.parametrize("base", ["free", "bonded"])
def test_a_field_is_what_the_solver_sums_at_points(base):
    slab = Slab((SHEET,), base=base)
    plate = PeriodicSlab(slab, FWHM, period_m=0.32, horizon_s=0.01, speed_m_s=7.0)
    field = plate.normal_velocity(running(), TIMES[1:], half_m=0.05, cells=160)
    places = plate.places(0.05, 160)
    chosen = [(25, 25), (33, 27), (10, 20), (40, 12)]
    points = np.array([[places[i], places[j]] for i, j in chosen])
    known = solve_lateral_waves(SkinProblem(slab, running(), TIMES[1:], points, accuracy=0.01, accuracy_of="velocity"))
    ours = np.stack([field[:, i, j] for i, j in chosen], axis=1)
    assert apart(ours, known.velocity_m_s[:, :, 2]) < 0.01


def test_the_field_of_a_spot_at_rest_on_a_walled_disc_is_the_solver_s():
    slab = Slab((SHEET,), base="bonded", shape="disc", side="roller", radius_m=0.05)
    spot = Spot(FWHM, TIMES, np.minimum(TIMES / 2e-3, 1.0), np.zeros(2))
    disc = WalledDisc(slab, FWHM, horizon_s=0.01, speed_m_s=1.0)
    places = 5e-3 * np.arange(-10, 11)
    field = disc.normal_velocity(spot, TIMES[1:], places_m=places)
    points = np.array([[0.0, 0.0], [0.02, 0.0], [0.03, -0.03]])
    known = solve_lateral_waves(SkinProblem(slab, spot, TIMES[1:], points, accuracy=0.005, accuracy_of="velocity"))
    ours = np.stack([field[:, 10, 10], field[:, 14, 10], field[:, 16, 4]], axis=1)
    assert apart(ours, known.velocity_m_s[:, :, 2]) < 0.01


def test_a_walled_disc_is_endless_until_its_wall_answers_and_not_afterwards():
    moving = Spot(FWHM, TIMES, np.ones(len(TIMES)), np.stack([0.01 * np.cos(600 * TIMES), 0.02 * TIMES], axis=1))
    endless = PeriodicSlab(Slab((SHEET,), base="bonded"), FWHM, period_m=0.3, horizon_s=0.01, speed_m_s=7.0)
    disc = WalledDisc(
        Slab((SHEET,), base="bonded", shape="disc", side="roller", radius_m=0.06), FWHM, horizon_s=0.01, speed_m_s=7.0
    )
    places = endless.places(0.058, 150)
    one = endless.normal_velocity(moving, TIMES[1:], half_m=0.058, cells=150)
    other = disc.normal_velocity(moving, TIMES[1:], places_m=places)
    middle = np.hypot(*np.meshgrid(places, places, indexing="ij")) < 0.03
    rim = np.hypot(*np.meshgrid(places, places, indexing="ij")) > 0.05
    assert apart(other[8:14, middle], one[8:14, middle]) < 0.01
    on_disc = rim & (np.hypot(*np.meshgrid(places, places, indexing="ij")) < 0.06)
    assert apart(other[30:, on_disc], one[30:, on_disc]) > 0.3


@pytest.mark.slow
def test_a_spot_off_the_middle_of_a_walled_disc_against_elements():
    """The wall's curvature is neglected: errors fall with the radius in waves, here of about ten."""
    from palmfield.skin import solve

    slab = Slab((SHEET,), base="bonded", shape="disc", side="roller", radius_m=0.03)
    spot = Spot(FWHM, TIMES, np.minimum(TIMES / 2e-3, 1.0), np.array([0.01, 0.0]))
    field = WalledDisc(slab, FWHM, horizon_s=0.01, speed_m_s=1.0).normal_velocity(
        spot, TIMES[1:], places_m=5e-3 * np.arange(-6, 7)
    )
    points = np.array([[0.01, 0.0], [0.0, 0.02], [-0.02, 0.0]])
    known = solve(slab, spot, TIMES[1:], points, accuracy=0.05, accuracy_of="velocity", solver="axisymmetric")
    ours = np.stack([field[:, 8, 6], field[:, 6, 10], field[:, 2, 6]], axis=1)
    assert apart(ours[:, 0], known.velocity_m_s[:, 0, 2]) < 0.02
    assert apart(ours, known.velocity_m_s[:, :, 2]) < 0.1


def test_wavenumbers_of_a_wall_are_zeros_and_none_is_missing():
    orders, k = wall_wavenumbers(0.125, 400.0)
    assert np.abs(jvp(orders[1:], 0.125 * k[1:])).max() < 1e-12
    x = np.linspace(0.4, 50.0, 20_000)
    for order in (0, 1, 7, 30, 47):
        signs = np.sign(jvp(order, x[x > 0.9 * order]))
        assert np.count_nonzero(signs[1:] != signs[:-1]) == np.count_nonzero(orders == order) - (order == 0)


def test_what_is_refused_says_why():
    slab = Slab((SHEET,), base="free")
    plate = PeriodicSlab(slab, FWHM, period_m=0.2)
    with pytest.raises(SceneError, match="waves were built"):
        plate.normal_velocity(Spot(0.006, TIMES, np.ones(41)), TIMES[1:], half_m=0.05, cells=200)
    with pytest.raises(SceneError, match="cells is 20"):
        plate.normal_velocity(running(), TIMES[1:], half_m=0.05, cells=20)
    with pytest.raises(SceneError, match="half the period"):
        plate.normal_velocity(running(), TIMES[1:], half_m=0.2, cells=200)
    with pytest.raises(SceneError, match="must be 'disc'"):
        WalledDisc(slab, FWHM)
    disc = Slab((SHEET,), shape="disc", side="roller", radius_m=0.04)
    with pytest.raises(SceneError, match="from the wall"):
        WalledDisc(disc, FWHM).normal_velocity(running(), TIMES[1:])
    fixed = Slab((SHEET,), shape="disc", side="fixed", radius_m=0.04)
    with pytest.raises(SceneError, match="allowed: 'roller'"):
        WalledDisc(fixed, FWHM)
