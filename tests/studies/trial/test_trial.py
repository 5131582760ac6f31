"""Trials against what a hand at constant speed, sums of pistons and statistics of phases say."""

import numpy as np
import pytest
from scipy.special import j1

import palmfield
from palmfield.acoustics.air import absorption_Np_m, sound_speed
from palmfield.acoustics.arrays import layout
from palmfield.acoustics.calibration_file import Calibration, Elements, write_calibration
from palmfield.drive.boards import BOARDS
from palmfield.drive.frame_log import read_log
from palmfield.hardware.decode import decode
from palmfield.session.preview import preview
from palmfield.studies.trial import Tracker, trial
from palmfield.studies.trial.course import PoseEstimator, SceneCourse
from palmfield.types import Air

SPEED_m_s = np.array([0.2, 0.1, 0.05])
START_m = np.array([-0.02, -0.01, 0.12])
LATENCY_S = 0.02
AT_ONCE = Tracker(rate_Hz=0.0, latency_s=0.0, ahead_s=0.0)
LATE = Tracker(rate_Hz=0.0, latency_s=LATENCY_S, ahead_s=0.0)


def test_no_latency_and_an_ideal_board_give_no_error(moving_scene):
    result = trial(moving_scene(), tracker=AT_ONCE, skin=False, flight=False)
    assert len(result.moments) == 250
    assert max(np.linalg.norm(one.sounding - one.true) for one in result.moments) < 1e-7
    assert result.numbers.kept.least == pytest.approx(1.0, abs=1e-12)
    assert result.numbers.distance_mm.largest < 1e-4


@pytest.mark.parametrize("flight", [False, True])
def test_a_hand_at_constant_speed_is_missed_by_speed_times_latency(moving_scene, flight):
    """Frames of 258 bytes at 23,040 bytes/s, every 12 ms as MuJoCo's steps are 1 ms, held until the next one."""
    result = trial(moving_scene(), board="sonicsurface", tracker=LATE, skin=False, flight=flight)
    line_s, period_s = 258 / 23040, 0.012
    misses = []
    for one in result.moments:
        if one.time_s < 0.05:
            continue
        way_s = np.linalg.norm(START_m + SPEED_m_s * one.time_s) / sound_speed(Air()) if flight else 0.0
        held_s = (one.time_s - way_s) % period_s
        if min(held_s, period_s - held_s) < 1e-4:
            continue
        latency_s = LATENCY_S + line_s + held_s + way_s
        miss = one.true - one.believed
        np.testing.assert_allclose(miss, SPEED_m_s * latency_s, rtol=2e-3)
        assert one.age_s == pytest.approx(latency_s, rel=2e-3)
        misses.append((one.true - one.sounding) - miss)
    assert len(misses) > 150
    # What the bytes make of it: 32 phases
    assert np.abs(misses)[:, :2].max() < 0.1e-3 and np.abs(misses)[:, 2].max() < 0.6e-3
    # Largest at the end of a hold, one look before the next frame
    longest_s = LATENCY_S + line_s + period_s + (0.4e-3 if flight else 0.0)
    most_mm = 1e3 * np.linalg.norm(SPEED_m_s) * longest_s
    assert 0.9 * most_mm < result.numbers.distance_mm.largest < 1.02 * most_mm


def test_packets_of_a_focus_are_as_late_as_their_line_and_their_sync(moving_scene):
    """9 bytes of AUTD at 18,000 bytes/s take 0.5 ms, and sound for 0.5 ms from the next sync on."""
    result = trial(moving_scene(), board="autd2018", tracker=LATE, skin=False, flight=False, duration_s=0.12)
    assert result.numbers.frames_due == 240 and result.numbers.frames_dropped == 0
    checked = 0
    for one in result.moments:
        if one.time_s > 0.05:
            age_s = (one.true - one.believed) @ SPEED_m_s / (SPEED_m_s @ SPEED_m_s)
            assert LATENCY_S + 0.5e-3 - 1e-6 < age_s < LATENCY_S + 1.5e-3 + 1e-6
            # A packet's places are whole 0.025 mm, and phases 640 steps
            np.testing.assert_allclose(one.sounding, one.believed, atol=0.05e-3)
            checked += 1
    assert checked > 60


def test_prediction_takes_a_constant_speed_away(moving_scene):
    tracker = Tracker(rate_Hz=90.0, latency_s=0.01)
    result = trial(moving_scene(), board="sonicsurface", tracker=tracker, skin=False)
    late = [one for one in result.moments if one.time_s > 0.12]
    held = [np.linalg.norm(one.true - one.believed) for one in late]
    # Half a period before and after the middle for which it was predicted, and phases' steps
    assert max(held) < np.linalg.norm(SPEED_m_s) * 0.5 * 0.012 + 0.1e-3
    assert min(one.age_s for one in late) > 0.01 + 258 / 23040


def pistons(point, focus, array, air):
    """Pressure [Pa] of each transducer, a piston in a baffle, of a focus elsewhere: with SciPy's Bessel function."""
    k = 2 * np.pi * array.frequency_Hz / sound_speed(air)
    away, to_focus = (place - array.positions for place in (point, focus))
    d, f = np.linalg.norm(away, axis=1), np.linalg.norm(to_focus, axis=1)
    cosine = np.einsum("ij,ij->i", away, array.normals) / d
    x = k * array.piston_radius_m * np.sqrt(1 - cosine**2)
    shape = np.where(x < 1e-6, 1.0, 2 * j1(x) / np.where(x < 1e-6, 1.0, x))
    loss = np.exp(-absorption_Np_m(air, array.frequency_Hz) * d)
    return array.p0_Pa_m * shape * loss / d * np.exp(1j * k * (d - f))


def test_pressure_lost_by_a_frozen_focus_is_that_of_a_sum_of_pistons(moving_scene):
    path = moving_scene(array={"directivity": "piston"})
    result = trial(path, tracker=Tracker(0.0, 1.0, ahead_s=0.0), skin=False, flight=False)
    array, air = layout("uhev1"), Air()
    for one in result.moments[::25]:
        true = START_m + SPEED_m_s * one.time_s
        wanted, late = abs(pistons(true, true, array, air).sum()), abs(pistons(true, START_m, array, air).sum())
        assert one.pressures.target == pytest.approx(wanted, rel=1e-4)
        assert one.pressures.late == pytest.approx(late, rel=1e-3, abs=1e-4 * wanted)
    assert result.numbers.kept_late.least < 0.2
    assert result.numbers.kept_rounded.least == pytest.approx(1.0, abs=1e-9)


def test_rounding_costs_what_random_phases_cost(moving_scene):
    """Phases rounded to 32 steps are wrong by up to half a step, evenly: the sum keeps sin(pi/32)/(pi/32)."""
    result = trial(moving_scene(), board="sonicsurface", tracker=AT_ONCE, skin=False)
    assert result.numbers.kept_rounded.mean == pytest.approx(np.sinc(1 / 32), abs=1e-3)
    assert result.numbers.kept_rounded.mean < 1.0
    assert result.numbers.kept_calibration is None


def test_unknown_delays_cost_what_statistics_say(moving_scene, tmp_path):
    """Delays of 20 degrees (sd) leave about exp(-sd^2/2) of the pressure, and two dead of 256 another 2/256."""
    random, count = np.random.default_rng(3), 256
    phases = np.radians(random.normal(0.0, 20.0, count))
    phases -= phases.mean()
    enabled = np.ones(count, bool)
    enabled[[17, 200]] = False
    elements = Elements(
        enabled=tuple(enabled.tolist()), polarity=(1,) * count, phase_rad=tuple(phases.tolist()), gain=(1.0,) * count
    )
    write_calibration(tmp_path / "truth.json", Calibration(layout="sonicsurface", elements=elements))
    result = trial(
        moving_scene(), board="sonicsurface", tracker=AT_ONCE, truth=tmp_path / "truth.json", skin=False, duration_s=0.1
    )
    kept = result.numbers.kept_calibration
    assert kept is not None
    assert kept.mean == pytest.approx(np.exp(-0.5 * np.radians(20.0) ** 2) * 254 / 256, abs=0.03)
    # Exactly so for these delays, but for what 32 steps add
    array, air = layout("sonicsurface"), Air()
    for one in result.moments[5::10]:
        each = pistons(one.true, one.believed, array, air)
        expected = abs((np.exp(1j * phases) * enabled) @ each) / abs(each.sum())
        assert one.pressures.played / one.pressures.rounded == pytest.approx(expected, abs=4e-3)


def test_half_of_all_transducers_turned_make_no_focus(moving_scene, tmp_path):
    polarity = tuple(np.where(np.arange(256) % 2, 1, -1).tolist())
    elements = Elements(enabled=(True,) * 256, polarity=polarity, phase_rad=(0.0,) * 256, gain=(1.0,) * 256)
    write_calibration(tmp_path / "truth.json", Calibration(layout="sonicsurface", elements=elements))
    path = moving_scene(array={"layout": "sonicsurface"}, driver={"board": "sonicsurface"})
    tracker, truth = Tracker(ahead_s=0.0), tmp_path / "truth.json"
    result = trial(path, board="sonicsurface", tracker=tracker, truth=truth, skin=False, duration_s=0.05)
    assert result.numbers.without_focus == 1.0 and "no focus for 100.0 %" in str(result)
    assert result.numbers.kept_calibration.mean < 0.3
    known = {"array.calibration": str(truth)}
    mended = trial(path, board="sonicsurface", tracker=tracker, keys=known, truth=truth, skin=False, duration_s=0.05)
    assert mended.numbers.without_focus == 0.0
    assert mended.numbers.kept_calibration.least == pytest.approx(1.0, abs=1e-9)


def test_the_files_of_a_trial_agree(moving_scene, tmp_path):
    out = tmp_path / "out"
    result = trial(moving_scene(), board="sonicsurface", skin=False, out=out, duration_s=0.1)
    assert sorted(result.files) == ["course.csv", "sent.jsonl", "trial.json", "trial.png"]
    _, pieces = read_log(out / "sent.jsonl")
    board = BOARDS["sonicsurface"]
    frames = [one.frame.data for one in result.sent.frames]
    assert [piece.data for piece in pieces] == [board.start, *frames, board.stop]
    foci = np.array([one.focus for one in decode(out / "sent.jsonl").foci if one.sounding])
    for place in foci:
        assert np.linalg.norm(np.array([one.sounding for one in result.moments]) - place, axis=1).min() < 1e-6
    with pytest.raises(palmfield.OutputError, match="contains another trial"):
        trial(moving_scene(), board="sonicsurface", skin=False, out=out)


def test_the_course_of_a_tracked_hand_ends_where_it_reaches_into_the_array(moving_scene, tmp_path):
    path = moving_scene()
    rows = ["0,0,0,0.1,0,1,0,0", "0.1,0,0,-0.1,0,1,0,0", "0.5,0,0,-0.1,0,1,0,0"]
    (tmp_path / "straight.csv").write_text("\n".join(["time_s,x_m,y_m,z_m,qw,qx,qy,qz", *rows]) + "\n")
    with pytest.raises(palmfield.SceneError, match="is too close to the array"):
        SceneCourse(preview(path, device="cpu"), 0.1)
    course = SceneCourse(preview(path, device="cpu"), 0.1, as_far_as_it_goes=True)
    # 2 m/s from 100 mm above it on
    assert "is too close to the array" in course.refused and 0.03 < course.end_s < 0.051
    assert course.frames(0.09).positions[-1][2] == course.frames(course.end_s).positions[-1][2] > 0.0


def test_sound_rises_and_falls_within_the_drivers_ramp(moving_scene, tmp_path):
    """By the bytes: a raised cosine over 20 ms at both ends of the trial, which costs no share of the pressure."""
    out = tmp_path / "out"
    keys = {"driver.ramp_s": 0.02}
    result = trial(moving_scene(), board="autd3", keys=keys, skin=False, out=out, duration_s=0.1)
    board, levels = BOARDS["autd3"], {}
    for one in result.sent.frames:
        intensities = np.frombuffer(one.frame.data, np.uint8)[249:]
        assert np.ptp(intensities) == 0
        levels[one.due_s] = intensities[0] / 255
    rise = [0.5 - 0.5 * np.cos(np.pi * min(t, 0.1 - t) / 0.02) if min(t, 0.1 - t) < 0.02 else 1.0 for t in levels]
    np.testing.assert_allclose(list(levels.values()), rise, atol=0.5 * np.pi / 512 + 0.5 / 255)
    assert min(levels.values()) < 0.01 and max(levels.values()) == 1.0
    plain = trial(moving_scene(), board="autd3", skin=False, duration_s=0.1)
    # What is told of the pressure is told at full level, where it is loud enough
    full_at = {one.time_s: one.pressures for one in plain.moments}
    loud = [(one.pressures, full_at[one.time_s]) for one in result.moments if one.level > 0.4]
    assert len(loud) > 50
    for ramped, full in loud:
        np.testing.assert_allclose(ramped, full, rtol=5e-3)
    # A board without levels has none
    hard = trial(moving_scene(), board="sonicsurface", keys=keys, skin=False, duration_s=0.05)
    assert all(32 not in one.frame.data[1:-1] for one in hard.sent.frames) and board.levels


def test_ctrl_c_keeps_what_there_is(moving_scene, tmp_path, monkeypatch):
    asked, at = [], PoseEstimator.at

    def cut(self, now_s, sound_s):
        asked.append(now_s)
        if len(asked) == 8:
            raise KeyboardInterrupt
        return at(self, now_s, sound_s)

    monkeypatch.setattr(PoseEstimator, "at", cut)
    result = trial(moving_scene(), board="sonicsurface", skin=False, out=tmp_path / "out")
    assert result.interrupted and result.numbers.frames_sent == 7
    assert 60 < len(result.moments) < 100
    assert (tmp_path / "out" / "course.csv").exists() and "ended by Ctrl-C at" in str(result)
    # The last of what was emitted is silence
    assert not result.sent.emitted[-1].amplitudes.any()


@pytest.mark.wall_clock
def test_a_virtual_board_in_real_time_gives_the_foci_of_its_frames(moving_scene):
    result = trial(moving_scene(), board="sonicsurface", port="virtual", tracker=LATE, skin=False, duration_s=0.2)
    sent = result.sent
    assert len(sent.frames) >= 1 and sent.dropped == sent.due - len(sent.frames) and not sent.flags
    sounding = [one for one in sent.emitted if one.amplitudes.any()]
    assert len(sounding) == len(sent.frames)
    for frame, one in zip(sent.frames, sounding, strict=True):
        np.testing.assert_allclose(one.amplitudes, BOARDS["sonicsurface"].decode(frame.frame.data)[-1])
    for one in result.moments:
        # Before its first pose the scene keeps still
        if one.time_s - one.age_s > 0.0:
            np.testing.assert_allclose(one.true - one.believed, SPEED_m_s * one.age_s, atol=2e-5)


@pytest.mark.wall_clock
def test_on_a_port_the_drivers_limits_hold(moving_scene):
    keys = {"driver.on_time_s": "0.05"}
    result = trial(moving_scene(), board="sonicsurface", port="virtual", keys=keys, skin=False, duration_s=0.25)
    assert any(
        "silenced: the time with sound has reached 0.05 s, the limit on_time_s" in text for text in result.sent.notes
    )
    assert result.numbers.frames_sent < result.numbers.frames_due
    too_loud = {"driver.head_m": "0 0 0.5", "driver.head_limit_dB": "60"}
    with pytest.raises(palmfield.DeviceError, match="head_limit_dB allows 60"):
        trial(moving_scene(), board="sonicsurface", port="virtual", keys=too_loud, skin=False, duration_s=0.1)


def test_what_cannot_be_tried_is_refused(moving_scene):
    path = moving_scene()
    with pytest.raises(palmfield.DeviceError, match="takes no bytes and has no port"):
        trial(path, port="virtual")
    modulated = {"stimulus.modulation": "am", "stimulus.am_quantity": "arp", "stimulus.am_frequency_Hz": 200,
                 "stimulus.am_depth": 1}  # fmt: skip
    with pytest.raises(palmfield.DeviceError, match="sonicsurface gives"):
        trial(path, board="sonicsurface", keys=modulated)
    with pytest.raises(palmfield.SceneError, match="tracker latency has value 2; allowed: 0 to 1"):
        Tracker(latency_s=2.0)
    with pytest.raises(palmfield.SceneError, match="no history to predict from"):
        Tracker(rate_Hz=0.0)
