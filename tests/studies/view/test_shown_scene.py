"""What a live view does with what its page asks for, without a page: messages go in and come out."""

import json
import math

import numpy as np
import pytest

import palmfield
from palmfield.estimate.sensation_levels import contact_levels
from palmfield.hand.triangles import vertex_areas
from palmfield.outputs.pictures.draw import draw_pictures
from palmfield.outputs.store import MemoryStore, open_result
from palmfield.perception import ALL_OBSERVERS
from palmfield.session.changed_stimuli import change_stimuli
from palmfield.session.recorded_run import initial_block, recorder_of, recover, result_attributes
from palmfield.session.worlds import stimulus_texts
from palmfield.studies.view.hands import Offset
from palmfield.studies.view.messages import (
    Moment,
    Notice,
    Pace,
    Press,
    Replay,
    Request,
    SceneShown,
    SetKey,
    Turn,
    Values,
)
from palmfield.studies.view.run import QUIET_s, SceneSource, ShownScene

pytestmark = pytest.mark.usefixtures("kept_operators")

FREQUENCY = ("key", "stimulus.am_frequency_Hz", None)
DEPTH = ("key", "stimulus.am_depth", None)
FOCUS_X = ("key", "stimulus.focus_m", 0)


class Shown:
    """A scene whose messages are kept."""

    def __init__(self, path, out, **keys):
        self.sent = []
        self.scene = ShownScene(SceneSource(path, "cpu", None, None), keys, out, self.sent.append)
        self.scene.receive(Pace(math.inf))
        self.scene.show()

    def go_on(self, steps=1):
        for _ in range(steps):
            self.scene.go_on()

    def change(self, *messages):
        """Send messages, wait until sliders count as left alone, and take them."""
        for message in messages:
            self.scene.receive(message)
        self.scene._turned_at -= QUIET_s
        self.scene.go_on()

    def all(self, kind):
        return [one for one in self.sent if isinstance(one, kind)]

    def last(self, kind):
        return self.all(kind)[-1]


def recorded(sim, steps):
    """What a run of so many steps records."""
    store = MemoryStore(initial_block(sim), result_attributes(sim))
    recorder = recorder_of(sim, store)
    recorder.start()
    for _ in range(steps):
        sim.step()
        recorder.step()
    recorder.stop()
    return store.finish({}, complete=True)


@pytest.fixture(scope="module")
def path(module_scene):
    return module_scene()


@pytest.fixture
def shown(path, tmp_path):
    return Shown(path, tmp_path / "out")


@pytest.fixture(scope="module")
def modal(module_scene, tmp_path_factory):
    keys = {"palmfield.skin.solver": "modal", "palmfield.skin.accuracy": 0.3}
    # Transducers that ring on would mix the old sound with the new one, and their ARP is no sum
    return Shown(module_scene(array={"response": "off"}), tmp_path_factory.mktemp("modal"), **keys)


def test_a_watched_scene_does_what_it_does_alone(shown, path):
    for _ in range(3):
        shown.scene.receive(Request("replay"))
        shown.scene.receive(Request("full moment"))
        shown.go_on(12)
    assert len(shown.all(Replay)) >= 1
    alone = palmfield.Simulation(path, device="cpu")
    alone.step(36)
    assert alone.time == shown.scene.sim.time
    np.testing.assert_array_equal(shown.scene.sim.skin().displacement, alone.skin().displacement)


def test_a_moment_is_the_scene_now_and_comes_only_when_asked_for(shown):
    shown.go_on(5)
    assert not shown.all(Moment)
    shown.scene.receive(Request("full moment"))
    shown.go_on()
    moment, sim = shown.last(Moment), shown.scene.sim
    assert moment.time_s == sim.time and moment.solvers == (sim.skin().solver,)
    np.testing.assert_array_equal(moment.drive, sim.drive)
    np.testing.assert_allclose(moment.displacement[0], sim.skin().normal_displacement, rtol=1e-6)
    np.testing.assert_allclose(moment.arp[0], sim.skin().arp, rtol=1e-6)
    np.testing.assert_allclose(moment.foci, [[0.0, 0.0, 0.12]], atol=1e-9)
    shown.scene.receive(Request("moment"))
    shown.go_on()
    assert shown.last(Moment).displacement == ()
    assert len(shown.all(Moment)) == 2


def test_what_is_shown_at_first_lies_where_the_scene_has_it(shown):
    scene, sim = shown.last(SceneShown), shown.scene.sim
    np.testing.assert_allclose(scene.pose.skins[0][0], sim.skin().position, atol=1e-7)
    arrays = sim.runtime.model.arrays.array
    np.testing.assert_allclose(scene.pose.transducers, arrays.positions, atol=1e-7)
    assert {slider.label for slider in scene.sliders} == {"x", "y", "z", "frequency", "depth", "of full drive"}
    assert "palmfield.motion" in scene.no_pose
    values = shown.last(Values).values
    assert values[FREQUENCY] == 200.0 and values[("key", "stimulus.focus_m", 2)] == pytest.approx(120.0)


def test_a_replay_is_the_recorded_motion_with_the_levels_of_a_run(shown, path):
    """Held against a record of the same steps by itself, as a run makes it."""
    shown.go_on(4)
    shown.scene.receive(Request("replay"))
    shown.go_on(11)
    replay = shown.last(Replay)
    assert replay.length_s == pytest.approx(5e-3)
    sim = palmfield.Simulation(path, device="cpu")
    sim.step(4)
    result = recorded(sim, 11)
    skin = result["skin/skin"]
    times = 0.004 + result["time"].values
    chosen = [int(np.abs(times - one).argmin()) for one in replay.times]
    np.testing.assert_allclose(times[chosen], replay.times, atol=1e-9)
    normal = np.einsum("tsi,si->ts", skin["displacement"].values, skin["rest_normal"].values)
    np.testing.assert_allclose(replay.skins[0].displacement, normal[chosen], rtol=1e-4, atol=1e-6 * abs(normal).max())
    np.testing.assert_allclose(replay.skins[0].arp, skin["arp"].values[chosen], rtol=1e-6)
    areas = vertex_areas(sim.skin().rest_position, sim.skin().faces)
    told = contact_levels(times, normal, [200.0, 400.0], areas)
    levels = {level.observer: level for level in replay.skins[0].levels}
    assert list(levels) == list(ALL_OBSERVERS)
    assert "20 cm2 or more" in levels["morioka_griffin_2006"].why
    for name in ("bolanowski_1988", "afferent_human"):
        # The record has one sample more, its beginning
        assert levels[name].level_dB == pytest.approx(told[f"level_all_lines_{name}_dB_SL"], abs=0.3)
    assert levels["hasegawa_2018"].level_dB is None and "palms" in levels["hasegawa_2018"].why


def test_a_turned_slider_rebuilds_what_was_made_for_one_sound(shown):
    shown.go_on(5)
    shown.change(Turn(FOCUS_X, 3.0))
    assert shown.scene.keys == {"stimulus.focus_m": "0.003 0.0 0.12"}
    assert shown.scene.sim.runtime.spec.stimuli[0].config.focus_m == (0.003, 0.0, 0.12)
    kinds = [told.kind for told in shown.all(Notice)]
    assert kinds == ["busy", "info"] and "rebuilding" in shown.all(Notice)[0].text
    assert len(shown.all(SceneShown)) == 2
    assert shown.scene.sim.time < 0.005
    assert shown.last(Values).values[FOCUS_X] == pytest.approx(3.0)


def test_turns_of_one_drag_are_taken_together(shown):
    for value in (1.0, 2.0, 3.0, 4.0):
        shown.scene.receive(Turn(FOCUS_X, value))
        shown.go_on()
    assert not shown.all(Notice)
    shown.change(Turn(FOCUS_X, 5.0), Turn(DEPTH, 0.5))
    assert shown.scene.keys == {"stimulus.focus_m": "0.005 0.0 0.12", "stimulus.am_depth": "0.5"}
    assert len(shown.all(SceneShown)) == 2


@pytest.mark.parametrize(
    ("message", "named"),
    [
        (Turn(FREQUENCY, 1e6), "am_frequency_Hz"),
        (Turn(FREQUENCY, math.nan), "am_frequency_Hz"),
        (Turn(DEPTH, -3.0), "am_depth"),
        (Turn(FOCUS_X, 1e9), "focus_m"),
        (SetKey("stimulus.no_such_key=1"), "no_such_key"),
        (SetKey("nobody.focus_m=0 0 0.1"), "nobody"),
        (SetKey("skin.material=stone"), "stone"),
        (SetKey("skin.element_m"), "skin.element_m"),
        (SetKey("skin.mesh=/etc/passwd"), "skin.mesh"),
        (SetKey(" motion.function =os:getcwd"), "motion.function"),
        (SetKey("=1"), "=1"),
        (SetKey("stimulus.ramp_s=0.01; skin.mesh=/etc/passwd"), "skin.mesh"),
    ],
)
def test_a_bad_value_is_told_and_leaves_the_scene_as_it_was(shown, message, named):
    shown.go_on(3)
    before, time_s = shown.scene.sim, shown.scene.sim.time
    shown.change(message)
    told = shown.last(Notice)
    assert told.kind == "error" and named in told.text
    assert shown.scene.sim is before and shown.scene.keys == {}
    shown.go_on()
    assert before.time > time_s
    if isinstance(message, Turn):
        assert shown.last(Values).values[FREQUENCY] == 200.0


def test_a_place_that_is_no_slider_is_passed_over(shown):
    shown.change(Turn(("key", "stimulus.arrays", None), 1.0), Turn(("pose", "motion.shift", 0), 1.0))
    assert not shown.all(Notice) and shown.scene.keys == {}


def test_any_key_can_be_set(shown):
    shown.change(SetKey("stimulus.ramp_s=0.01"))
    assert shown.scene.sim.runtime.spec.stimuli[0].config.ramp_s == 0.01


def test_keys_that_need_one_another_are_set_at_once_and_get_their_sliders(shown):
    shown.change(SetKey("stimulus.path=circle; stimulus.path_diameter_m=0.01;stimulus.path_rate_Hz=50"))
    assert shown.last(Notice).kind == "info"
    places = {slider.place for slider in shown.last(SceneShown).sliders}
    assert {("key", "stimulus.path_diameter_m", None), ("key", "stimulus.path_rate_Hz", None), FREQUENCY} <= places
    shown.change(SetKey("stimulus.path=; stimulus.path_diameter_m=;stimulus.path_rate_Hz="))
    assert ("key", "stimulus.path_rate_Hz", None) not in {slider.place for slider in shown.last(SceneShown).sliders}


def test_play_pause_and_reset(shown):
    shown.go_on(4)
    shown.scene.receive(Press("pause"))
    paused = shown.scene.sim.time
    shown.go_on(3)
    assert shown.scene.sim.time == paused
    shown.scene.receive(Request("moment"))
    shown.go_on()
    assert not shown.last(Moment).playing and shown.last(Moment).speed == 0.0
    shown.scene.receive(Press("reset"))
    assert shown.scene.sim.time == 0.0 and not shown.scene.sim.skin().displacement.any()
    shown.scene.receive(Press("play"))
    shown.go_on(2)
    assert shown.scene.sim.time > 0.0


def test_a_pace_is_kept(shown):
    """At a hundredth of real time a step of 1 ms is due every 100 ms."""
    shown.scene.receive(Pace(0.01))
    begun = shown.scene.sim.time
    shown.go_on(50)
    assert shown.scene.sim.time - begun < 0.01


def test_modes_go_on_with_another_sound_as_they_stood(modal):
    """After the change the motion is that of the old sound's end and that of the new sound's beginning, added up."""
    scene = modal.scene
    scene._reset()
    modal.go_on(30)
    sim, path, keys = scene.sim, scene.source.scene, dict(scene.keys)
    time_s = sim.time
    modal.change(Turn(DEPTH, 0.5))
    assert scene.sim is sim and len(modal.all(SceneShown)) == 1
    assert modal.last(Notice).text.endswith("the scene is unchanged")
    assert sim.time == pytest.approx(time_s + sim.model.opt.timestep)
    modal.go_on(4)
    ended = palmfield.Simulation(path, device="cpu", keys=keys)
    ended.step(30)
    silent = stimulus_texts(ended.runtime)["stimulus"] | {"drive_amplitude": "0"}
    assert change_stimuli(ended, {"stimulus": silent})
    ended.step(5)
    begun = palmfield.Simulation(path, device="cpu", keys=scene.keys)
    begun.start_at(time_s)
    begun.step(5)
    both = ended.skin().displacement + begun.skin().displacement
    assert np.abs(sim.skin().displacement - both).max() < 1e-3 * np.abs(both).max()
    assert np.abs(ended.skin().displacement).max() > 0.01 * np.abs(both).max()


def test_with_modes_the_focus_moves_at_once(modal):
    scene, time_s = modal.scene, modal.scene.sim.time
    modal.change(Turn(FOCUS_X, 5.0))
    sim = scene.sim
    assert sim.time == pytest.approx(time_s + sim.model.opt.timestep)
    middle = np.average(sim.skin().position, axis=0, weights=sim.skin().arp.astype(float) ** 2)
    assert middle[0] == pytest.approx(0.005, abs=1e-3)


def test_modes_are_rebuilt_for_a_sound_that_asks_for_a_finer_mesh(modal):
    frequency = modal.scene.sim.runtime.model.skins[0].layer.demand.max_frequency_Hz
    modal.change(Turn(FREQUENCY, 1.2 * frequency))
    told = [one.text for one in modal.all(Notice)]
    assert any("rebuilding" in text for text in told[-2:])


def test_a_recording_is_a_run_of_its_keys(shown, path):
    out = shown.scene.out
    shown.change(SetKey("stimulus.am_frequency_Hz=100"))
    shown.scene.receive(Press("reset"))
    shown.scene.receive(Press("record"))
    shown.scene.receive(Request("replay"))
    shown.go_on(25)
    assert len(shown.all(Replay)) == 1
    shown.scene.receive(Press("stop recording"))
    folder = out / "recording-001"
    told = json.loads((folder / "keys.json").read_text())
    assert told["keys"] == {"stimulus.am_frequency_Hz": "100"} and told["begun_s"] == 0.0
    alone = recorded(palmfield.Simulation(path, device="cpu", keys=told["keys"]), 25)
    with open_result(folder / "result.nc") as result:
        assert result.attrs["complete"] == 1 and "live view" in result.attrs["reason"]
        for name in ("displacement", "velocity", "arp"):
            np.testing.assert_array_equal(result["skin/skin"][name].values, alone["skin/skin"][name].values)
        files, _ = draw_pictures(result, folder / "plots", ["rms", "drives"])
    assert all(file.stat().st_size > 1000 for file in files.values()) and len(files) == 2
    assert json.loads((folder / "summary.json").read_text())["steps"] == 25


def test_a_change_ends_a_recording_and_begins_the_next(modal):
    scene = modal.scene
    scene._reset()
    scene.receive(Press("record"))
    modal.go_on(3)
    modal.change(Turn(DEPTH, 0.7))
    modal.go_on(3)
    scene.receive(Press("stop recording"))
    first, second = sorted(scene.out.glob("recording-*"))[-2:]
    depths = []
    for folder in (first, second):
        with open_result(folder / "result.nc") as result:
            assert result.attrs["complete"] == 1
            depths.append(json.loads(result["stimulus/stimulus"].attrs["config"])["am_depth"])
    assert depths[0] != 0.7 and depths[1] == 0.7


def test_what_a_killed_view_has_recorded_is_recovered(shown, tmp_path):
    shown.scene.receive(Press("record"))
    shown.go_on(5)
    recording = shown.scene._recording
    recording._store._flush()
    # No finish: as after SIGKILL
    files = recover(recording.out)
    with open_result(files["result.nc"]) as result:
        assert result.attrs["complete"] == 0 and result.sizes["step_time"] == 5


def test_a_folder_that_cannot_be_written_is_told(shown, tmp_path):
    shown.scene.out = tmp_path / "file"
    shown.scene.out.write_text("")
    shown.scene.receive(Press("record"))
    assert shown.last(Notice).kind == "error"
    shown.go_on()
    assert shown.scene.playing


def test_an_offset_moves_and_turns_about_the_hands_own_axes():
    """Held against rotation matrices written out: 90 deg about x takes y to z."""
    from palmfield.motion.pose import HandPose

    quarter_about_z = np.array([math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)])
    pose = HandPose(np.array([0.1, 0.2, 0.3]), quarter_about_z, {"index": 3.0})
    moved = Offset(np.array([0.0, 0.0, 0.05]), np.array([90.0, 0.0, 0.0])).put(pose)
    np.testing.assert_allclose(moved.position, [0.1, 0.2, 0.35])
    assert moved.angles_deg == pose.angles_deg
    w, x, y, z = moved.quaternion
    turned_y = np.array([2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)])
    # The hand's own y is now along its old z, which is the world's z
    np.testing.assert_allclose(turned_y, [0.0, 0.0, 1.0], atol=1e-12)


def test_a_scripted_body_is_shifted_from_where_its_script_has_it(small_scene, tmp_path):
    table = tmp_path / "motion.csv"
    table.write_text("time_s,x_m,y_m,z_m,qw,qx,qy,qz\n0,0,0,0.12,0,1,0,0\n1,0,0,0.12,0,1,0,0\n")
    path = small_scene(skin={"solver": "wedges"})
    plain = path.with_name("plain.xml")
    text = plain.read_text()
    begin, end = text.index("<joint"), text.index('<site name="centre"')
    plain.write_text((text[:begin] + text[end:]).replace('gravcomp="1"', 'mocap="true"'))
    motion = (
        '<plugin plugin="palmfield.motion"><instance name="script"><config key="body" value="pad"/>'
        f'<config key="trajectory" value="{table}"/></instance></plugin>'
    )
    path.write_text(path.read_text().replace("</extension>", motion + "</extension>"))
    view = Shown(path, tmp_path / "out")
    place = ("pose", "script.shift", 2)
    assert view.last(Values).values[place] == 0.0
    view.go_on(2)
    view.scene.receive(Turn(place, 15.0))
    view.go_on(2)
    body = view.scene.sim.model.body("pad").id
    assert view.scene.sim.data.xpos[body][2] == pytest.approx(0.135)
    view.scene.receive(Request("moment"))
    view.go_on()
    assert view.last(Moment).pose.skins[0][0][:, 2].mean() == pytest.approx(0.135, abs=1e-4)
    # A rebuilt scene keeps what was set
    view.change(SetKey("stimulus.am_depth=0.5"))
    view.go_on(2)
    assert view.scene.sim.data.xpos[view.scene.sim.model.body("pad").id][2] == pytest.approx(0.135)
    # Into the array: refused in words, and it pauses where it stands
    view.scene.receive(Turn(place, -125.0))
    view.go_on(3)
    assert view.last(Notice).kind == "error" and not view.scene.playing
