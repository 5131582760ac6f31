"""Benches on which nothing is felt, each broken in one way, and what `palmfield why` says of them."""

import numpy as np
import pytest

from palmfield.acoustics.reference import pressure64
from palmfield.drive.boards import BOARDS
from palmfield.drive.virtual import VirtualBoard
from palmfield.errors import DeviceError, SceneError
from palmfield.hardware.focus_board import FocusSound, focus_board
from palmfield.studies.why import TRIED_m, why

pytestmark = pytest.mark.usefixtures("kept_operators")

BOARD = "sonicsurface"


@pytest.fixture(scope="module")
def scene(module_scene):
    on_off = {"am_waveform": "rectangle", "am_waveform_duty": 0.5, "am_frequency_Hz": 40.0}
    return module_scene(array={"layout": "sonicsurface"}, stimulus=on_off)


def checked(scene, *, felt=False, board=BOARD, port=None, measured=None, **keys):
    named = {name.replace("__", "."): value for name, value in keys.items()}
    return why(scene, board=board, port=port, keys=named, measured_Pa=measured, felt=felt)


def verdicts(found):
    return {one.what: one.verdict for one in found.findings}


def test_a_bench_without_a_fault_is_referred_to_what_only_a_measurement_shows(scene):
    found = checked(scene)
    assert list(verdicts(found)) == ["board", "firmware", "polarity", "level", "focus", "modulation", "distance"]
    assert {verdict for what, verdict in verdicts(found).items()} == {"ok", "unseen"}
    assert found.first.what == "board" and "--port" in found.first.text


def test_the_board_that_is_none_and_the_cable_that_is_out(scene):
    assert "--board" in checked(scene, board=None).first.text
    found = checked(scene, port="/dev/no-such-port")
    assert found.first.what == "board" and "/dev/no-such-port" in found.first.text


def test_a_stimulus_that_the_board_cannot_play(scene):
    found = checked(scene, stimulus__am_frequency_Hz=200.0)
    assert found.first.what == "board" and "use board" in found.first.text


@pytest.mark.wall_clock
def test_a_port_is_opened_and_nothing_is_sent(scene):
    """Clock: the virtual board reads its line in real time."""
    with VirtualBoard(BOARDS[BOARD].sized(256)) as board:
        assert verdicts(checked(scene, port=board.port))["board"] == "ok"
        assert bytes(board.received) == b""


def test_another_firmware_is_named_with_what_it_leaves(scene):
    [found] = [one for one in checked(scene).findings if one.what == "firmware"]
    assert found.verdict == "unseen" and "sonicsurface_tactile" in found.text


@pytest.mark.parametrize(
    ("keys", "what", "told"),
    [
        ({"stimulus__drive_amplitude": 0.2}, "level", "20 % of full drive"),
        ({"stimulus__drive_amplitude": 0.0}, "level", "emits no sound"),
        ({"stimulus__focus_m": "0.1 0 0.15"}, "focus", "no focus is near"),
        ({"stimulus__modulation": "none", "stimulus__am_frequency_Hz": None}, "modulation", "is steady"),
        ({"stimulus__am_frequency_Hz": 900.0}, "modulation", "900 Hz"),
    ],
)
def test_a_stimulus_that_cannot_be_felt(scene, keys, what, told):
    found = checked(scene, board=None, **keys)
    faults = [one for one in found.findings[1:] if one.verdict == "look here"]
    assert faults[0].what == what and told in faults[0].text


def reading(reversed_):
    """Pressure of a focus whose first transducers are reversed, relative to the whole array."""
    made = focus_board(BOARD, FocusSound(), {})
    place = np.array(TRIED_m)
    drive = made.board.decode(made.board.start + made.frame(place, made.unit(place), 1.0))[-1]
    signs = np.where(np.arange(256) < reversed_, -1.0, 1.0)
    return [abs(pressure64(place[None], made.array, one, made.sound.air)[0][0]) for one in (drive, signs * drive)]


def test_a_microphone_tells_reversed_transducers():
    whole, half = reading(100)
    assert verdicts(why(None, board=BOARD, measured_Pa=whole))["polarity"] == "ok"
    found = why(None, board=BOARD, measured_Pa=half)
    assert found.first.what == "polarity" and "reversed" in found.first.text
    least, most = (float(word) for word in found.first.text.partition("as if ")[2].split(" % ")[0].split(" to "))
    assert least <= 100 * 100 / 256 <= most + 2.0


def test_the_threshold_is_that_of_the_run(scene):
    weak = checked(
        scene, felt=True, board=None, stimulus__drive_amplitude=0.05, stimulus__am_frequency_Hz=200.0
    ).findings[-1]
    assert weak.what == "threshold" and weak.verdict == "look here" and "felt: " in weak.text


def test_bad_input_is_refused(scene):
    with pytest.raises(SceneError, match="neither a scene nor a board"):
        why(None)
    with pytest.raises(SceneError, match="--measured has value -1"):
        why(scene, measured_Pa=-1.0)
    with pytest.raises(SceneError, match=r"--set driver\.board has no effect without a scene"):
        why(None, board=BOARD, keys={"driver.board": "x"})
    with pytest.raises(DeviceError, match="board 'x' is unknown"):
        why(None, board="x")
