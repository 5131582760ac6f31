"""The virtual vibrometer against closed forms: beams, filters, integration, sampling, noise."""

import numpy as np
import pytest

from palmfield.errors import MeasurementError
from palmfield.instruments import (
    SurfaceMotion,
    Vibrometer,
    disc_grid,
    highpass,
    integrated,
    line_grid,
    lines_of_sight,
    lowpass,
    of_motion,
    read_settings,
    rectangle_grid,
    sampled,
    vibrometer_record,
)
from palmfield.instruments.scan import pitch

RATE = 16_000.0


def moving(velocity, points=((0.0, 0.0, 0.0),), rate=RATE, seconds=0.5):
    """A surface of which every point has the velocity that a function of time gives, shape (t, 3)."""
    times = np.arange(int(seconds * rate) + 1) / rate
    points = np.array(points, dtype=float)
    values = np.repeat(np.asarray(velocity(times), dtype=float)[:, None, :], len(points), axis=1)
    normals = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    return SurfaceMotion(times, points, normals, integrated(values, rate), values)


def only(t, x=0.0, y=0.0, z=0.0):
    return np.stack([np.broadcast_to(part, t.shape) for part in (x, y, z)], axis=1)


# -- beams ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("azimuth", "enters"), [(0.0, 1.0), (90.0, 0.0), (180.0, -1.0), (60.0, 0.5)])
def test_motion_along_the_surface_enters_with_the_tangent(azimuth, enters):
    for incidence in (30.0, 45.0):
        head = Vibrometer(incidence_deg=incidence, azimuth_deg=azimuth, reading="velocity", sampling_rate_Hz=RATE)
        read = vibrometer_record(moving(lambda t: only(t, x=2e-3, z=-5e-3)), head)
        assert read.values == pytest.approx(-5e-3 + 2e-3 * enters * np.tan(np.radians(incidence)), rel=1e-9)
        raw = vibrometer_record(moving(lambda t: only(t, z=-5e-3)), head.model_copy(update={"as_normal": False}))
        assert raw.values == pytest.approx(-5e-3 * np.cos(np.radians(incidence)), rel=1e-9)


def test_a_rayleigh_wave_at_45_degrees_reads_more_than_its_normal_motion():
    w = 2.0 * np.pi * 200.0
    head = Vibrometer(incidence_deg=45.0, reading="velocity", sampling_rate_Hz=RATE)
    read = vibrometer_record(moving(lambda t: only(t, x=0.54 * np.sin(w * t), z=np.cos(w * t))), head)
    assert np.sqrt(2.0 * np.mean(read.values[:8000] ** 2)) == pytest.approx(np.hypot(1.0, 0.54), rel=1e-6)


def test_beams_of_a_near_head_go_to_the_head():
    points = disc_grid(0.06, 0.02)
    head = Vibrometer(incidence_deg=45.0, azimuth_deg=30.0, distance_m=0.5, aim_m=(0.01, 0.0, 0.0))
    beams = lines_of_sight(points, head)
    assert np.linalg.norm(beams, axis=1) == pytest.approx(1.0)
    at = np.array([0.01, 0.0, 0.0]) + 0.5 * np.array(
        [np.sin(np.pi / 4) * np.cos(np.pi / 6), np.sin(np.pi / 4) * np.sin(np.pi / 6), np.cos(np.pi / 4)]
    )
    assert np.cross(at - points, beams) == pytest.approx(0.0, abs=1e-12)
    far = lines_of_sight(points, head.model_copy(update={"distance_m": 1e4}))
    assert np.abs(far - lines_of_sight(points, head.model_copy(update={"distance_m": None}))).max() < 1e-5


def test_a_head_needs_directions():
    with pytest.raises(MeasurementError, match=r"x_axis .* lies along the normal"):
        lines_of_sight([[0.0, 0.0, 0.0]], Vibrometer(x_axis=(0.0, 0.0, 2.0)))
    with pytest.raises(MeasurementError, match="normal is"):
        lines_of_sight([[0.0, 0.0, 0.0]], Vibrometer(normal=(0.0, 0.0, 0.0)))


def test_a_point_that_turns_its_back_to_the_head_is_named():
    with pytest.raises(MeasurementError, match=r"point 0 at \(0, 0, 0\) m, whose outward normal is \(0, 0, 1\), faces"):
        vibrometer_record(moving(lambda t: only(t, z=1.0)), Vibrometer(normal=(0, 0, -1), sampling_rate_Hz=RATE))


# -- filters and integration ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [1, 2, 4])
@pytest.mark.parametrize("frequency", [20.0, 50.0, 200.0])
def test_gain_of_the_high_pass_is_butterworths(order, frequency):
    times = np.arange(int(4.0 * RATE)) / RATE
    late = times > 3.0
    exact = 1.0 / np.sqrt(1.0 + (50.0 / frequency) ** (2 * order))
    sine = np.sin(2.0 * np.pi * frequency * times)
    rms = {
        phase: np.sqrt(2.0 * np.mean(highpass(sine, RATE, 50.0, order, phase=phase)[late if phase == "causal" else
                                     (times > 1.5) & (times < 2.5)] ** 2))
        for phase in ("causal", "zero_phase")
    }  # fmt: skip
    assert rms["causal"] == pytest.approx(exact, rel=2e-3)
    assert rms["zero_phase"] == pytest.approx(exact**2, rel=4e-3)


def test_a_step_through_a_causal_first_order_decays_exponentially_and_a_zero_phase_filter_foresees_it():
    times = np.arange(int(RATE)) / RATE
    step = (times >= 0.5).astype(float)
    left = highpass(step, RATE, 50.0, 1)[times >= 0.5]
    assert left == pytest.approx(np.exp(-2.0 * np.pi * 50.0 * (times[times >= 0.5] - 0.5)), abs=0.02)
    both = highpass(step, RATE, 50.0, 1, phase="zero_phase")
    assert both[times < 0.5].min() < -0.3 and np.abs(left[-100:]).max() < 1e-6


def test_a_filter_of_order_four_at_50_Hz_of_128_kHz_is_stable():
    times = np.arange(int(0.256 * 128e3)) / 128e3
    out = highpass(np.sin(2.0 * np.pi * 200.0 * times), 128e3, 50.0, 4)
    assert np.abs(out).max() < 1.2


def test_wrong_filters_are_refused():
    for order, cutoff, phase, words in (
        (0, 50.0, "causal", "order of a filter is 0"), (2, 9e3, "causal", "below half the rate"),
        (2, 50.0, "both", "phase is 'both'"), (2, -1.0, "causal", "cutoff_Hz is -1"),
    ):  # fmt: skip
        with pytest.raises(MeasurementError, match=words):
            highpass(np.zeros(100), RATE, cutoff, order, phase=phase)
    with pytest.raises(MeasurementError, match="nan"):
        lowpass([0.0, np.nan, 0.0], RATE, 50.0, 2)


def test_velocity_is_integrated_to_displacement():
    w = 2.0 * np.pi * 200.0
    read = vibrometer_record(
        moving(lambda t: only(t, z=w * np.cos(w * t)), rate=64e3), Vibrometer(sampling_rate_Hz=64e3)
    )
    assert read.values[:, 0] == pytest.approx(np.sin(w * read["time"].values), abs=2e-4)
    assert read.attrs["units"] == "m" and read.name == "displacement"


def test_a_high_pass_makes_the_steady_part_of_a_push_go_away():
    push = moving(lambda t: only(t, z=-0.1 * t * np.exp(-t / 0.01)), seconds=0.4)
    plain = vibrometer_record(push, Vibrometer(sampling_rate_Hz=RATE))
    high = vibrometer_record(push, Vibrometer(sampling_rate_Hz=RATE, highpass_Hz=50.0, highpass_order=2))
    assert plain.values[-1, 0] == pytest.approx(-1e-5, rel=1e-3)
    assert abs(high.values[-1, 0]) < 1e-8 and high.values.min() < 0.0 < high.values.max()


# -- sampling, flight, noise ---------------------------------------------------------------------------------------


def test_sampling_converges_with_the_fourth_power_of_the_step():
    errors = []
    for rate in (2e3, 4e3, 8e3):
        times = np.arange(int(0.1 * rate) + 1) / rate
        at = np.arange(0, 0.0999, 1.0 / 64e3)
        errors.append(np.abs(sampled(times, np.sin(2 * np.pi * 200 * times), at) - np.sin(2 * np.pi * 200 * at)).max())
    assert errors[0] / errors[1] > 10.0 and errors[1] / errors[2] > 10.0


def test_nothing_folds_back_where_the_record_is_coarser_than_the_motion():
    times = np.arange(16_000) / 16e3
    at = np.arange(100, 900) / 1e3
    assert np.abs(sampled(times, np.sin(2 * np.pi * 900.0 * times), at)).max() < 2e-3
    assert sampled(times, np.sin(2 * np.pi * 100.0 * times), at) == pytest.approx(
        np.sin(2 * np.pi * 100.0 * at), abs=2e-3
    )


def test_flight_and_trigger_shift_the_record():
    bump = moving(lambda t: only(t, z=np.exp(-(((t - 0.1) / 0.004) ** 2))))
    head = Vibrometer(sampling_rate_Hz=RATE, reading="velocity", duration_s=0.3, flight_s=0.58e-3, trigger_s=0.02)
    record = vibrometer_record(bump, head)
    exact = np.exp(-(((record["time"].values + 0.02 - 0.58e-3 - 0.1) / 0.004) ** 2))
    assert record.values[:, 0] == pytest.approx(exact, abs=1e-4)
    assert record.sizes["time"] == 4800
    with pytest.raises(MeasurementError, match=r"the motion ends at 0.5 s"):
        vibrometer_record(bump, head.model_copy(update={"duration_s": 0.6}))
    with pytest.raises(MeasurementError, match="needed: four or more"):
        vibrometer_record(bump, head.model_copy(update={"duration_s": 1e-5}))


def test_nothing_is_made_up_of_the_time_before_motion_that_does_not_begin_at_rest():
    swinging = moving(lambda t: only(t, z=np.cos(2.0 * np.pi * 200.0 * t)), seconds=0.1)
    late = swinging._replace(times_s=swinging.times_s + 0.05)
    head = Vibrometer(sampling_rate_Hz=RATE)
    for told, motion in (({"flight_s": 0.58e-3}, swinging), ({}, late)):
        with pytest.raises(MeasurementError, match="with 1e\\+02 % of its largest velocity"):
            vibrometer_record(motion, head.model_copy(update=told))
    assert vibrometer_record(late, head.model_copy(update={"trigger_s": 0.05})).sizes["time"] == 1601


def test_noise_has_its_density_and_falls_with_averages():
    still = moving(lambda t: only(t), points=disc_grid(0.01, 0.005))
    head = Vibrometer(sampling_rate_Hz=RATE, reading="velocity", noise_m_s_rtHz=1e-7, averages=4)
    first, again, other = (vibrometer_record(still, head, seed=seed).values for seed in (1, 1, 2))
    assert first.std() == pytest.approx(1e-7 * np.sqrt(RATE / 2 / 4), rel=0.02)
    assert np.array_equal(first, again) and not np.array_equal(first, other)


# -- grids, settings, solvers' motion ------------------------------------------------------------------------------


def test_grids_have_the_pitch_and_density_that_they_are_asked_for():
    grid = disc_grid(0.06, 0.005)
    assert pitch(grid) == pytest.approx(0.005)
    assert len(grid) / (np.pi * 6.0**2) == pytest.approx(4.0, rel=0.03)
    assert len(rectangle_grid(0.04, 0.02, 0.01)) == 5 * 3
    assert line_grid(0.1, 11, 90.0)[0] == pytest.approx([0.0, -0.05, 0.0])
    with pytest.raises(MeasurementError, match="pitch_m is 0"):
        disc_grid(0.06, 0.0)


def test_settings_are_read_from_a_file_and_wrong_ones_are_named(tmp_path):
    file = tmp_path / "head.toml"
    file.write_text("[vibrometer]\nincidence_deg = 45\ndistance_m = 0.5\nhighpass_Hz = 50\nphase = 'zero_phase'\n")
    head = read_settings(file, Vibrometer)
    assert (head.incidence_deg, head.distance_m, head.phase) == (45.0, 0.5, "zero_phase")
    for text, words in (
        ("[vibrometer]\nincidense_deg = 45\n", r"head.toml: vibrometer: unknown key 'incidense_deg' \(did you mean"),
        ("[vibrometer]\nincidence_deg = 95\n", "'incidence_deg' has value 95; allowed: finite number >= 0 and < 90"),
        ("[vibrometer]\nphase = 'causel'\n", r"key 'phase' has value 'causel' \(did you mean 'causal'\?\); allowed"),
        ("[vibrometer]\naim_m = [0, 0]\n", r"key 'aim_m' has value \[0, 0\]; allowed: three finite numbers"),
        ("[vibrometer]\nas_normal = 'x'\n", r"allowed: true \| false"),
        ("[vibrometer\n", "cannot be read.*a TOML file"),
        ("[vibro]\n", r"has \[vibro\]"), ("", r"has no table \[vibrometer\]"),
    ):  # fmt: skip
        file.write_text(text)
        with pytest.raises(MeasurementError, match=words):
            read_settings(file, Vibrometer)
    with pytest.raises(MeasurementError, match="cannot be read"):
        read_settings(tmp_path / "none.toml", Vibrometer)
    with pytest.raises(MeasurementError, match="vibrometer: key 'averages' has value 0"):
        Vibrometer(averages=0)


def test_a_motion_of_a_solver_has_the_normals_of_its_body():
    from palmfield.skin import Sheet, Slab, Spot, preset, solve

    body = Slab((Sheet(preset("ecoflex_00-10"), 0.02),))
    load = Spot(fwhm_m=0.0103, times_s=[0.0, 1e-3], peak_Pa=[0.0, 12.0])
    times = np.arange(0.0, 0.0201, 2e-4)
    motion = solve(body, load, times=times, at=[[0.0, 0.0], [0.01, 0.0]], accuracy=0.02)
    seen = of_motion(motion, body)
    assert np.array_equal(seen.normals, [[0.0, 0.0, 1.0]] * 2)
    record = vibrometer_record(seen, Vibrometer(sampling_rate_Hz=128e3))
    pushed = motion.displacement_m[:, 0, 2]
    assert record.values[-1, 0] == pytest.approx(pushed[-1] - pushed[0], rel=2e-3)
