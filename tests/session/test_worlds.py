"""Worlds that are stepped together: each does what a simulation by itself does."""

import os
import signal

import mujoco
import numpy as np
import pytest

import palmfield
from palmfield.engine import many_data
from palmfield.engine.worlds import SceneWorlds
from palmfield.errors import DeviceError, SceneError
from palmfield.simulation import build_worlds, host_backend, sensors
from palmfield.skin.stepper_choice import StepperChoice

STEPS = 14
SAME = 1e-9
"""What sums in another order may differ by, of the largest number."""
SHARED = {"max_frequency_Hz": 400, "element_m": 0.01}
"""Keys of the skin by which all worlds, and single runs of them, have the same layer."""
COARSE = SHARED | {"accuracy": 0.4}
"""So that a small disc has fewer modes than unknowns."""
LONG_S = 5.0
"""Scenes that run so long are worth a small model."""
FOCI = [(0.0, 0.0, 0.12), (0.004, 0.0, 0.12), (0.0, -0.003, 0.12)]


def differ(one, other):
    """Largest difference over the largest number of either."""
    one, other = np.asarray(one), np.asarray(other)
    assert one.shape == other.shape
    size = max(np.abs(one).max(initial=0.0), np.abs(other).max(initial=0.0))
    return 0.0 if size == 0.0 else np.abs(one - other).max() / size


def assert_alike(together, singles, least_N=1e-6):
    """Sensors, forces, bodies, sound and skins; none of it may be 0 in all worlds."""
    for world, single in enumerate(singles):
        data = together.data[world]
        assert together.time == single.time
        assert differ(together.sensors[world], single.data.sensordata) < SAME
        assert differ(together.forces[world], single.forces) < SAME
        assert differ(data.qpos, single.data.qpos) < SAME and differ(data.qvel, single.data.qvel) < SAME
        assert differ(together.emitted[world], single.emitted) < SAME
        assert differ(together.drive[world], single.drive) < SAME
        for name in single.skins:
            own, alone = together.skin(name), single.skin(name)
            if not single.forces.any() and not alone.displacement.any():
                assert not own.displacement[world].any()  # alone, silence has another layer
                continue
            assert own.solver[world] == alone.solver
            assert differ(own.displacement[world], alone.displacement) < SAME
            assert differ(own.velocity[world], alone.velocity) < SAME
            assert differ(own.normal_displacement[world], alone.normal_displacement) < SAME
            assert differ(own.arp[world], alone.arp) < SAME
            assert differ(own.position[world], alone.position) < SAME
            np.testing.assert_array_equal(own.rest_position, alone.rest_position)
    assert np.linalg.norm(together.forces) > least_N
    assert all(np.abs(together.skin(name).displacement).max() > 1e-9 for name in together.skins)


def singles_of(path, keys, worlds, common=None):
    """A simulation by itself with each world's keys."""
    return [
        palmfield.Simulation(path, keys=(common or {}) | {key: value[world] for key, value in keys.items()})
        for world in range(worlds)
    ]


def yielding(path):
    """The scene with a body that the sound pushes away along its axis."""
    plain = path.with_name("plain.xml")
    plain.write_text(plain.read_text().replace('axis="1 0 0" stiffness="400"', 'axis="0 0 1" stiffness="20"'))
    return path


LEVELS = {
    "stimulus.focus_m": FOCI,
    "stimulus.am_depth": [1.0, 0.5, 0.8],
    "stimulus.am_frequency_Hz": np.array([200.0, 150.0, 90.0]),
}
SOUNDS = {
    "levels": LEVELS,
    "one load, louder and softer": {"stimulus.drive_amplitude": [1.0, 0.25, 0.5]},
    "beginnings and ends": {
        "stimulus.start_s": [0.0, 0.0035, 0.002],
        "stimulus.stop_s": [None, 0.009, 0.0122],
        "stimulus.ramp_s": [0.0, 0.004, 0.0],
    },
    "one is silent": {"stimulus.drive_amplitude": np.array([0.0, 1.0, 0.5])},
    "modulated or not": {
        "stimulus.modulation": ["am", "none", "am"],
        "stimulus.am_quantity": ["amplitude", None, "arp"],
        "stimulus.am_frequency_Hz": [200, None, 100],
        "stimulus.am_depth": [1, None, 0.3],
        "stimulus.arp_peak_Pa": [12.0, 10.0, None],
    },
    "waveforms": {
        "stimulus.am_quantity": ["duty", "amplitude", "arp"],
        "stimulus.am_waveform": ["sine", "rectangle", "hann"],
        "stimulus.am_waveform_duty": [None, 0.4, 0.7],
        "stimulus.am_normalisation": ["mean", "peak", "carrier"],
        "stimulus.am_depth": [1.0, 0.6, 0.8],
        "stimulus.drive_amplitude": [0.4, 1.0, 0.5],
    },
    "bursts of a sine": {
        "stimulus.am_waveform": ["burst", "burst", "burst"],
        "stimulus.am_burst_length_s": [0.006, 0.005, 0.009],
        "stimulus.am_burst_period_s": [0.008, 0.005, 0.02],
    },
    "a path beside points": {
        "stimulus.path": ["point", "circle", "line"],
        "stimulus.path_diameter_m": [None, 0.01, None],
        "stimulus.path_width_m": [None, None, 0.008],
        "stimulus.path_rate_Hz": [None, 70.0, 30.0],
    },
    "bursts and ticks": {
        "stimulus.burst_window": ["none", "rectangular", "hann"],
        "stimulus.burst_length_s": [None, 0.002, 0.003],
        "stimulus.burst_period_s": [None, 0.005, 0.006],
        "stimulus.control_rate_Hz": [300.0, 0.0, 0.0],
    },
    "several foci": {"stimulus.foci_m": [(), (0.006, 0, 0, -0.006, 0, 0), (0.0, 0.005, 0, 0, -0.005, 0)]},
}


@pytest.mark.parametrize("response", ["on", "off"])
@pytest.mark.parametrize("sound", SOUNDS)
def test_each_world_is_what_it_would_be_alone(sound, response, small_scene):
    """Whole layers, at every step; the body yields to the sound."""
    keys = SOUNDS[sound]
    path = yielding(small_scene(array={"response": response}, skin=SHARED | {"solver": "wedges"}))
    together = palmfield.Simulation(path, worlds=3, keys=keys)
    singles = singles_of(path, keys, 3)
    for _ in range(STEPS):
        together.step()
        for single in singles:
            single.step()
        assert differ(together.sensors, [single.data.sensordata for single in singles]) < SAME
    assert_alike(together, singles)
    assert max(np.abs(single.data.qpos).max() for single in singles) > 1e-9


@pytest.mark.parametrize("worlds", [[0.5, 0.0, 1.0, 0.3], [0.0, 0.5, 0.0, 1.0]])
def test_worlds_at_other_levels_have_the_response_of_single_runs(worlds, small_scene):
    """Also after silent ones, which need none."""
    keys = {"stimulus.drive_amplitude": worlds, "stimulus.start_s": [0.0, 0.0, 0.0, 0.01]}
    path = small_scene(skin=SHARED)
    together = palmfield.Simulation(path, worlds=4, keys=keys)
    own = [model.stimuli[0].response for model in together._scenes.models]
    for level, response, single in zip(worlds, own, singles_of(path, keys, 4), strict=True):
        alone = single.runtime.model.stimuli[0].response
        assert response.on == alone.on == (level > 0.0)
        np.testing.assert_array_equal(response.delays_s, alone.delays_s)
        assert response.ring_up.rms == pytest.approx(alone.ring_up.rms, rel=1e-12)
        assert response.flight_time.rms == pytest.approx(alone.flight_time.rms, rel=1e-12)


@pytest.mark.parametrize("sound", ["levels", "one load, louder and softer", "one is silent"])
def test_small_models_of_worlds_are_those_of_single_runs(sound, small_scene):
    keys = SOUNDS[sound]
    path = small_scene(skin=SHARED, duration_s=LONG_S)
    together = palmfield.Simulation(path, worlds=3, keys=keys)
    together.step(STEPS)
    assert set(together.skin().solver) == {"reduced"}
    loads = {id(model.begin[0]) for model in together._scenes.models}
    assert len(loads) == (3 if sound == "levels" else 1)
    singles = singles_of(path, keys, 3)
    for single in singles:
        single.step(STEPS)
    assert_alike(together, singles)


def test_small_models_are_left_where_a_body_moves(small_scene):
    """A push moves the second world's body after some steps: it goes on with the whole layer, the others don't."""
    path = yielding(small_scene(duration_s=LONG_S))
    keys = SOUNDS["one load, louder and softer"]
    together = palmfield.Simulation(path, worlds=3, keys=keys)
    singles = singles_of(path, keys, 3)
    for step in range(STEPS):
        if step == 5:
            together.data[1].qvel[:] = singles[1].data.qvel[:] = 0.5
        together.step()
        for single in singles:
            single.step()
    assert together.skin().solver == ("reduced", "wedges", "reduced")
    assert_alike(together, singles)


@pytest.mark.parametrize("sound", ["levels", "beginnings and ends", "a path beside points"])
def test_modes_serve_the_loads_of_all_worlds(sound, small_scene):
    keys = SOUNDS[sound]
    path = yielding(small_scene(skin=COARSE | {"solver": "modal"}))
    together = palmfield.Simulation(path, worlds=3, keys=keys)
    singles = singles_of(path, keys, 3)
    together.step(STEPS)
    for single in singles:
        single.step(STEPS)
    assert len({id(model.begin[0].value) for model in together._scenes.models}) == 1
    assert set(together.skin().solver) == {"modal"}
    assert_alike(together, singles)
    for runtime, single in zip(together._scenes.runtimes, singles, strict=True):
        own, alone = runtime.work.outside[0], single.runtime.work.outside[0]
        assert own.energy_share == pytest.approx(alone.energy_share, rel=1e-3) and alone.energy_share > 0.0


def test_a_world_whose_load_leaves_the_class_goes_on_with_the_whole_layer(small_scene, monkeypatch):
    """Here every load but the first world's does. Their bodies tremble, and count as still as they would alone."""
    path = yielding(small_scene(skin=COARSE, duration_s=LONG_S))
    foci = [(0.0005 * i, 0.0, 0.12) for i in range(9)]
    monkeypatch.setattr(build_worlds, "common_choice", lambda *_: StepperChoice("modal", "for this test", 1.0, 1.0))
    together = palmfield.Simulation(path, worlds=9, keys={"stimulus.focus_m": foci})
    asked = []

    def leaves(model, skin, share):
        asked.append(share)
        return model is not together._scenes.models[0]

    together.step(2)
    assert together._scenes._poses._resting.all() and all(one.qpos[0] != 0.0 for one in together.data)
    monkeypatch.setattr(host_backend, "leaves_class", leaves)
    together.step(2)
    assert together.skin().solver == ("modal", *["wedges"] * 8) and len(asked) == 10 and max(asked) < 0.05
    whole = palmfield.Simulation(path, keys={"stimulus.focus_m": foci[5], "skin.solver": "wedges"})
    whole.step(4)
    # It set out on modes, and so with what they may err
    began = together._scenes.models[0].begin[0].value
    assert differ(together.skin().displacement[5], whole.skin().displacement) < began.error < COARSE["accuracy"]


def test_many_different_loads_share_a_stepper(small_scene):
    foci = [(0.0005 * i, 0.0, 0.12) for i in range(9)]
    path = small_scene(skin=SHARED, duration_s=LONG_S)
    together = palmfield.Simulation(path, worlds=9, keys={"stimulus.focus_m": foci})
    (solver,) = set(together.skin().solver)
    assert solver in ("modal", "wedges")
    assert "9 different loads" in together._scenes.models[0].skins[0].choice.why
    together.step(3)
    assert palmfield.Simulation(path).skin().solver == "reduced"
    alone = palmfield.Simulation(path, keys={"stimulus.focus_m": foci[7], "skin.solver": solver})
    alone.step(3)
    assert differ(together.skin().displacement[7], alone.skin().displacement) < SAME


def test_layers_serve_the_strictest_world(small_scene):
    """A faster modulation wants a finer layer and shorter steps: all worlds have them."""
    path = small_scene(skin={"element_m": None, "step_s": None, "solver": "wedges"})
    fast = palmfield.Simulation(path, keys={"stimulus.am_frequency_Hz": 200.0})
    slow = palmfield.Simulation(path, keys={"stimulus.am_frequency_Hz": 60.0})
    together = palmfield.Simulation(path, worlds=2, keys={"stimulus.am_frequency_Hz": [60.0, 200.0]})
    shared = together._scenes.models[0]
    assert shared.substeps == fast.runtime.model.substeps > slow.runtime.model.substeps
    together.step(4)
    fast.step(4)
    assert differ(together.skin().displacement[1], fast.skin().displacement) < SAME


def test_what_modes_state_of_their_error_is_for_the_most_sudden_world(small_scene):
    path = small_scene(skin={"max_frequency_Hz": 400, "element_m": 0.01, "accuracy": 0.33, "solver": "modal"})
    stated = []
    for frequencies in ([50.0, 390.0], [390.0, 50.0], [50.0, 60.0]):
        sim = palmfield.Simulation(path, worlds=2, keys={"stimulus.am_frequency_Hz": frequencies})
        stated.append([runtime.model.begin[0].value.error for runtime in sim.runtimes])
    assert stated[0] == stated[1] and stated[0][0] == stated[0][1]
    assert stated[2][0] < 0.95 * stated[0][0]


def test_two_skins_in_each_world(small_scene, add_skin, monkeypatch):
    """MuJoCo steps the bodies of several worlds at once, in threads."""
    monkeypatch.setattr(many_data, "WORLDS_PER_THREAD", 1)
    monkeypatch.setattr(many_data, "cores", lambda: 3)
    path = add_skin(small_scene(skin=SHARED | {"solver": "wedges"}), "0.01 0 0.15")
    together = palmfield.Simulation(path, worlds=3, keys=LEVELS)
    singles = singles_of(path, LEVELS, 3)
    together.step(STEPS)
    for single in singles:
        single.step(STEPS)
    assert together.forces.shape == (3, 2, 3) and together.skins == ("skin", "second")
    assert_alike(together, singles)


def test_several_stimuli_in_each_world(small_scene, add_array):
    """Worlds whose sound is more than one drive are stepped by themselves, in the same step as the others."""
    path = add_array(small_scene(skin=SHARED | {"solver": "wedges"}))
    text = path.read_text()
    second = (
        '<instance name="other"><config key="arrays" value="second"/><config key="focus_m" value="0 0 0.12"/>'
        '<config key="frame" value="array"/></instance>'
    )
    first = '<instance name="stimulus"><config key="arrays" value="array"/>'
    text = text.replace('<instance name="stimulus">', second + first, 1)
    path.write_text(text)
    keys = {
        "stimulus.focus_m": FOCI,
        "palmfield.stimulus.drive_amplitude": [1.0, 0.7, 0.4],
        "other.start_s": [0, 0.003, 0.02],
    }
    together = palmfield.Simulation(path, worlds=3, keys=keys)
    singles = singles_of(path, keys, 3)
    together.step(STEPS)
    for single in singles:
        single.step(STEPS)
    assert_alike(together, singles)


# -- bodies that move ------------------------------------------------------------------------------------------------


def led(path, motion=""):
    """The scene with its body led by a script in place of a joint."""
    plain = path.with_name("plain.xml")
    text = plain.read_text()
    begin, end = text.index("<joint"), text.index('<site name="centre"')
    plain.write_text((text[:begin] + text[end:]).replace('gravcomp="1"', 'mocap="true"'))
    path.write_text(path.read_text().replace("</extension>", motion + "</extension>"))
    return path


def wandering(worlds, steps, seed=0):
    """Poses that drift sideways and up, and turn, by other amounts in each world."""
    rng = np.random.default_rng(seed)
    speeds = rng.uniform(-2e-4, 2e-4, (worlds, 1, 3))
    poses = np.empty((worlds, steps, 7))
    poses[..., :3] = [0.0, 0.0, 0.12] + speeds * np.arange(steps)[None, :, None]
    angle = rng.uniform(-0.004, 0.004, (worlds, 1)) * np.arange(steps)
    # About the body's x axis, from the pose that it has in the file
    poses[..., 3], poses[..., 4] = np.cos(0.5 * (np.pi + angle)), np.sin(0.5 * (np.pi + angle))
    poses[..., 5:] = 0.0
    return poses


@pytest.mark.parametrize("solver", ["wedges", "auto"])
def test_poses_lead_a_body_in_each_world(solver, small_scene):
    path = led(small_scene(skin=SHARED | {"solver": solver}, duration_s=LONG_S))
    poses = wandering(3, STEPS - 3)
    poses[0] = poses[0, :1]
    keys = SOUNDS["one load, louder and softer"]
    together = palmfield.Simulation(path, worlds=3, keys=keys, poses={"pad": poses})
    singles = singles_of(path, keys, 3)
    for step in range(STEPS):
        together.step()
        for single, pose in zip(singles, poses[:, min(step, STEPS - 4)], strict=True):
            single.data.mocap_pos[0], single.data.mocap_quat[0] = pose[:3], pose[3:]
            single.step()
    assert_alike(together, singles)
    if solver == "auto":
        assert together.skin().solver == ("reduced", "wedges", "wedges")
    together.reset()
    np.testing.assert_allclose(together.data[1].xpos[together.model.body("pad").id], poses[1, 0, :3])


def test_scripted_motions_lead_bodies_in_all_worlds(small_scene, tmp_path):
    table = tmp_path / "motion.csv"
    table.write_text(
        "time_s,x_m,y_m,z_m,qw,qx,qy,qz\n0,0,0,0.12,0,1,0,0\n0.01,0.002,0,0.122,0,1,0,0\n0.02,0.002,0,0.122,0,1,0,0\n"
    )
    motion = (
        '<plugin plugin="palmfield.motion"><instance name="motion"><config key="body" value="pad"/>'
        f'<config key="trajectory" value="{table}"/></instance></plugin>'
    )
    path = led(small_scene(skin=SHARED), motion)
    keys = SOUNDS["levels"]
    together = palmfield.Simulation(path, worlds=3, keys=keys)
    singles = singles_of(path, keys, 3)
    together.step(STEPS)
    for single in singles:
        single.step(STEPS)
    assert_alike(together, singles)
    together.start_at(0.005)
    singles[2].start_at(0.005)
    together.step(2)
    singles[2].step(2)
    assert differ(together.sensors[2], singles[2].data.sensordata) < SAME


def test_bodies_that_touch_do_so_in_each_world_alone(small_scene):
    """A ball rolls down the pad while the sound pushes the pad away, by another level in each world."""
    path = yielding(small_scene(skin=COARSE))
    plain = path.with_name("plain.xml")
    ball = '<body pos="0.003 0 0.135"><freejoint/><geom size="0.004" mass="0.002" contype="1" conaffinity="1"/></body>'
    text = plain.read_text().replace("</worldbody>", ball + "</worldbody>")
    assert 'contype="0"' in text
    plain.write_text(text.replace('contype="0"', 'contype="1"').replace('conaffinity="0"', 'conaffinity="1"'))
    keys = {"stimulus.drive_amplitude": [1.0, 0.3]}
    together, singles = palmfield.Simulation(path, keys=keys, worlds=2), singles_of(path, keys, 2)
    touched = np.zeros(2, bool)
    for _ in range(40):
        for sim in (together, *singles):
            sim.step()
        touched |= [data.ncon > 0 for data in together.data]
    assert touched.all()
    assert_alike(together, singles)


@pytest.mark.nightly
@pytest.mark.parametrize("body_sound", ["shadows", "scattering"])
def test_shadows_and_scattering_belong_to_their_world(body_sound, small_scene):
    """Buffers and trees are shared; answers are not."""
    path = led(small_scene(array={"response": "off"}, skin=SHARED | {"solver": "wedges", "body_sound": body_sound}))
    poses = wandering(2, 2)
    keys = {"stimulus.focus_m": FOCI[:2]}
    together = palmfield.Simulation(path, worlds=2, keys=keys, poses={"pad": poses})
    singles = singles_of(path, keys, 2)
    for step in range(2):
        together.step()
        for single, pose in zip(singles, poses[:, step], strict=True):
            single.data.mocap_pos[0], single.data.mocap_quat[0] = pose[:3], pose[3:]
            single.step()
    assert_alike(together, singles)


# -- one step for all ------------------------------------------------------------------------------------------------


def test_a_further_world_costs_few_python_functions(small_scene, python_calls):
    """Of a single simulation's step, which runs some hundred, hardly any is repeated for each world.

    The body trembles about its place, and a copy finds that as quickly.
    """
    path = yielding(small_scene(duration_s=LONG_S))
    counts = {}
    for worlds in (2, 12):
        sim = palmfield.Simulation(
            path, worlds=worlds, keys={"stimulus.drive_amplitude": np.linspace(0.5, 1.0, worlds)}
        )
        sim.step(6)
        counts[worlds] = min(python_calls(sim.step) for _ in range(4))
    assert set(sim.skin().solver) == {"reduced"} and sim.data[0].qpos[0] != 0.0
    twin = sim.copy()
    twin.step(2)
    assert min(python_calls(twin.step) for _ in range(4)) <= counts[12] + 5
    alone = palmfield.Simulation(path)
    alone.step(6)
    single = min(python_calls(alone.step) for _ in range(4))
    assert (counts[12] - counts[2]) / 10 < 0.2 * single


def test_skins_are_stepped_in_one_call(small_scene, monkeypatch):
    sim = palmfield.Simulation(small_scene(), worlds=4, keys={"stimulus.drive_amplitude": np.linspace(0.5, 1.0, 4)})
    sim.step(2)
    stepper, shapes = sim._scenes.models[0].begin[0].value, []
    plain = type(stepper).step

    def noted(self, state, *arguments):
        shapes.append(state.shape)
        return plain(self, state, *arguments)

    monkeypatch.setattr(type(stepper), "step", noted)
    sim.step(3)
    assert shapes == [(4, stepper.state_size)] * 3


def test_one_world_is_the_plain_simulation(small_scene):
    path = yielding(small_scene())
    together, alone = palmfield.Simulation(path, worlds=1), palmfield.Simulation(path)
    assert type(together) is type(alone) is palmfield.Simulation and "__new__" not in vars(palmfield.Simulation)
    assert together.worlds == 1 and alone.worlds is None and together.sensors.shape == (1, 6)
    np.testing.assert_array_equal(alone.sensors, alone.data.sensordata)
    assert differ(together.forces[0], alone.forces) < SAME and np.abs(alone.forces).max() > 0.0
    assert differ(together.sensors[0], alone.data.sensordata) < SAME
    assert differ(together.data[0].qacc, alone.data.qacc) < SAME
    together.run(0.014)
    alone.run(0.014)
    assert_alike(together, [alone])
    np.testing.assert_array_equal(together.sensor("skin"), together.sensors)
    assert together.bodies == alone.bodies and together.duration_s == alone.duration_s


# -- states ----------------------------------------------------------------------------------------------------------


def everything(sim):
    return [sim.sensors, sim.forces, sim.emitted, sim.skin().displacement, sim.skin().velocity, np.array([sim.time])]


@pytest.mark.parametrize("sound", ["one load, louder and softer", "a path beside points", "bursts and ticks"])
def test_a_copy_goes_on_by_itself(sound, small_scene):
    path = yielding(small_scene(skin={"solver": "wedges"}))
    sim = palmfield.Simulation(path, worlds=3, keys=SOUNDS[sound])
    sim.step(5)
    twin, before = sim.copy(), everything(sim)
    for one, other in zip(everything(twin), before, strict=True):
        np.testing.assert_array_equal(one, other)
    twin.step(6)
    for one, other in zip(everything(sim), before, strict=True):
        np.testing.assert_array_equal(one, other)
    sim.step(6)
    for one, other in zip(everything(sim), everything(twin), strict=True):
        assert differ(one, other) < SAME


def test_a_reset_repeats_the_run(small_scene):
    path = yielding(small_scene())
    sim = palmfield.Simulation(path, worlds=3, keys=LEVELS)
    first = everything(sim)
    sim.step(6)
    then = everything(sim)
    sim.reset()
    assert sim.time == 0.0 and not sim.skin().displacement.any()
    for one, other in zip(everything(sim), first, strict=True):
        np.testing.assert_array_equal(one, other)
    sim.step(6)
    for one, other in zip(everything(sim), then, strict=True):
        np.testing.assert_array_equal(one, other)


def test_ctrl_c_waits_for_the_end_of_the_step(small_scene, monkeypatch):
    path = small_scene()
    keys = SOUNDS["one load, louder and softer"]
    whole, sim = (palmfield.Simulation(path, worlds=3, keys=keys) for _ in range(2))
    whole.step(3)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    plain, calls = SceneWorlds._sense, []

    def pressed(self, *arguments):
        calls.append(1)
        if len(calls) == 3:
            os.kill(os.getpid(), signal.SIGINT)
        return plain(self, *arguments)

    try:
        with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
            patch.setattr(SceneWorlds, "_sense", pressed)
            sim.step(10)
    finally:
        signal.signal(signal.SIGINT, before)
    whole.step(2)
    sim.step(2)
    for one, other in zip(everything(sim), everything(whole), strict=True):
        np.testing.assert_array_equal(one, other)


# -- what is refused -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ({"stimulus.focus_m": np.zeros((4, 3))}, r"stimulus.focus_m' has shape \(4, 3\); allowed.*\(3,\).*\(3, 3\)"),
        ({"stimulus.focus_m": np.zeros((3, 2))}, r"shape \(3, 2\); allowed with 3 worlds"),
        ({"stimulus.focus_m": np.zeros((3, 3, 1))}, r"shape \(3, 3, 1\); allowed"),
        ({"stimulus.am_depth": [0.1, 0.2]}, r"am_depth' has shape \(2,\); allowed with 3 worlds: \(\).*\(3,\)"),
        ({"stimulus.am_depth": np.ones((3, 1))}, r"shape \(3, 1\)"),
        (
            {"stimulus.am_depth": [0.1, 0.2, 1.2]},
            "world 2: plugin 'palmfield.stimulus'.*key 'am_depth' has value '1.2'",
        ),
        ({"stimulus.am_depht": [0.1, 0.2, 0.3]}, "unknown key 'am_depht'"),
        ({"stimulo.am_depth": [0.1, 0.2, 0.3]}, "'stimulo.am_depth' belongs to no instance"),
        ({"skin.material": ["palm", "palm", "ecoflex_00-10"]}, "'skin.material' .*share the skin's mesh and matrices"),
        ({"array.layout": ["uhev1", "uhev1", "uhev1"]}, "'array.layout' .* share the arrays"),
        ({"driver.board": ["ideal", "ideal", "ideal"]}, "share the board"),
        ({"stimulus.frame": ["array", "array", "centre"]}, "names parts of the scene.*keys that may differ"),
        ({"stimulus.arrays": [["array"], ["array"], ["array"]]}, "names parts of the scene"),
        ({"stimulus.focus_m": [(0, 0, 0.12), (0, 0, 0.12), (0, 0, -0.1)]}, "focus_m"),
    ],
)
def test_keys_that_do_not_fit_are_refused(keys, told, small_scene):
    with pytest.raises(SceneError, match=told):
        palmfield.Simulation(small_scene(), worlds=3, keys=keys)


@pytest.mark.parametrize("worlds", [0, -2, 1.5, "3", True, np.array([2])])
def test_a_number_of_worlds_that_is_none_is_refused(worlds, small_scene):
    with pytest.raises(SceneError, match=r"worlds is .*; allowed: a whole number of 1 or more"):
        palmfield.Simulation(small_scene(), worlds=worlds)


@pytest.mark.parametrize(
    ("poses", "told"),
    [
        ({"pad": np.zeros((2, 5, 7))}, r"poses of 'pad' have shape \(2, 5, 7\); allowed: \(3, steps, 7\)"),
        ({"pad": np.zeros((3, 5, 6))}, r"shape \(3, 5, 6\)"),
        ({"pad": np.zeros((3, 0, 7))}, "steps >= 1"),
        ({"pad": np.zeros((3, 5, 7))}, "world 0, step 0, is .*a quaternion of length 1"),
        ({"bad": wandering(3, 5)}, "poses are given for body 'bad'; allowed: a body with mocap='true': pad"),
    ],
)
def test_poses_that_do_not_fit_are_refused(poses, told, small_scene):
    with pytest.raises(SceneError, match=told):
        palmfield.Simulation(led(small_scene()), worlds=3, poses=poses)


def test_poses_need_worlds(small_scene):
    with pytest.raises(SceneError, match=r"poses are given without worlds"):
        palmfield.Simulation(led(small_scene()), poses={"pad": wandering(1, 5)})


def test_memory_that_runs_out_says_what_to_change(small_scene, monkeypatch):
    """What Warp raises there, word for word; here nothing runs out."""
    sim = palmfield.Simulation(small_scene(), worlds=2)
    sim.step()

    def full(*_):
        raise RuntimeError("Failed to allocate 68719476736 bytes on device 'cuda:0'")

    monkeypatch.setattr(type(sim.steps), "advance", full)
    with pytest.raises(DeviceError, match=r"cuda:0.*accuracy.*patch_radius_m.*fewer worlds.*device"):
        sim.step()


def test_an_integrator_that_asks_for_forces_within_a_step_is_refused(small_scene):
    path = small_scene()
    sim = palmfield.Simulation(path, worlds=2)
    sim.model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    with pytest.raises(SceneError, match=r"'integrator' has value 'RK4'.*allowed: Euler"):
        sim.step()
    single = palmfield.Simulation(path)
    single.model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    with pytest.raises(SceneError, match=r"'integrator' has value 'RK4'.*allowed: Euler"):
        single.step()
    path.write_text(path.read_text().replace("<option ", '<option integrator="RK4" '))
    for worlds in (None, 2):
        with pytest.raises(SceneError, match=r"RK4"):
            palmfield.Simulation(path, worlds=worlds)


def test_flags_that_switch_forces_or_sensors_off_are_told(small_scene):
    path = small_scene()
    plain = path.read_text()
    path.write_text(plain.replace("<option ", '<option><flag sensor="disable"/></option><option '))
    assert any("flag 'sensor' is disabled, so 1 plugin sensors" in text for text in palmfield.plan(path).warnings)
    path.write_text(plain.replace("<option ", '<option><flag spring="disable" damper="disable"/></option><option '))
    with pytest.raises(SceneError, match=r"disables both 'spring' and 'damper'.*those of the sound"):
        palmfield.Simulation(path)


@pytest.mark.parametrize("integrator", ["Euler", "implicit", "implicitfast"])
def test_every_other_integrator_is_taken(integrator, small_scene):
    path = yielding(small_scene(skin={"solver": "wedges"}))
    path.write_text(path.read_text().replace("<option ", f'<option integrator="{integrator}" '))
    keys = SOUNDS["one load, louder and softer"]
    together = palmfield.Simulation(path, worlds=3, keys=keys)
    singles = singles_of(path, keys, 3)
    together.step(5)
    for single in singles:
        single.step(5)
    assert_alike(together, singles)


def test_errors_name_their_world(small_scene):
    path = led(small_scene(skin={"solver": "wedges"}))
    poses = wandering(3, 2)
    poses[1, 1, :3] = 0.0
    sim = palmfield.Simulation(path, worlds=3, poses={"pad": poses})
    sim.step()
    with pytest.raises(SceneError, match=r"world 1: .*pad"):
        sim.step()


def test_a_world_that_somebody_else_has_stepped_is_refused(small_scene):
    sim = palmfield.Simulation(small_scene(), worlds=2)
    mujoco.mj_step(sim.model, sim.data[1])
    with pytest.raises(SceneError, match=r"world 1 is at 0.001 s and world 0 at 0 s"):
        sim.step()


def test_other_calls_take_one_world(small_scene, tmp_path):
    sim = palmfield.Simulation(small_scene(), worlds=2)
    for call in (palmfield.plan, lambda scene: palmfield.run(scene, tmp_path / "out", progress=False)):
        with pytest.raises(SceneError, match=r"2 worlds"):
            call(sim)


def test_a_further_channel_of_the_sensor_is_read_in_worlds_too(small_scene, monkeypatch):
    """As docs/architecture.md says: a field, filled by `skin_reading`, and an entry of CHANNELS."""

    class Wider(sensors.SkinReading):
        push_N = property(lambda self: float(np.hypot(self.arp_force_x_N, self.arp_force_z_N)))

    monkeypatch.setitem(sensors.CHANNELS, "push_N", lambda reading: reading.push_N)
    monkeypatch.setattr(sensors, "skin_reading", lambda *row: Wider(*row[0], *row[1], row[2]))
    together, single = palmfield.Simulation(small_scene(), worlds=2), palmfield.Simulation(small_scene())
    together.step(3)
    single.step(3)
    assert len(single.data.sensordata) == 7 and single.data.sensordata[6] > 0.0
    for data in together.data:
        np.testing.assert_allclose(data.sensordata, single.data.sensordata, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("use", [palmfield.run, palmfield.plan])
def test_what_takes_one_world_refuses_several(small_scene, use):
    sim = palmfield.Simulation(small_scene(), worlds=2)
    with pytest.raises(palmfield.SceneError, match="is open as 2 worlds; allowed here: a simulation without `worlds`"):
        use(sim)
