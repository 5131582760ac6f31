"""Afferents: motion under a probe, thresholds and spikes against published curves and closed forms."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from palmfield.errors import OutputError
from palmfield.perception.afferents import (
    AFFERENTS,
    PROBE_M,
    largest_under_probe,
    potentials,
    probe_displacement,
    probe_strain,
    spikes,
)

STEP_S = 1.25e-4


def sine(f_Hz, lasts_s=None):
    times = np.arange(0.0, lasts_s or max(0.3, 6.0 / f_Hz), STEP_S)
    return np.sin(2.0 * np.pi * f_Hz * times)[:, None]


def threshold_m(afferent, f_Hz):
    """Peak displacement of the probe at which the unit begins to fire, of a vibration that has settled."""
    level, _ = potentials(afferent, sine(f_Hz), STEP_S)
    return 1.0 / level[len(level) // 2 :].max()


@pytest.mark.parametrize("name", AFFERENTS)
def test_thresholds_are_those_of_single_units_within_3_dB(name):
    afferent = AFFERENTS[name]
    for f_Hz, published_m in zip(*afferent.tuning, strict=True):
        assert abs(20.0 * np.log10(threshold_m(afferent, f_Hz) / published_m)) < 3.0, f_Hz


@pytest.mark.parametrize(("name", "f_Hz"), [("ra1", 20.0), ("ra1", 30.0), ("pc", 100.0), ("pc", 150.0)])
def test_one_spike_a_cycle_over_a_range_of_amplitudes(name, f_Hz):
    """Entrainment: each cycle has one spike over at least 6 dB, and more than one at 30 dB above threshold."""
    afferent, course = AFFERENTS[name], sine(f_Hz, 40.0 / f_Hz)
    rates = {}
    for above_dB in range(0, 31):
        moments, _ = spikes(afferent, 10.0 ** (above_dB / 20.0) * 1.02 * threshold_m(afferent, f_Hz) * course, STEP_S)
        rates[above_dB] = np.sum(moments > 20.0 / f_Hz) / 20.0
    entrained = [above_dB for above_dB, rate in rates.items() if abs(rate - 1.0) < 0.06]
    assert len(entrained) >= 7 and np.ptp(entrained) == len(entrained) - 1
    assert rates[30] > 1.9


def test_steady_pressure_excites_sa1_only():
    held = np.full((4000, 1), 200e-6)
    held[:400] *= np.linspace(0.0, 1.0, 400)[:, None]
    late = {name: spikes(one, held, STEP_S)[0] for name, one in AFFERENTS.items()}
    counts = {name: int((moments > 0.25).sum()) for name, moments in late.items()}
    assert counts["sa1"] > 5 and counts["ra1"] == counts["pc"] == 0
    gaps = np.diff(late["sa1"][late["sa1"] > 0.25])
    assert np.ptp(gaps) <= 1.01 * STEP_S  # regular


@pytest.mark.parametrize(("f_Hz", "most_sensitive"), [(2.0, "sa1"), (10.0, "ra1"), (250.0, "pc")])
def test_each_class_has_its_range(f_Hz, most_sensitive):
    """Under a probe RA1 takes over from SA1 between 2 and 10 Hz, and PC from RA1 below 50 Hz."""
    thresholds = {name: threshold_m(one, f_Hz) for name, one in AFFERENTS.items()}
    if most_sensitive == "sa1":
        assert thresholds["sa1"] < 1.5 * thresholds["ra1"] < thresholds["pc"]
    else:
        assert min(thresholds, key=lambda name: thresholds[name]) == most_sensitive


@settings(max_examples=25, deadline=None)
@given(factor=st.floats(1e-3, 1e3), seed=st.integers(0, 100))
def test_levels_are_proportional_to_the_motion(factor, seed):
    motion = 1e-6 * np.random.default_rng(seed).normal(size=(200, 3)).cumsum(axis=0)
    for afferent in AFFERENTS.values():
        once, again = (potentials(afferent, one, STEP_S)[0] for one in (motion, factor * motion))
        np.testing.assert_allclose(again, factor * once, rtol=1e-9, atol=1e-12 * factor * once.max())


def test_units_fire_from_level_1_on():
    afferent, course = AFFERENTS["pc"], sine(200.0)
    level = potentials(afferent, course, STEP_S)[0].max()
    moments, units = spikes(afferent, np.array([[0.999, 1.001]]) * course / level, STEP_S)
    assert set(units) == {1} and len(moments) >= 1


def test_longer_steps_of_a_record_change_little():
    afferent = AFFERENTS["ra1"]
    fine = sine(20.0)
    levels = [potentials(afferent, fine[::every], every * STEP_S)[0].max() for every in (1, 8)]
    assert levels[1] == pytest.approx(levels[0], rel=0.01)


@pytest.mark.parametrize("depth_m", [5e-4, 1e-3, 3e-3])
def test_motion_under_a_probe_is_that_of_its_pressure(depth_m):
    """Boussinesq's point forces, summed over the pressure of a flat punch, on the axis."""
    radius = PROBE_M

    def summed(depth):
        # Pressure 8 G A a / (2 pi a sqrt(a2 - r2)); r = a sin(t) removes the singular edge
        def ring(t):
            far = np.hypot(radius * np.sin(t), depth)
            return 2.0 / np.pi * radius * np.sin(t) * (1.0 / far + depth**2 / far**3)

        return quad(ring, 0.0, 0.5 * np.pi, epsabs=1e-13)[0]

    assert probe_displacement(depth_m, radius) == pytest.approx(summed(depth_m), rel=1e-9)
    small = 1e-3 * depth_m
    slope = (summed(depth_m - small) - summed(depth_m + small)) / (2.0 * small)
    assert probe_strain(depth_m, radius) == pytest.approx(slope, rel=1e-4)


def test_the_probe_is_put_where_a_unit_is_most_sensitive():
    for afferent in AFFERENTS.values():
        of_probe = probe_strain if afferent.quantity == "strain" else probe_displacement
        distances = np.linspace(0.0, 3e-3, 3001)
        most = of_probe(afferent.depth_m, PROBE_M, distances).max()
        assert largest_under_probe(afferent) == pytest.approx(most, rel=1e-4)


@pytest.mark.parametrize(
    ("motion", "step_s", "message"),
    [
        (np.zeros(5), STEP_S, r"shape \(5,\); give finite numbers of shape \(t, n\)"),
        (np.full((5, 1), np.nan), STEP_S, "finite"),
        (np.zeros((5, 1)), 0.0, "step_s is 0; allowed: above 0"),
    ],
)
def test_bad_input_is_refused(motion, step_s, message):
    for function in (potentials, spikes):
        with pytest.raises(OutputError, match=message):
            function(AFFERENTS["pc"], motion, step_s)
