"""AM in scenes: its keys and files as they are read, what the plan says, and what array, skin and board make of it."""

import math

import numpy as np
import pytest

import palmfield
from palmfield.drive.boards import BOARDS
from palmfield.drive.boards.sonicsurface import OFF_FRAME
from palmfield.drive.playback import frame_times
from palmfield.errors import DeviceError, SceneError
from palmfield.planning.scene_plan import plan
from palmfield.session.open_scene import compiled
from palmfield.skin.reduction.reduced_stepper import ReducedStepper
from palmfield.stimulus.schedule import turn_rate_Hz

JOINT = '<joint name="slide" type="slide" axis="1 0 0" stiffness="400" damping="10"/>'
SKIN = {"step_s": 0.00005, "accuracy": 0.1}
NO_AM = dict.fromkeys(("modulation", "am_quantity", "am_frequency_Hz", "am_depth"))
SAID = {"layout": "sonicsurface"}


def fixed(path):
    """The scene with its pad nailed down."""
    plain = path.parent / "plain.xml"
    plain.write_text(plain.read_text().replace(JOINT, ""))
    return path


def written(path, name="wave.csv", text="turn,w\n0,-1\n0.25,0.6\n0.5,1\n"):
    (path.parent / name).write_text(text)
    return path


def row(rows, what):
    return next(r for r in rows if r.what == what)


# -- the plan ------------------------------------------------------------------------------------------------------


def test_the_plan_tells_mean_lines_and_peak_drive(small_scene):
    """(1 + sin)^2 / 4 again"""
    told = plan(small_scene())
    line = row(told.modelled, "modulation")
    assert line.size == "ARP: mean 0.375, 0.500 at 200 Hz, 0.125 at 400 Hz"
    assert (
        "peak drive 1.000 of full drive, by am_normalisation peak" in line.why
        and "amplitude by waveform sine, depth 1" in line.why
    )
    (numbers,) = told.as_dict()["stimuli"]
    assert numbers["modulation"] == pytest.approx(
        {"am_frequency_Hz": 200.0, "arp_mean": 3 / 8, "arp_first": 1 / 2, "arp_second": 1 / 8}
    )
    steady = plan(small_scene(stimulus=NO_AM))
    assert not [r for r in steady.modelled if r.what == "modulation"]
    assert steady.as_dict()["stimuli"][0]["modulation"] is None


def test_the_plan_tells_the_drive_that_a_mean_takes(small_scene):
    keys = {"am_normalisation": "mean", "drive_amplitude": 0.5}
    told = plan(small_scene(stimulus=keys))
    peak = 0.5 / math.sqrt(3 / 8)
    assert f"peak drive {peak:.3f} of full drive, by am_normalisation mean" in row(told.modelled, "modulation").why
    assert told.as_dict()["stimuli"][0]["drive_level"] == pytest.approx(peak)


def test_more_than_full_drive_is_refused_with_the_instance(small_scene):
    for stimulus, words in (
        ({"am_normalisation": "carrier"}, "needs 2 of full drive; allowed: at most 1; set drive_amplitude to 0.5 or"),
        ({"am_quantity": "duty", "am_normalisation": "carrier"}, "pulses of duty 1; allowed: at most 0.5"),
    ):
        with pytest.raises(SceneError) as error:
            plan(small_scene(stimulus=stimulus))
        assert "plugin 'palmfield.stimulus' instance 'stimulus': drive_amplitude 1 is the carrier's" in str(error.value)
        assert words in str(error.value)


# -- files ---------------------------------------------------------------------------------------------------------


def test_a_file_is_read_beside_the_scene(small_scene):
    path = written(small_scene(stimulus={"am_waveform": "file", "am_file": "wave.csv", "am_quantity": "arp"}))
    model = palmfield.Simulation(path).runtime.model
    # Straight lines -1, 0.6, 1, -1 at turns 0, 1/4, 1/2, 1 have the mean 0.15; at full depth ARP goes as (1 + w) / 2
    line = row(plan(path).modelled, "modulation")
    assert line.size.startswith("ARP: mean 0.575, ") and "arp by waveform file" in line.why
    assert model.spec.stimuli[0].am_table.values == (-1.0, 0.6, 1.0)


BAD_FILES = {
    "turn,w\n0,0\n1,0\n": "line 3, column turn: 1; allowed: 0 to below 1",
    "time_s,w\n0,0\n0.1,1.2\n": "line 3, column w: 1.2; allowed: -1 to 1",
    "turn,w\n0.5,0\n0.2,1\n": "line 3, column turn: 0.2; allowed: more than in the line before",
    "turn,level\n0,0\n0.2,1\n": "columns are turn, level; give turn and w, or time_s and w",
    "turn,w\n0,0\n": "1 rows; allowed: 2 to 10000",
    "turn,w\n0,-1\n0.5,-1\n": "column w: all values are -1",
    "time_s,w\n0,0\n0.1,1\n": "'wave.csv' has times in seconds (column time_s); remove am_frequency_Hz",
}


@pytest.mark.parametrize("text", BAD_FILES)
def test_a_bad_file_is_told_with_its_key_and_place(small_scene, text):
    path = written(small_scene(stimulus={"am_waveform": "file", "am_file": "wave.csv"}), text=text)
    with pytest.raises(SceneError) as error:
        compiled(path)
    told = str(error.value).replace(str(path.parent) + "/", "")
    assert "plugin 'palmfield.stimulus' instance 'stimulus': key 'am_f" in told and BAD_FILES[text] in told


def test_a_missing_file_and_a_period_without_frequency(small_scene):
    path = small_scene(stimulus={"am_waveform": "file", "am_file": "none.csv"})
    with pytest.raises(SceneError, match=r"key 'am_file': .*none\.csv"):
        compiled(path)
    keys = {"am_waveform": "file", "am_file": "wave.csv", "am_frequency_Hz": None}
    with pytest.raises(SceneError, match=r"which contains one period \(column turn\); am_frequency_Hz is missing"):
        compiled(written(small_scene(stimulus=keys)))


def test_worlds_have_files_of_their_own(small_scene):
    stimulus = {"am_waveform": "file", "am_file": "wave.csv", "am_quantity": "arp"}
    path = written(small_scene(stimulus=stimulus, array={"response": "off"}, skin={"solver": "wedges"}))
    written(path, "other.csv", "time_s,w\n0,0.5\n0.004,-0.5\n0.01,1\n")
    keys = {"stimulus.am_file": ["wave.csv", "other.csv"], "stimulus.am_frequency_Hz": [200.0, None]}
    names = [str(path.parent / name) for name in keys["stimulus.am_file"]]
    together = palmfield.Simulation(path, worlds=2, keys=keys | {"stimulus.am_file": names})
    singles = [
        palmfield.Simulation(path, keys={"stimulus.am_file": name, "stimulus.am_frequency_Hz": frequency})
        for name, frequency in zip(names, keys["stimulus.am_frequency_Hz"], strict=True)
    ]
    for _ in range(8):
        together.step()
        for single in singles:
            single.step()
        arps = np.array([single.skin().arp.max() for single in singles])
        assert together.skin().arp.max(axis=1) == pytest.approx(arps, rel=1e-4)
    assert abs(arps[0] / arps[1] - 1.0) > 0.05


# -- what sounds ---------------------------------------------------------------------------------------------------

COURSES = {
    # Duty 1/2 at the peak, exponent 1.5, at 3 ms of 200 Hz
    "duty": ({"am_quantity": "duty"}, math.sin(math.pi / 4 * (1 + math.sin(2 * math.pi * 0.6))) ** 1.5),
    "hann": ({"am_waveform": "hann", "am_waveform_duty": 0.75, "am_quantity": "arp"}, math.sin(math.pi * 0.8) ** 2),
    "rectangle": ({"am_waveform": "rectangle", "am_waveform_duty": 0.3, "am_depth": 0.5}, (0.5 / 1.5) ** 2),
    "carrier": (
        {"am_normalisation": "carrier", "drive_amplitude": 0.4, "am_depth": 0.5},
        (0.4 * (1 + 0.5 * math.sin(2 * math.pi * 0.6))) ** 2,
    ),
}


@pytest.mark.parametrize("case", COURSES)
def test_the_arp_on_the_skin_follows_the_course(small_scene, case):
    """Over that of steady sound at full drive, without ring-up."""
    keys, expected = COURSES[case]
    at_once = {"array": {"response": "off"}, "skin": {"solver": "wedges"}, "driver": {"duty_exponent": 1.5}}
    steady = palmfield.Simulation(fixed(small_scene(stimulus=NO_AM, **at_once)))
    steady.step()
    full = steady.skin().arp.max()
    sim = palmfield.Simulation(fixed(small_scene(stimulus=keys, **at_once)))
    sim.step(3)
    assert sim.skin().arp.max() / full == pytest.approx(expected, rel=1e-4)


SHAPES = {
    "rectangle": {"am_waveform": "rectangle", "am_waveform_duty": 0.3},
    "hann": {"am_waveform": "hann", "am_waveform_duty": 0.5, "am_quantity": "arp"},
    "duty": {"am_quantity": "duty"},
    "burst": {"am_waveform": "burst", "am_burst_length_s": 0.01, "am_burst_period_s": 0.012},
    "course": {"am_waveform": "file", "am_file": "course.csv", "am_frequency_Hz": None},
}
OF_COURSE = "time_s,w\n0,-1\n0.004,1\n0.006,-0.2\n0.012,0.5\n"


def motion(path):
    """Normal displacement after every step of the skin, shape (t, S), and the scene."""
    sim = palmfield.Simulation(written(path, "course.csv", OF_COURSE))
    work, seen = sim.runtime.work, []
    work.observe = (sim.runtime.model.skins[0].layer.surface_operator,)
    sim.steps.observer = lambda trace: seen.extend(trace.motion[0][0][1][0].copy())
    sim.step(15)
    return np.array(seen)[:, 0], sim


@pytest.mark.parametrize("response", ["off", "on"])
@pytest.mark.parametrize("shape", SHAPES)
def test_small_models_move_as_the_whole_layer(small_scene, shape, response):
    keys = {"array": {"response": response}, "stimulus": SHAPES[shape]}
    small, sim = motion(fixed(small_scene(**keys, skin=SKIN | {"solver": "reduced"})))
    whole, _ = motion(fixed(small_scene(**keys, skin=SKIN | {"solver": "wedges"})))
    stepper = sim.runtime.model.begin[0].value
    assert isinstance(stepper, ReducedStepper)
    assert np.linalg.norm(small - whole) / np.linalg.norm(whole) < 0.01 + stepper.error


def test_a_level_that_jumps_on_a_path_is_left_to_others(small_scene):
    path = {"path": "lm", "path_width_m": 0.004, "path_rate_Hz": 50}
    for changes, words in (
        ({"am_waveform": "rectangle", "am_waveform_duty": 0.5}, "the level jumps in each period of the modulation"),
        (
            {"am_waveform": "file", "am_file": "course.csv", "am_frequency_Hz": None},
            "a path that runs once, or values from a file are not periodic",
        ),
    ):
        scene = fixed(small_scene(stimulus=path | changes, skin=SKIN))
        model = palmfield.Simulation(written(scene, "course.csv", OF_COURSE)).runtime.model
        assert words in model.skins[0].choice.why and model.skins[0].choice.name != "reduced"


# -- boards --------------------------------------------------------------------------------------------------------


def on_board(small_scene, **stimulus):
    rectangle = {"am_waveform": "rectangle", "am_waveform_duty": 0.5, "am_frequency_Hz": 20}
    return small_scene(
        array=SAID, driver={"board": "sonicsurface"}, stimulus=rectangle | stimulus, skin={"solver": "wedges"}
    )


def test_a_board_that_switches_plays_a_full_rectangle(small_scene):
    sim = palmfield.Simulation(fixed(on_board(small_scene, am_frequency_Hz=40)))
    stimulus = sim.runtime.model.stimuli[0]
    # Frames are due at each jump, every 12.5 ms
    times = frame_times([stimulus.config], 0.09)
    assert times == pytest.approx([0.0, 0.0125, 0.025, 0.0375, 0.05, 0.0625, 0.075, 0.0875])
    sim.step(20)
    emitted = np.abs(sim.drive)
    assert not emitted.any()
    assert BOARDS["sonicsurface"].encode(sim.drive) == OFF_FRAME


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"am_depth": 0.5}, "needs continuous amplitude at 40 frames/s (20 Hz, two frames per period)"),
        ({"am_waveform_duty": 0.1}, "needs 200 frames/s; sonicsurface gives on/off amplitude at 89.3 frames/s"),
        ({"am_frequency_Hz": 60}, "needs 120 frames/s; sonicsurface"),
        (
            {"am_normalisation": "carrier", "drive_amplitude": 0.5},
            "continuous amplitude; sonicsurface has only on",
        ),
    ],
)
def test_what_a_switching_board_cannot_play_is_told(small_scene, keys, words):
    with pytest.raises(DeviceError) as error:
        compiled(on_board(small_scene, **keys))
    assert words in str(error.value)


# -- lateral modulation --------------------------------------------------------------------------------------------


def test_lateral_modulation_moves_the_arp_to_and_fro(small_scene):
    """Two points 4 mm apart, turned by 90 degrees: the highest ARP is where the focus rests."""
    keys = NO_AM | {"path": "lm", "path_width_m": 0.004, "path_step_m": 0.004, "path_direction_deg": 90,
                    "path_rate_Hz": 100}  # fmt: skip
    sim = palmfield.Simulation(fixed(small_scene(stimulus=keys, array={"response": "off"}, skin={"solver": "wedges"})))
    assert turn_rate_Hz(sim.runtime.model.configs[0]) == 100
    places = []
    for _ in range(10):
        sim.step()
        skin = sim.skin()
        places.append(np.average(skin.position[:, 1], weights=np.maximum(skin.arp, 0.0) ** 4))
    # From 1 to 10 ms: at 5 and 10 ms it is at the next point already
    expected = 0.002 * np.array([-1, -1, -1, -1, 1, 1, 1, 1, 1, -1])
    assert np.array(places) == pytest.approx(expected, abs=2e-4)


def test_lateral_modulation_has_a_small_model(small_scene):
    path = {"path": "lm", "path_width_m": 0.004, "path_rate_Hz": 100}
    for step in (None, 0.001):
        keys = {"stimulus": NO_AM | path | {"path_step_m": step}, "array": {"response": "off"}}
        small, sim = motion(fixed(small_scene(**keys, skin=SKIN | {"solver": "reduced"})))
        whole, _ = motion(fixed(small_scene(**keys, skin=SKIN | {"solver": "wedges"})))
        stepper = sim.runtime.model.begin[0].value
        assert isinstance(stepper, ReducedStepper)
        assert np.linalg.norm(small - whole) / np.linalg.norm(whole) < 0.01 + stepper.error
