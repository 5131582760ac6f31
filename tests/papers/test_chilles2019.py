"""Answers of Chilles et al. 2019 against exact solutions that they do not use."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse

from palmfield.instruments.surface_motion import SurfaceMotion
from palmfield.instruments.vibrometer import vibrometer_record
from palmfield.skin import preset
from palmfield.skin.analytic.layer_oracle import centre_response
from palmfield.skin.fem.body import build
from palmfield.skin.mesh.body_mesh import Sizes
from palmfield.skin.problem import Motion
from palmfield_papers.answer import Setting
from palmfield_papers.chilles2019 import (
    PAPER,
    causes,
    chains,
    filter_rows,
    maps,
    mesh_rows,
    modulated_rows,
    pictures,
    runs,
    setup,
    step_rows,
    traces,
)
from palmfield_papers.entries import book

ENTRIES = {entry.id: entry for entry in book().of_paper("Chilles 2019")}
ENDLESS = setup.Case(side="infinite", quick=True)


def answer(name, control="", **readings):
    base = tuple((axis, readings.get(axis, value)) for axis, value in book().base(ENTRIES[name]))
    return PAPER.answers[name](Setting(readings=base, control=control, quick=True))


def test_every_claim_has_an_answer_and_every_answer_an_entry():
    assert set(PAPER.answers) <= set(ENTRIES)
    assert {name for name, entry in ENTRIES.items() if entry.counts} <= set(PAPER.answers)
    assert {name for name, entry in ENTRIES.items() if entry.kind in ("CALC", "ERRATUM")} <= set(PAPER.answers)
    assert set(PAPER.causes) <= set(PAPER.answers)


def test_controls_and_readings_of_the_book_are_known():
    sides, sights = book().axes["chilles_sides"], book().axes["chilles_line_of_sight"]
    assert set(sides) == set(setup.SIDES)
    assert set(sights) == set(setup.LINES_OF_SIGHT)
    assert set(book().axes["chilles_start"]) == set(setup.STARTS)
    mine = {control.name for control in book().controls if any("chilles" in one for one in control.configurations)}
    assert mine == set(setup.CONTROLS)


def test_each_control_changes_the_case():
    for name in setup.CONTROLS:
        assert setup.case_of(Setting(control=name)) != setup.case_of(Setting())
    half, whole = (setup.material_of(name) for name in ("half", "given"))
    assert half.shear_relaxed_Pa == pytest.approx(0.5 * whole.shear_relaxed_Pa)
    assert [branch.time_s for branch in half.branches] == [branch.time_s for branch in whole.branches]


def test_step_settles_at_the_exact_static_deflection():
    """By Hankel's integral over plane waves in depth, of a slab without sides."""
    steady = step_rows.steady_of(traces.raw(ENDLESS, "step"))
    exact = centre_response(0.0, preset("ecoflex_00-10"), setup.THICKNESS_M, setup.FWHM_M)
    assert steady == pytest.approx(-1e6 * setup.LEVEL_PA * abs(exact), rel=5e-3)


def test_modulated_load_moves_by_the_exact_response_at_200_hz():
    """Half of the load is a sine, so that the line is half of what 12 Pa at 200 Hz give."""
    trace = traces.raw(ENDLESS, "am_load")
    window = traces.fem_window("last five periods", "am_load")
    kept = modulated_rows.within(trace.times_s, trace.values, window)
    line = modulated_rows.harmonics(*kept, setup.AM_HZ, 1)[0]
    exact = abs(centre_response(200.0, preset("ecoflex_00-10"), setup.THICKNESS_M, setup.FWHM_M))
    assert line == pytest.approx(0.5e6 * setup.LEVEL_PA * exact, rel=5e-3)


def test_windows_hold_whole_periods():
    for stimulus, frequency in (("am_load", 200.0), ("stm", 70.0)):
        times = np.arange(round(0.256 * traces.SAMPLING_HZ)) / traces.SAMPLING_HZ
        start, end = traces.fem_window("last five periods", stimulus)
        kept = times[(times >= start) & (times <= end)]
        assert np.mean(np.sin(2.0 * np.pi * frequency * kept)) == pytest.approx(0.0, abs=2e-3)
        assert end < setup.STIMULUS_S
        assert len(kept) == pytest.approx(5.0 / frequency * traces.SAMPLING_HZ, abs=1)


def test_filtered_steady_state_is_nothing_and_the_gain_makes_the_measured_peak():
    probe = setup.Probe()
    trace = modulated_rows.gained(ENDLESS, "step", probe)
    assert step_rows.peak_of(trace) == pytest.approx(modulated_rows.STEP_PEAK_UM, rel=1e-9)
    assert abs(step_rows.steady_of(trace)) < 1e-3
    plain = traces.measured(ENDLESS, "step", replace(probe, highpass=False))
    assert step_rows.steady_of(plain) == pytest.approx(step_rows.steady_of(traces.raw(ENDLESS, "step")), rel=5e-3)


def test_a_first_order_filter_forgets_a_ramp_exponentially():
    """The integral of the ramp's velocity with e^{-w (t - s)}, w of 50 Hz, for motion along the normal alone."""
    times = np.arange(3200) / 32e3
    moved = np.zeros((3200, 1, 3))
    moved[:, 0, 2] = -1e-6 * setup.course("ramp", times)
    motion = Motion(times, np.zeros((1, 3)), moved, moved, 0.0, "", "", 0.0)
    up = np.array([[0.0, 0.0, 1.0]])
    surface = SurfaceMotion(times, motion.points, up, moved, runs.by_differences(motion).velocity_m_s)
    settings = traces.vibrometer(setup.Probe(order=1)).model_copy(update={"duration_s": 0.09})
    record = vibrometer_record(surface, settings)
    late, ramp = np.array([5e-3, 10e-3]), np.linspace(0.0, setup.RAMP_S, 2001)
    slope = -1e-6 * np.gradient(setup.course("ramp", ramp), ramp)
    rate = 2.0 * np.pi * 50.0
    expected = [np.trapezoid(slope * np.exp(-rate * (time - ramp)), ramp) for time in late]
    np.testing.assert_allclose(np.interp(late, record["time"].values, record.values[:, 0]), expected, rtol=0.01)


def test_sums_of_differences_do_not_drift():
    """A tone near half the sampling rate, whose own velocities fold, comes back as the smoothed motion."""
    times = runs.map_times()
    moved = np.zeros((len(times), 1, 3))
    moved[:, 0, 2] = np.sin(2.0 * np.pi * 3700.0 * times) + times
    motion = Motion(times, np.zeros((1, 3)), moved, moved, 0.0, "", "", 0.0)
    slopes = runs.by_differences(motion).velocity_m_s[:, 0, 2]
    summed = np.concatenate([[0.0], np.cumsum(0.5 * (slopes[1:] + slopes[:-1]))]) / runs.MAP_RATE_HZ
    assert np.abs(summed - times)[:-1].max() < 0.05


def test_map_and_trace_agree_in_the_middle():
    trace = traces.measured(ENDLESS, "step", setup.Probe())
    seen = maps.measured_map(ENDLESS, "step", setup.Probe())
    middle = seen.values[len(seen.axis_m) // 2, len(seen.axis_m) // 2]
    assert middle == pytest.approx(np.sqrt(np.mean(trace.values**2)), rel=0.015)
    np.testing.assert_allclose(seen.values, seen.values[:, ::-1])


def test_diameter_of_a_gaussian():
    """exp(-4 ln 2 (r / w)^2) falls to 20 % at r = w sqrt(ln 5 / (4 ln 2))."""
    radii = 1e-3 * np.arange(61)
    seen = maps.round_map(radii, np.exp(-4.0 * np.log(2.0) * (radii / 0.0103) ** 2), 0.01)
    assert step_rows.diameter_of(seen) == pytest.approx(20.6 * np.sqrt(np.log(5.0) / (4.0 * np.log(2.0))), rel=0.01)
    assert 0.0 < step_rows.diameter_error(seen) < 0.5


def test_loudest_radius_of_a_ring():
    radii = runs.circle_radii(True)
    ring = np.exp(-(((radii - 0.011) / 0.004) ** 2))
    circles = maps.Circles(radii, np.repeat(ring[:, None], 12, axis=1), 0.0, 0.0)
    assert modulated_rows.loudest_of(circles) == pytest.approx(0.011, abs=1.1e-3)


def test_linear_elements_are_a_part_of_the_quadratic_ones():
    """Nodes are the same means of corners as a linear field's values; fewer unknowns can't give way further."""
    sizes = Sizes((0.0, 0.0), 0.015, 6e-3, 12e-3, 0.01, 0.01, 0, setup.RADIUS_M, 0.0, 100.0)
    system = build(setup.slab_of(setup.Case()), sizes)
    corners, shares = mesh_rows._from_corners(system.mesh)
    np.testing.assert_allclose(shares @ system.mesh.nodes[corners], system.mesh.nodes, atol=1e-12)
    spread = sparse.kron(shares, sparse.identity(3))
    rigid = np.tile([1.0, 2.0, 3.0], len(corners))
    np.testing.assert_allclose((spread @ rigid).reshape(-1, 3), np.tile([1.0, 2.0, 3.0], (len(system.mesh.nodes), 1)))


def test_linear_elements_lock():
    force = np.zeros(3)
    sizes = Sizes((0.0, 0.0), 0.015, 5e-3, 10e-3, 0.01, 0.01, 0, setup.RADIUS_M, 0.0, 100.0)
    system = build(setup.slab_of(setup.Case()), sizes)
    load = mesh_rows.PressureHistory(mesh_rows._load(setup.Case()), system.mesh, system).final_force()
    force = load / np.linalg.norm(load)
    stiff, soft = mesh_rows._linear(system, force) @ force, mesh_rows.static_of_system(system, force) @ force
    assert 0.2 * soft < stiff < 0.9 * soft


def test_closed_forms():
    assert answer("C3b").value == pytest.approx(0.5437, abs=2e-4)
    assert answer("C9e").value == pytest.approx(2.0, rel=1e-5)
    assert answer("C18c").value == pytest.approx(0.25)
    assert answer("C19e").value == pytest.approx(np.sqrt(3.0 / 8.0) * 2.19)
    assert answer("C13h").value == pytest.approx(0.2 / 0.171)
    assert answer("C10b").value == pytest.approx(20.0 * np.log10(np.sqrt(6.0 * 1.225) * 343.0 / 20e-6))


def test_agreement_of_six_is_by_the_tolerances_of_the_book():
    printed = {name: float(ENTRIES[name].value) for name in filter_rows.SIX}
    assert filter_rows.agreeing(printed) == list(filter_rows.SIX)
    assert filter_rows.agreeing({name: -value for name, value in printed.items()}) == []
    assert len(filter_rows.agreeing({name: 2.1 * value for name, value in printed.items()})) == 0


def test_a_map_on_circles_is_put_on_the_grid():
    """What grows with the radius, and what turns with the angle, are linear between circles and points."""
    radii = runs.circle_radii(True)
    angles = 2.0 * np.pi * np.arange(runs.ANGLES) / runs.ANGLES
    axis = maps.grid_axis()
    x, y = np.meshgrid(axis, axis, indexing="ij")
    inside = np.hypot(x, y) < radii[-1]
    rising = maps.Circles(radii, np.repeat(radii[:, None], runs.ANGLES, axis=1), 0.0, 0.0)
    np.testing.assert_allclose(pictures._on_grid(rising)[inside], np.hypot(x, y)[inside], atol=1e-12)
    turned = maps.Circles(radii, radii[:, None] * np.cos(angles), 0.0, 0.0)
    np.testing.assert_allclose(pictures._on_grid(turned)[inside], x[inside], atol=0.04 * radii[-1])


def test_dominant_line_of_a_tone_and_its_margin():
    times = np.arange(8192) / 32e3
    found = causes.line_of(traces.Trace(times, np.sin(2.0 * np.pi * 210.9375 * times), 0.0))
    assert found.value == pytest.approx(210.9375, abs=0.1)
    assert found.margin == pytest.approx(110.9375, abs=0.1)


def test_chains_are_all_combinations_and_the_base_is_among_them():
    found = chains.chains()
    assert len(found) == len(set(found)) == (1 + 3 * 2) * 2 * 2 * 2 * 3
    assert chains.Chain(2, "causal", False, False, 0.0, "0-256 ms") in found


def test_a_straight_line_is_the_drift_that_a_chain_takes_off():
    """Of a first-order filter's record only the offset and the slope are lost."""
    kept = chains.Chain(1, "causal", False, False, 0.0, "")
    whole = chains._trace(ENDLESS, "step", kept)
    less = chains._trace(ENDLESS, "step", replace(kept, drift=True))
    line = whole.values - less.values
    np.testing.assert_allclose(np.diff(line, 2), 0.0, atol=1e-12)
    assert np.polyfit(whole.times_s, less.values, 1) == pytest.approx([0.0, 0.0], abs=1e-9)


def test_a_filter_without_delay_keeps_an_offset_of_a_record_from_the_trigger():
    """By symmetry half of a step comes before it, and what the record has not is missing from the integral."""
    late, _ = chains.both_ways(ENDLESS, 2, 0.0)
    early, _ = chains.both_ways(ENDLESS, 2, 0.1)
    plain = step_rows.steady_of(traces.raw(ENDLESS, "step"))
    assert late == pytest.approx(0.5 * plain, rel=0.1)
    assert abs(early) < 0.1 * abs(plain)


def test_quick_and_full_maps_look_for_the_largest_at_the_same_circles():
    quick, full = (runs.circle_radii(which) for which in (True, False))
    far = full[full > modulated_rows.FAR_STM_M + 1e-6]
    np.testing.assert_allclose(quick[quick > modulated_rows.FAR_STM_M + 1e-6], far)
    assert far[0] == pytest.approx(0.021)
    assert set(np.round(quick, 6)) <= set(np.round(full, 6))
    assert len(quick) * runs.ANGLES < runs.GROUP
