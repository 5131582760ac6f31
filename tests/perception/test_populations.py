"""Levels of populations of afferents against published thresholds and laws of area."""

import math

import numpy as np
import pytest

from palmfield.errors import OutputError
from palmfield.perception.afferents import AFFERENTS, largest_under_probe, potentials, probe_displacement, probe_strain
from palmfield.perception.observers import OBSERVERS, threshold_m
from palmfield.perception.populations import DENSITIES_PER_CM2, POPULATIONS, class_level_dB, spread_of, unit_levels

STEP_S = 1.25e-4


def contact_level_dB(name, f_Hz, peak_m, area_m2):
    """Level of a class of the palm under a flat contactor on a half space, with its afferents spread evenly."""
    afferent, radius, reach = AFFERENTS[name], math.sqrt(area_m2 / np.pi), 0.03
    count = round(1e4 * DENSITIES_PER_CM2["palm"][name] * np.pi * reach**2)
    distances = reach * np.sqrt((np.arange(count) + 0.5) / count)
    of_probe = probe_strain if afferent.quantity == "strain" else probe_displacement
    shares = of_probe(afferent.depth_m, radius, distances) / largest_under_probe(afferent)
    times = np.arange(0.0, max(0.3, 6.0 / f_Hz), STEP_S)
    level = potentials(afferent, peak_m * np.sin(2.0 * np.pi * f_Hz * times)[:, None], STEP_S)[0]
    # A compression of the other sign has the same level in the other half of a cycle
    return class_level_dB(name, level[len(level) // 2 :].max() * np.abs(shares))


@pytest.mark.parametrize(
    ("f_Hz", "within_dB"), [(2, 12), (10, 6), (20, 6), (40, 8), (100, 10), (250, 1), (400, 3), (500, 3)]
)
def test_people_feel_a_contactor_where_a_population_does(f_Hz, within_dB):
    """Bolanowski et al. (1988), 2.9 cm2. Only the value at 250 Hz is used for the rule of PC; SA1 is 11 dB off."""
    peak_m = float(threshold_m(OBSERVERS["bolanowski_1988"], f_Hz))
    assert abs(max(contact_level_dB(name, f_Hz, peak_m, 2.9e-4) for name in AFFERENTS)) < within_dB


def test_pc_sum_over_area_and_ra_do_not():
    """Verrillo's law: 3 dB per doubling at 250 Hz, here from 0.3 to 2.9 cm2 within a third; none at 20 Hz."""
    pc = [contact_level_dB("pc", 250.0, 1e-7, area) for area in (0.3e-4, 2.9e-4)]
    doublings = math.log2(2.9 / 0.3)
    assert 2.0 < (pc[1] - pc[0]) / doublings < 4.0
    ra = [contact_level_dB("ra1", 20.0, 1e-5, area) for area in (0.3e-4, 2.9e-4)]
    assert (ra[1] - ra[0]) / doublings < 0.5


def test_densities_add_up_to_the_printed_totals():
    sa2 = {"palm": 16.0, "finger": 15.0, "fingertip": 9.0}
    totals = {part: sum(one.values()) + sa2[part] for part, one in DENSITIES_PER_CM2.items()}
    assert totals["palm"] == 58.0 and totals["fingertip"] == 241.0
    assert totals["finger"] / totals["palm"] == pytest.approx(1.6, abs=0.03)


def test_levels_count_in_the_window_only():
    motion = np.zeros((2000, 300))
    motion[100:300, 0] = 1e-5 * np.sin(2.0 * np.pi * 200.0 * STEP_S * np.arange(200))
    whole = unit_levels(AFFERENTS["pc"], motion, STEP_S)
    late = unit_levels(AFFERENTS["pc"], motion, STEP_S, slice(1500, None))
    assert whole.shape == (300,) and whole[0] > 100.0 and not whole[1:].any() and late[0] < 1e-6 * whole[0]


def test_rules():
    assert class_level_dB("ra1", np.array([0.2, 10.0, 1.0])) == pytest.approx(20.0)
    once, four = (class_level_dB("pc", np.full(count, 5.0)) for count in (100, 400))
    assert four - once == pytest.approx(6.0206, abs=1e-3)
    assert class_level_dB("sa1", np.zeros(4)) == class_level_dB("sa1", np.zeros(0)) == -math.inf
    with pytest.raises(OutputError, match="class of afferents is 'sa2'; allowed: sa1, ra1, pc"):
        class_level_dB("sa2", np.ones(1))
    assert set(POPULATIONS["population_all"].classes) == set(AFFERENTS)
    assert all(spread > 0.0 and text for spread, text in map(spread_of, AFFERENTS))
