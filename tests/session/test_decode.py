"""Logs, the foci that bytes make, and bytes sent again."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

import palmfield
from palmfield.drive.boards import BOARDS
from palmfield.drive.frame_log import FrameLog, LogHead, read_log
from palmfield.session.decode import as_table, decode, write_csv
from palmfield.session.play import FocusSound, Target, play_focus, play_scene
from palmfield.types import Air

SCENES = Path(__file__).parents[2] / "mjcf" / "scenes"
POINT = (0.02, -0.01, 0.15)


def sounding(path: Path, board: str | None = None):
    return [row for row in decode(path, board).foci if np.isfinite(row.focus[0])]


@pytest.mark.parametrize("board", ["sonicsurface", "sonicsurface_tactile", "openmpd", "autd2018", "autd3"])
def test_a_focus_that_was_sent_is_read_back_from_log_and_bytes(board, tmp_path):
    target = Target(record=tmp_path / "x.bin", log=tmp_path / "x.jsonl")
    air = Air(temperature_C=30.0)
    told = play_focus(POINT, board, target, 0.25, sound=FocusSound(air=air if board != "autd2018" else Air()))
    assert "mm nearer to the array than the focus" in told.text
    rows = sounding(target.log)
    assert len(rows) == 3
    for row in rows:
        np.testing.assert_allclose(row.focus, POINT, atol=3e-4)
    assert np.diff([row.time_s for row in rows]) == pytest.approx(0.1, abs=1e-3)
    if board == "autd2018":
        return
    # Raw bytes don't tell the air, in which the same phases have their focus elsewhere
    raw = sounding(target.record, board)
    assert len(raw) == 3 and abs(raw[0].focus[2] - POINT[2]) > 1e-3


def test_a_level_is_the_pulse_width(tmp_path):
    log = tmp_path / "x.jsonl"
    play_focus(POINT, "openmpd", Target(record=tmp_path / "x.bin", log=log), 0.1, sound=FocusSound(level=0.4))
    assert sounding(log)[0].level == pytest.approx(0.4, abs=np.pi / 2 / 128)


def test_a_modulated_focus_is_sent_at_the_boards_rate(tmp_path):
    log = tmp_path / "x.jsonl"
    sound = FocusSound(am_frequency_Hz=100.0)
    play_focus(POINT, "autd2018", Target(record=tmp_path / "x.bin", log=log), 0.05, sound=sound)
    rows = decode(log).foci[1:]  # after the start sequence
    levels = np.array([row.level for row in rows[:100]])
    wanted = 0.5 * (1.0 + np.sin(2 * np.pi * 100.0 * np.arange(100) / 2000.0))
    np.testing.assert_allclose(levels, wanted, atol=0.004)
    with pytest.raises(palmfield.DeviceError, match="200 frames/s"):
        play_focus(POINT, "openmpd", Target(record=tmp_path / "y.bin"), 0.05, sound=sound)


def test_level_and_modulation_are_refused_where_there_is_only_off_and_full(tmp_path):
    with pytest.raises(palmfield.DeviceError, match="continuous amplitude"):
        play_focus(POINT, "sonicsurface", Target(record=tmp_path / "x.bin"), 0.1, sound=FocusSound(level=0.5))
    told = play_focus(
        POINT,
        "sonicsurface",
        Target(record=tmp_path / "x.bin"),
        0.1,
        sound=FocusSound(level=0.5),
        keys={"dither": "on"},
    )
    assert told.text.startswith("wrote")
    data = (tmp_path / "x.bin").read_bytes()
    frame = BOARDS["sonicsurface"].decode(data)[2]
    assert np.mean(np.abs(frame) > 0) == pytest.approx(0.5, abs=0.01)


def test_the_points_of_a_scenes_circle_come_back(tmp_path):
    scene = SCENES / "palm_circle_sonicsurface.xml"
    told = play_scene(scene, None, Target(record=tmp_path / "c.bin", log=tmp_path / "c.jsonl"), 0.09)
    assert "258 bytes a frame, 88 frames/s due, the line takes 89.3" in told.text
    rows = sounding(tmp_path / "c.jsonl")
    assert len(rows) == 8
    for number, row in enumerate(rows):
        angle = 2 * np.pi * number / 8
        np.testing.assert_allclose(row.focus[:2], [0.015 * np.cos(angle), 0.015 * np.sin(angle)], atol=3e-4)
        assert row.focus[2] == pytest.approx(0.2, abs=1e-3)


def test_a_log_can_be_read_half_way(tmp_path):
    path = tmp_path / "x.jsonl"
    log = FrameLog(path, LogHead("sonicsurface", 256, "sonicsurface"))
    log.add(0.0, b"\xfe\x01")
    log.add(0.5, b"\x02", whole=False)
    head, pieces = read_log(path)
    assert head.board == "sonicsurface" and [piece.whole for piece in pieces] == [True, False]
    assert json.loads(path.read_text().splitlines()[1]) == {"t": 0.0, "hex": "fe01"}
    with path.open("a") as file:
        file.write('{"t": 1.0, "he')
    assert read_log(path)[1] == pieces
    log.close()


@pytest.mark.parametrize(
    ("text", "words"),
    [("hello", "no log"), ('{"palmfield_log": 2}', "version 2; allowed: 1"), ('{"palmfield_log": 1}', "no log")],
)
def test_what_is_no_log_is_refused(text, words, tmp_path):
    path = tmp_path / "x.jsonl"
    path.write_text(text)
    with pytest.raises(palmfield.SceneError, match=words):
        read_log(path)


def test_raw_bytes_need_a_board(tmp_path):
    path = tmp_path / "x.bin"
    path.write_bytes(b"\xfe")
    with pytest.raises(palmfield.SceneError, match="name it by --board"):
        decode(path)
    with pytest.raises(palmfield.SceneError, match="can't be read"):
        decode(tmp_path / "none", "sonicsurface")


def test_table_and_csv_have_every_row(tmp_path):
    log = tmp_path / "x.jsonl"
    play_focus(POINT, "sonicsurface", Target(record=tmp_path / "x.bin", log=log), 0.25)
    decoded = decode(log)
    write_csv(decoded, tmp_path / "x.csv")
    with (tmp_path / "x.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(decoded.foci)
    assert float(rows[2]["z_m"]) == pytest.approx(POINT[2], abs=1e-3)
    assert as_table(decoded).count("\n") == len(rows) + 1
    assert "and 6 more" in as_table(decoded, most=1)
