"""OpenMPD's layout against the vendor's driver: its bytes by its own arithmetic, and files of single boards."""

import json
import math

import numpy as np
import pytest
from typer.testing import CliRunner

import palmfield
from palmfield.acoustics.arrays import layout
from palmfield.acoustics.calibration_file import Calibration, Elements, read_calibration, write_calibration
from palmfield.cli.app import app
from palmfield.drive.boards import BOARDS
from palmfield.hardware.decode import decode
from palmfield.hardware.focus_board import FocusSound, focus_board

RUN = CliRunner()
FOCUS = np.array([0.02, -0.03, 0.12])
# Lines of pins as board files have them, of the columns at x = -78.75, -68.25, 68.25 and 78.75 mm, y falling
COLUMNS = {
    0: [249, 253, 241, 245, 233, 237, 225, 229, 217, 221, 209, 213, 201, 205, 193, 197],
    1: [248, 252, 240, 244, 232, 236, 224, 228, 216, 220, 208, 212, 200, 204, 192, 196],
    14: [59, 62, 51, 54, 43, 46, 35, 38, 27, 30, 19, 22, 11, 14, 3, 6],
    15: [58, 63, 50, 55, 42, 47, 34, 39, 26, 31, 18, 23, 10, 15, 2, 7],
}


def vendor_positions() -> np.ndarray:
    """As the vendor's generator of board files computes them."""
    return np.array([[0.0105 * (x - 7.5), 0.0105 * (7.5 - y), 0.0] for x in range(16) for y in range(16)])


def vendor_bytes(pins: np.ndarray, degrees: np.ndarray) -> np.ndarray:
    """Phases of a focus, less each transducer's own, rounded, in the order of pins."""
    k = 2 * math.pi * 40e3 / palmfield.acoustics.air.sound_speed(palmfield.types.Air())
    phases = -k * np.linalg.norm(FOCUS - vendor_positions(), axis=1) - np.radians(degrees)
    message = np.zeros(256, int)
    message[pins] = np.rint(128 * phases / (2 * math.pi)).astype(int) % 128
    return message


def board_file(path, degrees, pins=None, amplitude=1.0):
    pins = layout("openmpd").address if pins is None else pins
    lines = ["AB0123", "256", "128", "".join(f"({x:f}, {y:f}, {z:f})," for x, y, z in vendor_positions())]
    lines += ["".join(f"{pin}," for pin in pins), "".join(f"{one}," for one in degrees), f"{amplitude:f}," * 256, ""]
    path.write_text("\n".join(lines))
    return path


def coherence(asked: np.ndarray, sent: np.ndarray) -> float:
    return abs(np.exp(2j * np.pi * (asked - sent) / 128).mean())


def sent(sound: FocusSound) -> np.ndarray:
    made = focus_board("openmpd", sound, {})
    frame = np.frombuffer(made.frame(FOCUS, made.unit(FOCUS), 1.0), np.uint8).astype(int)
    assert set(frame[256:]) == {64}
    return frame[:256] % 128


def test_the_layout_is_the_vendors_order():
    array = layout("openmpd")
    np.testing.assert_allclose(array.positions, vendor_positions(), atol=1e-12)
    assert sorted(array.address) == list(range(256))
    for column, pins in COLUMNS.items():
        assert array.address[16 * column : 16 * column + 16].tolist() == pins


def test_bytes_of_a_focus_are_the_vendors_and_were_not():
    asked = vendor_bytes(layout("openmpd").address, np.zeros(256))
    assert coherence(asked, sent(FocusSound())) > 0.999
    assert coherence(asked, sent(FocusSound(layout="openmpd_rows"))) < 0.3


def test_a_board_file_becomes_a_calibration(tmp_path):
    random = np.random.default_rng(3)
    degrees = np.rint(random.normal(40.0, 12.0, 256) + 180.0 * (random.random(256) < 0.5)).astype(int)
    pins = random.permutation(256)
    file = board_file(tmp_path / "board_7.pat", degrees, pins)
    done = RUN.invoke(app, ["calibrate", "import", str(file), str(tmp_path / "board.json")])
    assert done.exit_code == 0 and "not tested on hardware" in done.output, done.output
    known = json.loads((tmp_path / "board.json").read_text())
    assert (known["layout"], known["layout_version"], known["elements"]["address"]) == ("openmpd", 2, pins.tolist())
    turned = np.array(known["elements"]["polarity"]) == -1
    assert turned.tolist() in ((degrees > 130).tolist(), (degrees < 130).tolist())
    asked = vendor_bytes(pins, degrees)
    assert coherence(asked, sent(FocusSound(calibration=tmp_path / "board.json"))) > 0.999
    assert RUN.invoke(app, ["calibrate", "import", str(file), str(tmp_path / "board.json")]).exception


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda lines: lines[:5], "5 lines"),
        (lambda lines: [*lines[:1], "64", *lines[2:]], "line 2: '64'; layout openmpd has 256"),
        (lambda lines: [*lines[:4], lines[5], *lines[5:]], "line 5: pins"),
        (lambda lines: [*lines[:5], lines[5][:-2], *lines[6:]], "line 6: 255 numbers"),
        (lambda lines: [*lines[:5], "400," * 256, *lines[6:]], "line 6: phase 400"),
        (lambda lines: [*lines[:6], "0.5," * 256], "line 7: amplitude 0.5"),
        (lambda lines: [*lines[:4], "a," * 256, *lines[5:]], "line 5 is not numeric"),
    ],
)
def test_board_files_that_do_not_fit(change, words, tmp_path):
    file = board_file(tmp_path / "x.pat", np.zeros(256, int))
    file.write_text("\n".join(change(file.read_text().splitlines())))
    done = RUN.invoke(app, ["calibrate", "import", str(file), str(tmp_path / "x.json")])
    assert words in str(done.exception) and not (tmp_path / "x.json").exists()


def test_a_calibration_of_the_old_order_is_refused_for_the_new_one(tmp_path):
    ones = Elements(enabled=(True,) * 256, polarity=(1,) * 256, phase_rad=(0.0,) * 256, gain=(1.0,) * 256)
    file = tmp_path / "old.json"
    write_calibration(file, Calibration(layout="openmpd", elements=ones))
    old = json.loads(file.read_text())
    assert old.pop("layout_version") == 2
    file.write_text(json.dumps(old))
    assert read_calibration(file).layout == "openmpd_rows"
    with pytest.raises(palmfield.SceneError, match=r"for layout 'openmpd_rows', .*measure again"):
        focus_board("openmpd", FocusSound(calibration=file), {})
    assert focus_board("openmpd", FocusSound(calibration=file, layout="openmpd_rows"), {}).board.places == ()
    file.write_text(json.dumps(old | {"layout_version": 3}))
    with pytest.raises(palmfield.SceneError, match="version 3; allowed: 1 to 2"):
        read_calibration(file)


def test_readings_counted_in_the_old_order_are_refused(tmp_path):
    readings = tmp_path / "e.csv"
    readings.write_text("element,x_m,y_m,z_m,pressure_Pa,phase_deg\n0,0,0,0.2,1,0\n")
    line = ["calibrate", "add", "elements", str(readings), str(tmp_path / "b.json"), "--source", "us", "--layout"]
    assert "version 1" in str(RUN.invoke(app, [*line, "openmpd"]).exception)
    assert "openmpd_rows" in str(RUN.invoke(app, [*line, "openmpd"]).exception)


def test_logs_say_the_version_and_old_ones_are_read_in_their_order(tmp_path):
    x, y, z = FOCUS.tolist()
    line = ["drive", "--focus", f"{x}", f"{y}", f"{z}", "--board", "openmpd", "--duration", "0.1"]
    for name, more in (("new", []), ("rows", ["--layout", "openmpd_rows"])):
        log = tmp_path / f"{name}.jsonl"
        done = RUN.invoke(app, [*line, *more, "--record", str(tmp_path / "x.bin"), "--log", str(log)])
        assert done.exit_code == 0, done.output
    head = json.loads((tmp_path / "rows.jsonl").read_text().splitlines()[0])
    assert (head["array"], head["layout_version"]) == ("openmpd_rows", 1)
    old = (tmp_path / "rows.jsonl").read_text().replace('"openmpd_rows"', '"openmpd"')
    (tmp_path / "old.jsonl").write_text(old.replace('"layout_version": 1', '"p0_high_Pa_m": null'))
    for name in ("new", "rows", "old"):
        found = [one.focus for one in decode(tmp_path / f"{name}.jsonl").foci if one.sounding == 256]
        np.testing.assert_allclose(found[0], FOCUS, atol=1e-3)


def test_the_board_takes_bytes_in_the_order_of_pins():
    head = focus_board("openmpd", FocusSound(), {}).head
    drive = np.zeros(256, complex)
    drive[0] = 1.0
    assert np.flatnonzero(np.frombuffer(head.playable.encode(drive), np.uint8)[256:]).tolist() == [249]
    assert np.flatnonzero(head.playable.decode(head.playable.encode(drive))[-1]).tolist() == [0]
    assert BOARDS["openmpd"].layouts == ("openmpd", "openmpd_rows")
