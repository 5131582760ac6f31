"""Option --board: a scene on another board, with its layout and the rate of its frames."""

from pathlib import Path

import numpy as np
import pytest

import palmfield
from palmfield.acoustics.air import density, sound_speed
from palmfield.acoustics.arrays import layout
from palmfield.acoustics.calibration_file import Calibration, Elements, write_calibration
from palmfield.acoustics.reference import directivity
from palmfield.drive.boards import BOARDS
from palmfield.hardware.focus_board import FocusSound
from palmfield.hardware.play import Target, play_focus, play_scene, scene_frames
from palmfield.session.other_board import exchange_board
from palmfield.session.preview import preview
from palmfield.session.scene_text import Instance
from palmfield.types import Air, Estimate

pytestmark = pytest.mark.usefixtures("kept_operators")

SCENES = Path(__file__).parents[2] / "mjcf" / "scenes"
BOARD_OF = {
    "approach_withdraw": "autd2018",
    "cover_palm": "autd2018",
    "follow_fingertip": "autd2018",
    "grasp_object": "autd3",
    "hover_explore": "autd2018",
    "live_palm": "autd2018",
    "palm_am200": "autd2018",
    "palm_and_fingertip": "autd3",
    "palm_circle": "autd2018",
    "palm_circle_sonicsurface": "sonicsurface",
    "palm_step_sonicsurface": "openmpd",
    "phantom_am200": "autd3",
    "phantom_step": "autd2018",
    "phantom_stm70": "autd3",
    "stroke_palm": "autd2018",
    "tap_button": "autd2018",
    "trace_shape": "autd3",
    "two_hands": "autd2018",
    "two_hands_both_feel": "autd3",
}
QUICK = {"skin.accuracy": 0.5}
STEPPED = ("grasp_object", "palm_circle_sonicsurface", "palm_step_sonicsurface", "tap_button", "two_hands_both_feel")
"""Scenes that are stepped on another board in each run: every board, and hands that move; the others nightly."""


def test_every_shipped_scene_has_a_board_here():
    assert set(BOARD_OF) == {path.stem for path in SCENES.glob("*.xml") if not path.stem.startswith("plain")}
    assert {BOARD_OF[name] for name in STEPPED} == set(BOARD_OF.values())


@pytest.mark.parametrize("name", BOARD_OF)
def test_every_shipped_scene_plays_and_is_simulated_as_its_bytes_say(name, tmp_path):
    """The frames at the beginning, decoded, against what the scene's transducers are told then."""
    view = preview(SCENES / f"{name}.xml", board=BOARD_OF[name], keys=QUICK, device="cpu")
    model = view.runtime.model
    assert model.board.name == BOARD_OF[name]
    frames = list(scene_frames(view, 0.003))
    assert frames and all(len(frame.data) == model.board.frame_bytes for frame in frames)
    posed, emission = view.runtime.posed, view.runtime.work.emission
    several = any(len(stimulus.offsets) for stimulus in model.stimuli)
    for frame in frames if not view.moves else frames[:1]:
        told = emission.commanded(posed, np.array([frame.time_s]))[0]
        played = model.board.decode(frame.data)[-1]
        # Of several foci levels are rounded for each transducer: half a step of the pulse, whose slope is at most pi/2
        step = np.pi / 4 / 128 + 1 / 255 if several else 0.0
        np.testing.assert_allclose(played, told, atol=step + 1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name in STEPPED else [pytest.mark.nightly]) for name in BOARD_OF]
)
def test_every_shipped_scene_runs_on_a_board(name):
    sim = palmfield.Simulation(SCENES / f"{name}.xml", board=BOARD_OF[name], device="cpu", keys=QUICK)
    sim.step(3)
    assert sim.runtime.model.board.name == BOARD_OF[name]
    assert all(np.isfinite(sim.skin(skin).displacement).all() for skin in sim.skins)


def keys_of(**plugins: dict[str, str]) -> list[Instance]:
    return [Instance(name, f"palmfield.{name}", keys) for name, keys in plugins.items()]


def test_what_changes_is_said_with_both_sides():
    plugins = keys_of(
        array={"layout": "uhev1", "p0_Pa_m": "3", "dead": "1 2"},
        stimulus={"focus_m": "0 0 0.2", "modulation": "am"},
        driver={"board": "ideal"},
    )
    said = exchange_board("x.xml", plugins, "autd2018", 0.001)
    assert plugins[0].keys == {"layout": "autd2018"}
    assert plugins[1].keys["control_rate_Hz"] == "2000" and plugins[2].keys == {"board": "autd2018"}
    assert "249 transducers over 173 x 132 mm" in said[0] and "256 transducers over 154 x 154 mm" in said[0]
    assert "removed keys of the old layout: p0_Pa_m, dead" in said[0]
    # A focus on the axis of monopoles is the sum of p0/d; the pistons' directivity takes some of it
    array, air = layout("uhev1"), Air()
    distance = np.linalg.norm(array.positions - [0.0, 0.0, 0.2], axis=1)
    upper = (array.p0_Pa_m * (1 / distance).sum()) ** 2 / (density(air) * sound_speed(air) ** 2)
    given = float(said[0].split("instead of uhev1")[1].split(" Pa ARP")[0].split()[-1])
    assert 0.5 * upper < given < upper


def test_a_board_that_the_scene_has_already_changes_nothing():
    plugins = keys_of(array={"layout": "sonicsurface"}, stimulus={}, driver={"board": "sonicsurface"})
    assert exchange_board("x.xml", plugins, "sonicsurface", 0.001) == []


def test_rates_fall_on_steps_of_mujoco():
    plugins = keys_of(array={}, stimulus={"frame": "hand"}, driver={})
    exchange_board("x.xml", plugins, "sonicsurface", 0.001)
    rate = float(plugins[1].keys["control_rate_Hz"])
    assert rate <= BOARDS["sonicsurface"].max_frame_rate_Hz
    assert 1000 / rate == pytest.approx(12, rel=1e-12)


def test_a_circle_too_fast_for_the_board_is_refused_with_the_points_that_are_left():
    with pytest.raises(palmfield.DeviceError, match=r"\(3 points per turn\).*0\.\d+ points per turn|points per turn"):
        preview(SCENES / "phantom_stm70.xml", board="sonicsurface", keys={"stimulus.arp_peak_Pa": None})


def test_modulation_is_refused_with_the_frames_that_it_needs(tmp_path):
    with pytest.raises(palmfield.DeviceError, match="needs continuous amplitude at 400 frames/s"):
        play_scene(SCENES / "palm_am200.xml", "sonicsurface", Target(record=tmp_path / "x.bin"))
    assert not list(tmp_path.iterdir())


def test_dithering_plays_an_amplitude(small_scene):
    keys = {"driver.dither": "on", "stimulus.modulation": None, "stimulus.drive_amplitude": 0.5}
    keys |= {"stimulus.am_quantity": None, "stimulus.am_frequency_Hz": None, "stimulus.am_depth": None}
    sim = palmfield.load(small_scene(), board="sonicsurface", keys=keys)
    assert np.mean(np.abs(sim.drive) > 0) == pytest.approx(0.5, abs=0.01)
    full = palmfield.load(small_scene(), board="sonicsurface", keys=keys | {"stimulus.drive_amplitude": 1})
    point = np.array([[0.0, 0.0, 0.12]])
    arrays = sim.runtime.model.arrays
    share = np.abs(arrays.pressure64(point, sim.drive)) / np.abs(arrays.pressure64(point, full.drive))
    assert share == pytest.approx(0.5, abs=0.02)


def test_faults_of_a_scene_reach_the_bytes_and_the_focus_is_as_without_those_that_are_inverted(small_scene):
    still = {"stimulus.modulation": None, "stimulus.am_quantity": None, "stimulus.am_frequency_Hz": None}
    still |= {"stimulus.am_depth": None, "array.layout": "sonicsurface", "driver.board": "sonicsurface"}
    scene = small_scene()
    data = {}
    sound = {}
    for name, keys in {
        "none": {},
        "faults": {"array.dead": "5 9", "array.inverted": "3 7"},
        "off": {"array.dead": "5 9", "array.inverted": "3 7", "driver.compensate": "off"},
        "ideal": {
            "array.dead": "5 9", "array.inverted": "3 7", "driver.board": "ideal", "driver.compensate": "on",
        },
    }.items():  # fmt: skip
        view = preview(scene, keys=still | keys)
        if name != "ideal":
            (frame, *_) = scene_frames(view, 0.01)
            data[name] = np.frombuffer(frame.data[1:-1], np.uint8)
        drive = view.runtime.work.emission.commanded(view.runtime.posed, np.zeros(1))[0]
        sound[name] = abs(view.runtime.model.arrays.pressure64(np.array([[0.0, 0.0, 0.12]]), drive)[0])
    changed = np.flatnonzero(data["none"] != data["faults"])
    assert changed.tolist() == [3, 5, 7, 9]
    assert data["faults"][[5, 9]].tolist() == [32, 32]
    assert ((data["faults"][[3, 7]].astype(int) - data["none"][[3, 7]]) % 32).tolist() == [16, 16]
    np.testing.assert_array_equal(data["off"], data["none"])
    # Two are dead; without compensation two more take away what they should add
    array = layout("sonicsurface")
    distance = np.linalg.norm(array.positions - [0.0, 0.0, 0.12], axis=1)
    share = directivity(array, 2 * np.pi * 40e3 / 343.4, 0.12 / distance) / distance
    share /= share.sum()
    assert sound["ideal"] * np.sinc(1 / 32) == pytest.approx(sound["faults"], rel=2e-3)
    assert sound["faults"] / sound["none"] == pytest.approx(1 - share[[5, 9]].sum(), abs=1e-3)
    assert sound["off"] / sound["none"] == pytest.approx(1 - share[[5, 9]].sum() - 2 * share[[3, 7]].sum(), abs=1e-3)


def test_the_tactile_firmware_takes_its_own_rates_and_bytes_have_no_levels(small_scene):
    scene = small_scene()
    view = preview(scene, board="sonicsurface_tactile", keys={"stimulus.am_frequency_Hz": 1250 / 6})
    board = view.runtime.model.board
    assert board.start[0] == 160 + 5
    twin = board.twin()
    twin.feed(board.start)
    assert twin.envelope_Hz == pytest.approx(208.33, abs=0.01)
    frames = list(scene_frames(view, 0.3))
    assert len(frames) == 3 and len({frame.data for frame in frames}) == 1
    assert (np.abs(board.decode(frames[0].data)[-1]) > 0.9).all()
    with pytest.raises(palmfield.DeviceError, match=r"the nearest are 178.6 and 208.3 Hz"):
        preview(scene, board="sonicsurface_tactile")
    steady = {f"stimulus.{key}": None for key in ("modulation", "am_quantity", "am_frequency_Hz", "am_depth")}
    with pytest.raises(palmfield.DeviceError, match="always modulates: set modulation am"):
        preview(scene, board="sonicsurface_tactile", keys=steady)


def test_a_calibration_of_each_transducer_reaches_the_bytes_and_brings_the_focus_back(small_scene, tmp_path):
    """The true board is the sum of the calibrated responses over distance; bytes by the protocol, decoded here."""
    rng = np.random.default_rng(5)
    polarity, phase = rng.choice([-1, 1], 256), rng.uniform(-0.6, 0.6, 256)
    enabled = rng.random(256) > 0.02
    file = tmp_path / "board.json"
    elements = Elements(
        polarity=tuple(polarity.tolist()), phase_rad=tuple(phase.tolist()), gain=(1.0,) * 256,
        enabled=tuple(enabled.tolist()),
    )  # fmt: skip
    p0 = Estimate(2.5, 2.4, 2.6, "measured", "test")
    write_calibration(file, Calibration(layout="sonicsurface", p0=p0, elements=elements))
    point = np.array([0.01, 0.0, 0.12])
    distance = np.linalg.norm(layout("sonicsurface").positions - point, axis=1)
    k = 2 * np.pi * 40e3 / sound_speed(Air())

    def heard(data: bytes) -> float:
        steps = np.array([step + (number % 8 == 3) for number, step in enumerate(data[1:-1])], float)
        sent = np.where(np.frombuffer(data[1:-1], np.uint8) == 32, 0.0, np.exp(2j * np.pi * steps / 32))
        real = polarity * np.exp(1j * phase)
        return abs((sent * real * np.exp(1j * k * distance)).sum())

    still = {f"stimulus.{key}": None for key in ("modulation", "am_quantity", "am_frequency_Hz", "am_depth")}
    still |= {"stimulus.focus_m": point, "array.layout": "sonicsurface", "driver.board": "sonicsurface"}
    plain, known = (
        next(iter(scene_frames(preview(small_scene(), keys=still | more), 0.01))).data
        for more in ({}, {"array.calibration": str(file)})
    )
    assert heard(known) == pytest.approx(enabled.sum() * np.sinc(1 / 32), rel=2e-3)
    assert heard(plain) < 0.3 * heard(known)
    assert (np.frombuffer(known[1:-1], np.uint8) == 32).sum() == (~enabled).sum()
    told = play_focus(
        tuple(point), "sonicsurface", Target(record=tmp_path / "f.bin"), 0.05, sound=FocusSound(calibration=file)
    )
    assert "mm nearer" in told.text
    assert known in (tmp_path / "f.bin").read_bytes()


def test_a_calibration_of_another_number_of_transducers_is_refused(small_scene, tmp_path):
    file = tmp_path / "board.json"
    few = Elements(polarity=(1, -1), phase_rad=(0.0, 0.0), gain=(1.0, 1.0), enabled=(True, True))
    write_calibration(file, Calibration(layout="uhev1", elements=few))
    with pytest.raises(palmfield.SceneError, match="has 2 transducers, but the array has 256"):
        preview(small_scene(), keys={"array.calibration": str(file)})


PAIR = """
<mujoco>
  <worldbody>
    <site name="array"/><site name="above" pos="0 0 0.24" quat="{quat}"/>
    <body name="pad" pos="0 0 0.12" quat="0 1 0 0"><site name="centre" size="0.001"/></body>
  </worldbody>
  <custom><numeric name="palmfield_duration_s" data="0.1"/></custom>
  <extension>
    <plugin plugin="palmfield.array">
      <instance name="below"><config key="layout" value="sonicsurface"/></instance>
      <instance name="above"><config key="layout" value="sonicsurface"/><config key="site" value="above"/></instance>
    </plugin>
    <plugin plugin="palmfield.stimulus">
      <instance name="stimulus"><config key="focus_m" value="0.01 0.02 0.12"/></instance>
    </plugin>
    <plugin plugin="palmfield.skin"><instance name="skin">
      <config key="body" value="pad"/><config key="shape" value="disc"/><config key="radius_m" value="0.02"/>
      <config key="thickness_m" value="0.008"/><config key="material" value="ecoflex_00-10"/>
      <config key="side" value="free"/><config key="element_m" value="0.006"/>
    </instance></plugin>
    <plugin plugin="palmfield.driver"><instance name="driver">
      <config key="board" value="sonicsurface_pair"/>
    </instance></plugin>
  </extension>
</mujoco>
"""


def test_two_boards_that_face_each_other_focus_where_the_vendors_map_has_their_transducers(tmp_path):
    """Places by address in the vendor's frame (x, z over the board): the upper ones at -z, -x and 240 mm up."""
    path = tmp_path / "pair.xml"
    path.write_text(PAIR.format(quat="0 1 0 0"))
    (frame, *_) = scene_frames(preview(path, device="cpu"), 0.05)
    data = frame.data
    below = layout("sonicsurface").positions
    x, z = below[:, 0], -below[:, 1]
    places = np.concatenate([below, np.column_stack([-z, x, np.full(256, 0.24)])])  # ours: X = x, Y = -z
    steps = np.concatenate([np.frombuffer(data[2:258], np.uint8), np.frombuffer(data[260:516], np.uint8)]).astype(float)
    lag = np.tile(np.arange(256) % 8 == 3, 2) + np.repeat([0.0, 16.5], 256)
    wave = np.exp(2j * np.pi * (steps + lag) / 32)
    distance = np.linalg.norm(places - [0.01, 0.02, 0.12], axis=1)
    heard = abs((wave * np.exp(2j * np.pi * 40e3 / sound_speed(Air()) * distance)).sum())
    assert heard == pytest.approx(512 * np.sinc(1 / 32), rel=2e-3)


def test_two_boards_that_do_not_face_each_other_are_refused(tmp_path):
    path = tmp_path / "pair.xml"
    path.write_text(PAIR.format(quat="0 0 1 0"))
    with pytest.raises(palmfield.SceneError, match="give its site quat='0 1 0 0' relative to the first"):
        preview(path, device="cpu")
