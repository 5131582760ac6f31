"""What may be played: ramps in the bytes, limits that refuse, and levels at a head against one transducer's own law."""

import logging
import math
from pathlib import Path

import numpy as np
import pytest

import palmfield
from palmfield.acoustics.air import absorption_Np_m
from palmfield.acoustics.arrays import layout
from palmfield.acoustics.reference import pressure64
from palmfield.config import DriverConfig
from palmfield.drive.boards import BOARDS
from palmfield.hardware.focus_board import FocusSound
from palmfield.hardware.play import Target, play_focus, play_scene
from palmfield.hardware.safety.exposure import Exposure, SoundMoment, at_head, check_head, with_band
from palmfield.hardware.safety.scene_sound import moments_of, scene_at_head
from palmfield.session.preview import preview
from palmfield.types import Air

SCENES = Path(__file__).parents[2] / "mjcf" / "scenes"
POINT = (0.0, 0.0, 0.15)


def test_a_head_hears_one_transducer_by_its_own_law():
    """p0/r e^{-alpha r} on its axis: the loudest place of a ball is the nearest one, where the axis goes through."""
    array = layout("sonicsurface", 2.0)
    drive = np.zeros(256, complex)
    drive[40] = 1.0
    x, y, _ = array.positions[40]
    head = DriverConfig(head_m=(x, y, 0.5), head_radius_m=0.1)
    moments = [SoundMoment(lambda points: pressure64(points, array, drive, Air())[0], 0.25)]
    loudest = at_head(moments, head, array.positions)
    away = 0.5 - array.positions[40, 2] - 0.1
    peak = 2.0 / away * math.exp(-absorption_Np_m(Air(), 40e3) * away)
    assert loudest.peak_Pa == pytest.approx(peak, rel=1e-6)
    np.testing.assert_allclose(loudest.place, [x, y, 0.4], atol=1e-12)
    assert loudest.level_dB == pytest.approx(20 * math.log10(peak / math.sqrt(2) / 20e-6), abs=1e-4)
    # On for a quarter of the time: 6 dB less of energy
    assert loudest.mean_level_dB == pytest.approx(loudest.level_dB - 10 * math.log10(4.0), abs=1e-6)
    assert loudest.dose_dB(8 * 360.0) == pytest.approx(loudest.mean_level_dB - 10.0, abs=1e-6)


def test_limits_count_with_p0_at_the_high_end_of_its_range():
    loudest = with_band(Exposure(np.zeros(3), math.sqrt(2.0) * 20e-6 * 10**4.9, 0.0), (0.5, 2.0))
    assert loudest.level_dB == pytest.approx(98.0) and loudest.most_dB == pytest.approx(98.0 + 10 * math.log10(2.0))
    assert "above 100 dB" in check_head(loudest, DriverConfig())[0]
    assert check_head(with_band(loudest, (0.5, 1.5)), DriverConfig()) == []
    with pytest.raises(palmfield.DeviceError, match=r"98 dB SPL .* up to 101 dB .* head_limit_dB allows 100"):
        check_head(loudest, DriverConfig(head_limit_dB=100.0))
    assert "above 110 dB" in check_head(with_band(loudest, (0.5, 20.0)), DriverConfig())[0]


def test_a_head_on_the_board_is_refused():
    array = layout("sonicsurface")
    with pytest.raises(palmfield.SceneError, match="m from a transducer"):
        at_head([], DriverConfig(head_m=(0.0, 0.0, 0.05)), array.positions)
    with pytest.raises(palmfield.SceneError, match="head is not declared"):
        at_head([], DriverConfig(), array.positions)


def test_a_focus_too_loud_for_the_head_is_not_played(tmp_path, caplog):
    keys = {"head_m": "0 0 0.5", "head_limit_dB": "90"}
    target = Target(record=tmp_path / "x.bin")
    with pytest.raises(palmfield.DeviceError, match="head_limit_dB allows 90"):
        play_focus(POINT, "sonicsurface", target, 0.2, keys=keys)
    assert not list(tmp_path.iterdir())
    with caplog.at_level(logging.WARNING, "palmfield"):
        play_focus(POINT, "sonicsurface", target, 0.2, keys={"head_m": "0 0 0.5"})
    assert "an interim limit" in caplog.text


def test_a_scene_too_loud_for_the_head_is_not_played(tmp_path):
    keys = {"driver.head_m": "0 0 0.6", "driver.head_limit_dB": "80"}
    scene = SCENES / "palm_circle_sonicsurface.xml"
    with pytest.raises(palmfield.DeviceError, match="head_limit_dB allows 80"):
        play_scene(scene, None, Target(record=tmp_path / "x.bin"), 0.1, keys=keys)
    assert not list(tmp_path.iterdir())
    loudest = scene_at_head(preview(scene, keys=keys), 0.1)
    # Against the field in float64 of what the frames emit, over the same ball
    view = preview(scene, keys=keys)
    emission, posed = view.runtime.work.emission, view.runtime.posed
    drives = [emission.commanded(posed, np.array([t]))[0] for t in moments_of(96, 0.1)]
    assert loudest.peak_Pa == pytest.approx(
        max(abs(posed.arrays.pressure64(loudest.place[None], drive)[0]) for drive in drives), rel=1e-3
    )
    assert np.linalg.norm(loudest.place - [0.0, 0.0, 0.6]) <= 0.1 * (1 + 1e-6)


def test_ramps_are_in_the_bytes_of_focuses_and_scenes(tmp_path):
    def levels(path: Path, board: str) -> np.ndarray:
        emitted = BOARDS[board].decode(path.read_bytes())
        return np.array([np.abs(one).mean() for one in emitted])

    path = tmp_path / "x.bin"
    done = play_focus(POINT, "openmpd", Target(record=path), 1.0, keys={"ramp_s": "0.3"})
    assert "sound rises and falls within 300 ms" in done.text
    loudest = levels(path, "openmpd")
    top = int(loudest.argmax())
    assert np.all(np.diff(loudest[: top + 1]) >= -1e-9) and loudest[-2] < 0.2 * loudest.max()
    assert len(np.unique(np.round(loudest[loudest > 0], 6))) > 8
    scene = SCENES / "palm_circle_sonicsurface.xml"
    done = play_scene(scene, None, Target(record=path), 0.5, keys={"driver.ramp_s": "0.2", "driver.dither": "on"})
    loudest = levels(path, "sonicsurface")
    assert done.warning == "", "steps of the ramp are more than the line can carry"
    assert loudest[4] < 0.3 and loudest[len(loudest) // 2] == pytest.approx(1.0, abs=0.01)
    done = play_scene(scene, None, Target(record=path), 0.2, keys={"driver.ramp_s": "0.1"})
    assert "no ramp: sonicsurface has no levels" in done.text


def test_a_play_longer_than_its_budget_is_refused(tmp_path):
    target = Target(record=tmp_path / "x.bin")
    with pytest.raises(palmfield.DeviceError, match="on_time_s allows 1"):
        play_focus(POINT, "sonicsurface", target, 2.0, keys={"on_time_s": "1"})
    with pytest.raises(palmfield.DeviceError, match="duty_limit allows 50 %"):
        play_focus(POINT, "sonicsurface", target, 2.0, keys={"duty_limit": "0.5"})
    assert not list(tmp_path.iterdir())
    play_focus(POINT, "sonicsurface", target, 2.0, sound=FocusSound(level=0.0), keys={"duty_limit": "0.5"})


def test_another_board_keeps_what_is_allowed():
    scene = SCENES / "palm_circle_sonicsurface.xml"
    keys = {"driver.head_m": "0 0 0.6", "driver.on_time_s": "3", "driver.duty_limit": "0.5"}
    driver = preview(scene, board="autd2018", keys=keys).runtime.spec.driver
    assert (driver.board, driver.head_m, driver.on_time_s, driver.duty_limit) == (
        "autd2018", (0.0, 0.0, 0.6), 3.0, 0.5,
    )  # fmt: skip


def test_a_modulated_focus_is_as_loud_at_the_head_as_its_loudest_moment(tmp_path):
    """Its first frame is half as loud, by which a limit must not go."""
    head = {"head_m": "0 -0.3 0.5", "head_limit_dB": "134"}
    target = Target(record=tmp_path / "x.bin")
    for modulation_Hz in (0.0, 200.0):
        sound = FocusSound(am_frequency_Hz=modulation_Hz)
        with pytest.raises(palmfield.DeviceError, match=r"133 dB SPL .* up to 13\d dB within the range of p0"):
            play_focus(POINT, "autd3", target, 0.1, sound=sound, keys=head)
    # A pressure that is given has no range, and the level then is below the limit
    play_focus(POINT, "autd3", target, 0.1, sound=FocusSound(p0_Pa_m=layout("autd3").p0_Pa_m), keys=head)
    said = play_focus(POINT, "autd3", target, 0.1, sound=FocusSound(am_frequency_Hz=200.0)).text
    assert said.splitlines()[-1] == play_focus(POINT, "autd3", target, 0.1).text.splitlines()[-1]


def test_the_loudest_place_is_found_among_many_that_are_nearly_as_loud():
    """Beside a focus and below it, where lobes cross: against every place of a grid of 2 mm, in float64."""
    array = layout("sonicsurface", 2.0)
    drive = np.exp(-2j * np.pi * 40e3 / 343.0 * np.linalg.norm(array.positions - [0.03, 0.02, 0.12], axis=1))
    head = DriverConfig(head_m=(0.0, -0.1, 0.2), head_radius_m=0.06)
    moments = [SoundMoment(lambda points: pressure64(points, array, drive, Air())[0], 1.0)]
    loudest = at_head(moments, head, array.positions)
    steps = np.arange(-0.06, 0.0601, 2e-3)
    ball = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
    ball = ball[np.linalg.norm(ball, axis=1) <= 0.06] + [0.0, -0.1, 0.2]
    peaks = np.abs(pressure64(ball, array, drive, Air())[0])
    assert loudest.peak_Pa >= peaks.max() * (1 - 1e-9)
    assert loudest.peak_Pa < peaks.max() * 1.03
    assert np.linalg.norm(loudest.place - [0.0, -0.1, 0.2]) <= 0.06 * (1 + 1e-9)
    # It is the loudest place that is compared, not a mean over the ball
    assert 20 * math.log10(loudest.peak_Pa / np.sqrt(np.mean(peaks**2))) > 3.0


def test_what_is_loud_at_one_moment_only_is_what_counts():
    array = layout("sonicsurface", 2.0)
    soft, loud = np.full(256, 0.01 + 0j), np.ones(256, complex)
    head = DriverConfig(head_m=(0.0, 0.0, 0.5), head_radius_m=0.05)

    def moment(drive):
        return SoundMoment(lambda points: pressure64(points, array, drive, Air())[0], 0.01)

    short = at_head([*[moment(soft)] * 20, moment(loud)], head, array.positions)
    assert short.peak_Pa == at_head([moment(loud)], head, array.positions).peak_Pa
    assert short.mean_level_dB < short.level_dB - 15.0
