"""Logs, the foci that bytes make, and bytes sent again."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import palmfield
from palmfield.acoustics.air import sound_speed
from palmfield.acoustics.arrays import layout
from palmfield.acoustics.calibration_file import Calibration, Elements, Pose, write_calibration
from palmfield.config import DriverConfig
from palmfield.drive.boards import BOARDS, board_of
from palmfield.drive.frame_log import FrameLog, LogHead, read_log
from palmfield.hardware.decode import as_table, decode, write_csv
from palmfield.hardware.focus_board import FocusSound
from palmfield.hardware.play import Target, play_focus, play_scene, scene_frames
from palmfield.session.preview import preview
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
    with pytest.raises(palmfield.DeviceError, match="no --am-frequency and --level 1") as refused:
        play_focus(POINT, "sonicsurface", Target(record=tmp_path / "x.bin"), 0.1, sound=FocusSound(level=0.5))
    assert "continuous amplitude" in str(refused.value) and "modulation none" not in str(refused.value)
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
    assert "258 bytes per frame, 88 frames/s due, capacity of the line 89.3" in told.text
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
    [("hello", "not a log"), ('{"palmfield_log": 2}', "version 2; allowed: 1"), ('{"palmfield_log": 1}', "not a log")],
)
def test_what_is_no_log_is_refused(text, words, tmp_path):
    path = tmp_path / "x.jsonl"
    path.write_text(text)
    with pytest.raises(palmfield.SceneError, match=words):
        read_log(path)


def test_raw_bytes_need_a_board(tmp_path):
    path = tmp_path / "x.bin"
    path.write_bytes(b"\xfe")
    with pytest.raises(palmfield.SceneError, match="give it by --board"):
        decode(path)
    with pytest.raises(palmfield.SceneError, match="cannot be read"):
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


def measured_board(path: Path) -> Path:
    """Half of the transducers turned, delays, three silent, and the board 2 mm aside and turned."""
    rng = np.random.default_rng(5)
    elements = Elements(
        polarity=tuple(rng.choice([-1, 1], 256).tolist()),
        phase_rad=tuple(rng.normal(0.0, 0.2, 256).tolist()),
        gain=tuple(rng.normal(1.0, 0.08, 256).tolist()),
        enabled=tuple((np.arange(256) % 90 != 7).tolist()),
    )
    pose = Pose(offset_m=(0.002, -0.001, 0.0), turn_rad=(0.0, 0.0, 0.02))
    write_calibration(path, Calibration(layout="sonicsurface", elements=elements, pose=pose))
    return path


def test_the_focus_of_a_calibrated_board_is_read_back_from_log_and_bytes(tmp_path):
    """The bytes make up for what the board does, and have a focus by that board alone."""
    file = measured_board(tmp_path / "board.json")
    target = Target(record=tmp_path / "x.bin", log=tmp_path / "x.jsonl")
    play_focus(POINT, "sonicsurface", target, 0.1, sound=FocusSound(calibration=file))
    assert not sounding(target.record, "sonicsurface")
    by_file = [row for row in decode(target.record, "sonicsurface", calibration=file).foci if row.sounding]
    by_log = [row for row in decode(target.log).foci if row.sounding]
    for row in (by_file[0], by_log[0]):
        np.testing.assert_allclose(row.focus, POINT, atol=3e-4)
        assert row.sounding == 253 and row.misfit_rad < 0.1
    plain = decode(target.log, calibration=measured_board(tmp_path / "same.json"))
    np.testing.assert_allclose(plain.foci[2].focus, POINT, atol=3e-4)


def test_the_focus_of_a_scenes_calibrated_board_is_read_back_from_its_log(tmp_path):
    file = measured_board(tmp_path / "board.json")
    scene, log = SCENES / "palm_step_sonicsurface.xml", tmp_path / "x.jsonl"
    keys = {"array.calibration": str(file), "skin.accuracy": 0.5}
    play_scene(scene, None, Target(record=tmp_path / "x.bin", log=log), 0.05, keys=keys)
    rows = [row for row in decode(log).foci if row.sounding]
    assert rows and all(row.misfit_rad < 0.1 for row in rows)


@pytest.mark.parametrize(("key", "value"), [("turns_rad", [0.0, 1.0]), ("positions_m", [[0.0, 0.0, 0.0]])])
def test_a_log_of_other_transducers_than_its_layouts_is_refused(key, value, tmp_path):
    path = tmp_path / "x.jsonl"
    head = {"palmfield_log": 1, "board": "sonicsurface", "transducers": 256, "array": "sonicsurface", "keys": {}}
    air = {"temperature_C": 20.0, "humidity_percent": 50.0, "pressure_Pa": 101325.0}
    path.write_text(json.dumps({**head, "air": air, key: value}) + "\n")
    with pytest.raises(palmfield.SceneError, match="positions_m and turns_rad have shapes"):
        decode(path)


def test_bytes_that_make_no_focus_are_read_in_little_time(tmp_path):
    """Random phases in each frame: every one is looked for everywhere, some 20 ms each."""
    rng = np.random.default_rng(2)
    file = tmp_path / "x.bin"
    file.write_bytes(b"".join(BOARDS["sonicsurface"].encode(np.exp(2j * np.pi * rng.random(256))) for _ in range(20)))
    decoded = decode(file, "sonicsurface")
    assert len(decoded.foci) == 20
    assert all(np.isnan(row.focus).all() and row.misfit_rad > 1.0 for row in decoded.foci)


@pytest.mark.parametrize(
    ("board", "keys", "words"),
    [
        ("autd2018", {"packet_lsb_m": "-1"}, "key 'packet_lsb_m' has value '-1'; allowed"),
        ("autd2018", {"packet_header": "12"}, "key 'packet_header' has value '12'; allowed"),
        ("autd2018", {"sync": "perhaps"}, "key 'sync' has value 'perhaps'; allowed"),
        ("sonicsurface", {"dither": "maybe"}, "key 'dither' has value 'maybe'; allowed: on | off"),
        ("openmpd", {"dither": "on"}, "key 'dither' has value 'on': board 'openmpd' has no dither"),
    ],
)
def test_a_focus_heeds_the_drivers_keys_as_a_scene_does(board, keys, words, tmp_path):
    with pytest.raises(palmfield.PalmfieldError, match=words):
        play_focus(POINT, board, Target(record=tmp_path / "x.bin"), 0.1, keys=keys)
    assert not list(tmp_path.iterdir())


def test_a_key_of_a_packet_reaches_its_bytes_and_its_log(tmp_path):
    target = Target(record=tmp_path / "x.bin", log=tmp_path / "x.jsonl")
    play_focus(POINT, "autd2018", target, 0.1, keys={"packet_lsb_m": "0.00005"})
    packet = target.record.read_bytes()[9:18]
    bits = "".join(f"{byte:08b}" for byte in packet)
    numbers = [int(bits[8 + 16 * i : 24 + 16 * i], 2) for i in range(3)]
    assert [number - 2**16 * (number >= 2**15) for number in numbers] == [400, -200, 3000]
    np.testing.assert_allclose(sounding(target.log)[0].focus, POINT, atol=1e-4)


@pytest.mark.parametrize(("board", "level"), [("ultraino", 0.1), ("openmpd", 0.01), ("autd3", 0.001)])
def test_a_level_that_a_board_rounds_to_silence_is_refused(board, level, tmp_path):
    with pytest.raises(palmfield.DeviceError, match="rounds to silence; allowed: 0, or a level"):
        play_focus(POINT, board, Target(record=tmp_path / "x.bin"), 0.1, sound=FocusSound(level=level))
    play_focus(POINT, board, Target(record=tmp_path / "x.bin"), 0.1, sound=FocusSound(level=0.0))


def test_a_scene_that_a_board_rounds_to_silence_is_refused(tmp_path):
    keys = {"stimulus.drive_amplitude": 0.001, "skin.accuracy": 0.5}
    with pytest.raises(palmfield.DeviceError, match=r"at the loudest moment is .*, which board 'openmpd' rounds to 0"):
        play_scene(SCENES / "stroke_palm.xml", "openmpd", Target(record=tmp_path / "x.bin"), 0.05, keys=keys)


def test_a_board_that_modulates_by_itself_says_so(tmp_path):
    told = play_focus(POINT, "sonicsurface_tactile", Target(record=tmp_path / "x.bin"), 0.1)
    assert "always modulates" in told.text
    asked = FocusSound(am_frequency_Hz=1250 / 6)
    told = play_focus(POINT, "sonicsurface_tactile", Target(record=tmp_path / "y.bin"), 0.1, sound=asked)
    assert "always modulates" not in told.text


def rewired(path: Path) -> tuple[Path, np.ndarray]:
    """A calibration of a SonicSurface whose transducers hang on other places of its byte order."""
    address = np.random.default_rng(8).permutation(256)
    elements = Elements(
        polarity=(1,) * 256, phase_rad=(0.0,) * 256, gain=(1.0,) * 256, enabled=(True,) * 256,
        address=tuple(address.tolist()),
    )  # fmt: skip
    write_calibration(path, Calibration(layout="sonicsurface", elements=elements))
    return path, address


def heard_at(point: tuple[float, float, float], data: bytes, address: np.ndarray) -> float:
    """|sum| at a point of unit sources, each fed by the byte of its address, late by its lag; 256 where all agree."""
    steps = np.frombuffer(data[1:-1], np.uint8).astype(float) + (np.arange(256) % 8 == 3)
    distance = np.linalg.norm(layout("sonicsurface").positions - point, axis=1)
    wave = np.exp(2j * np.pi * (steps[address] / 32 + 40e3 * distance / sound_speed(Air())))
    return abs(wave.sum())


def test_addresses_of_a_calibration_are_the_places_of_its_bytes(tmp_path):
    """Of a focus and of a scene alike; the log tells them, raw bytes need the file."""
    file, address = rewired(tmp_path / "board.json")
    target = Target(record=tmp_path / "x.bin", log=tmp_path / "x.jsonl")
    play_focus(POINT, "sonicsurface", target, 0.1, sound=FocusSound(calibration=file))
    start = len(BOARDS["sonicsurface"].start)
    data = target.record.read_bytes()[start : start + 258]
    assert heard_at(POINT, data, address) > 0.995 * 256
    assert heard_at(POINT, data, np.arange(256)) < 0.3 * 256
    np.testing.assert_allclose(sounding(target.log)[0].focus, POINT, atol=3e-4)
    assert not sounding(target.record, "sonicsurface")
    by_file = decode(target.record, "sonicsurface", calibration=file).foci[2]
    np.testing.assert_allclose(by_file.focus, POINT, atol=3e-4)


def test_addresses_reach_a_scenes_bytes_and_what_is_simulated(tmp_path):
    file, address = rewired(tmp_path / "board.json")
    keys = {"array.calibration": str(file), "skin.accuracy": 0.5}
    view = preview(SCENES / "palm_step_sonicsurface.xml", keys=keys, device="cpu")
    model = view.runtime.model
    told = view.runtime.work.emission
    (frame, *_) = scene_frames(view, 0.05)
    point = model.stimuli[0].first_focus
    assert heard_at(tuple(point), frame.data, address) > 0.995 * 256
    told.begin(view.runtime.posed, 0.0)
    np.testing.assert_allclose(
        model.board.decode(frame.data)[-1], told.commanded(view.runtime.posed, np.array([0.0]))[0], atol=1e-9
    )


@pytest.mark.parametrize(
    "name", ["sonicsurface", "sonicsurface_pair", "sonicsurface_tactile", "openmpd", "ultraino", "autd3"]
)
def test_a_rewired_board_emits_what_it_is_asked_for(name):
    """Byte order is the twin's; a virtual board and `decode` give the layout's."""
    rng = np.random.default_rng(9)
    plain = BOARDS[name]
    places = rng.permutation(plain.transducers)
    board = replace(plain, places=tuple(places.tolist()))
    drive = np.exp(2j * np.pi * rng.random(plain.transducers))
    emitted = board.decode(board.encode(drive))[-1]
    assert np.abs(np.angle(emitted / drive)).max() <= np.pi / plain.phase_steps * (1 + 1e-9)
    in_bytes = np.empty_like(drive)
    in_bytes[places] = drive
    assert board.encode(drive) == plain.encode(in_bytes)


def test_a_board_that_places_its_focus_itself_refuses_addresses():
    driver = DriverConfig.model_validate({"board": "autd2018"})
    with pytest.raises(palmfield.DeviceError, match="addresses of a calibration have no effect"):
        board_of(driver, 249, address=np.arange(249)[::-1])
