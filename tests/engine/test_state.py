"""The state of a scene in MuJoCo's hands: copied, saved, reset, forked, rolled out, and refused where it is foreign."""

import copy
import os
import pickle
import threading
import traceback
import warnings

import mujoco
import mujoco.rollout
import numpy as np
import pytest

import palmfield
from palmfield.engine.host import world_of
from palmfield.simulation import state as states

STEADY = {"modulation": "none", "am_quantity": None, "am_frequency_Hz": None, "am_depth": None}
CIRCLE = STEADY | {"path": "circle", "path_diameter_m": 0.01, "path_rate_Hz": 140}
HELD = {"control_rate_Hz": 150, "frame": "centre", "focus_m": "0 0 0"}
SPEED = 3.0
"""Of the pad at the start of moving scenes [m/s]: damped, it goes 2 mm."""

CASES = {
    "am, still": ({}, 0.0),
    "am, moving": ({}, SPEED),
    "am, moving, ringing": ({"array": {"response": "on"}}, SPEED),
    "circle, still": ({"stimulus": CIRCLE, "array": {"response": "off"}}, 0.0),
    "circle, still, ringing": ({"stimulus": CIRCLE, "array": {"response": "on"}}, 0.0),
    "circle, moving, ringing": ({"stimulus": CIRCLE, "array": {"response": "on"}}, SPEED),
    "circle, still, small model": ({"stimulus": CIRCLE, "skin": {"solver": "reduced"}}, 0.0),
    "am, moving, shadows": ({"skin": {"body_sound": "shadows"}}, SPEED),
    "am, moving, held at control ticks": ({"stimulus": HELD}, SPEED),
    "am, moving, spectral elements": ({"skin": {"solver": "spectral_elements", "accuracy": 0.5}}, SPEED),
    "circle, moving, particles": ({"stimulus": CIRCLE, "skin": {"solver": "particles", "accuracy": 0.5}}, SPEED),
}  # fmt: skip
AHEAD = [name for name in CASES if name.startswith("circle, still")]
"""Loads of these are computed ahead, together, in single precision."""
SAVED_AFTER = {"am, moving, held at control ticks": 7}
"""Steps, where not 5: only in the step of a tick is all that will happen in MuJoCo's state (copies hold it always)."""


@pytest.fixture(params=CASES)
def case(request, small_scene):
    """Name, model, and a maker of fresh data that begins to move as the case says."""
    changes, speed = CASES[request.param]
    model = mujoco.MjModel.from_xml_path(str(small_scene(**changes)))

    def fresh():
        data = mujoco.MjData(model)
        data.qvel[0] = speed
        return data

    return request.param, model, fresh


@pytest.fixture
def model(small_scene):
    return mujoco.MjModel.from_xml_path(str(small_scene()))


def stepped(model, data, count):
    mujoco.mj_step(model, data, count)
    palmfield.raise_errors(data)
    return data


def moving(model, speed=SPEED):
    data = mujoco.MjData(model)
    data.qvel[0] = speed
    return data


def numbers(data):
    """All that a run has changed, to the bit."""
    names = ("plugin_state", "qpos", "qvel", "sensordata", "qfrc_passive")
    return {name: getattr(data, name).tobytes() for name in names}


def parts(model):
    """Where each plugin instance's numbers lie in plugin_state, by name."""
    found = {}
    for i, (start, size) in enumerate(zip(model.plugin_stateadr, model.plugin_statenum, strict=True)):
        found[mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_PLUGIN, i)] = slice(start, start + size)
    return found


def full_state(model, data):
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    vector = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, vector, kind)
    return vector


def set_state(model, data, vector):
    mujoco.mj_setState(model, data, vector, mujoco.mjtState.mjSTATE_INTEGRATION)


# -- whose numbers -------------------------------------------------------------------------------------------------


def test_each_skin_and_each_array_keeps_its_own_numbers(model):
    sim = palmfield.Simulation(model)
    sizes = {name: where.stop - where.start for name, where in parts(model).items()}
    haptic = sim.runtime.model
    assert sizes == {
        "array": states.HEADER + 2 * len(haptic.arrays),
        "skin": states.HEADER + haptic.skins[0].layer.state_room,
        "stimulus": 0,
        "driver": 0,
    }
    assert model.npluginstate == sum(sizes.values())
    sim.step(3)
    for name in ("array", "skin"):
        assert sim.data.plugin_state[parts(model)[name]].any(), name


def test_two_skins_have_a_state_each(small_scene):
    path = small_scene()
    text = path.read_text()
    start = text.index('<instance name="skin">')
    skin = text[start : text.index("</instance>", start) + len("</instance>")]
    path.write_text(text.replace(skin, skin + skin.replace('name="skin"', 'name="other"').replace('"pad"', '"pad2"')))
    plain = path.parent / "plain.xml"
    text = plain.read_text()
    body = text[text.index('<body name="pad"') : text.index("</body>") + len("</body>")]
    twin = body.replace('pos="0 0 0.12"', 'pos="0.06 0 0.12"')
    for name in ("pad", "slide", "centre"):
        twin = twin.replace(f'name="{name}"', f'name="{name}2"')
    plain.write_text(text.replace(body, body + twin))
    sim = palmfield.Simulation(path)
    where = parts(sim.model)
    sim.step(3)
    sizes = {name: where[name].stop - where[name].start for name in ("skin", "other")}
    assert min(sizes.values()) > 1000
    for name in sizes:
        assert sim.data.plugin_state[where[name]].any()
    near, far = (np.abs(sim.skin(name).displacement).max() for name in ("skin", "other"))
    assert near > 2 * far > 0


# -- copies and resets ---------------------------------------------------------------------------------------------


def test_copies_go_on_identically_and_by_themselves(case):
    _, model, fresh = case
    data = stepped(model, fresh(), 5)
    into = stepped(model, mujoco.MjData(model), 2)
    mujoco.mj_copyData(into, model, data)
    twins = [copy.copy(data), copy.deepcopy(data), into]
    before = numbers(data)
    for twin in twins:
        assert numbers(twin) == before
        stepped(model, twin, 4)
        assert numbers(data) == before
    stepped(model, data, 4)
    assert numbers(data)["plugin_state"] != before["plugin_state"]
    for twin in twins:
        assert numbers(twin) == numbers(data)


def test_copies_diverge_where_one_is_moved(model):
    data = stepped(model, moving(model), 4)
    twin = copy.copy(data)
    twin.qpos[0] += 0.01
    stepped(model, twin, 3)
    stepped(model, data, 3)
    np.testing.assert_array_equal(data.plugin_state, stepped(model, moving(model), 7).plugin_state)
    assert np.abs(twin.plugin_state - data.plugin_state).max() > 0


def test_a_simulations_copy_goes_on_identically(case):
    _, model, fresh = case
    sim = palmfield.Simulation(model)
    sim.data.qvel[:] = fresh().qvel
    sim.step(5)
    twin = sim.copy()
    assert twin.runtime.model is sim.runtime.model
    np.testing.assert_array_equal(twin.skin().displacement, sim.skin().displacement)
    twin.step(4)
    assert sim.time == pytest.approx(0.005)
    sim.step(4)
    assert numbers(twin.data) == numbers(sim.data)


def test_a_pickle_goes_on_identically(case):
    """To the bit, but where loads were computed ahead: a pickle can't hold them, and single precision shows."""
    name, model, fresh = case
    data = stepped(model, fresh(), SAVED_AFTER.get(name, 5))
    twin = pickle.loads(pickle.dumps(data))
    before = numbers(data)
    stepped(model, twin, 4)
    assert numbers(data) == before
    stepped(model, data, 4)
    if name in AHEAD:
        close(twin, data)
    else:
        assert numbers(twin) == numbers(data)


def close(one, other):
    """To single precision, skin and sensors apart, as the numbers of a state have several units."""
    for part in ("plugin_state", "sensordata"):
        mine, its = getattr(one, part), getattr(other, part)
        assert np.linalg.norm(mine - its) <= 1e-5 * np.linalg.norm(its)


def test_state_set_back_goes_on(case):
    name, model, fresh = case
    data = stepped(model, fresh(), SAVED_AFTER.get(name, 5))
    vector = full_state(model, data)
    expected = numbers(stepped(model, data, 4))
    set_state(model, data, vector)
    assert numbers(stepped(model, data, 4)) == expected
    other = mujoco.MjData(model)
    set_state(model, other, vector)
    stepped(model, other, 4)
    if name in AHEAD:
        close(other, data)
    else:
        assert numbers(other) == expected


def test_reset_is_all_zeros_and_repeats_the_run(case):
    _, model, fresh = case
    data = stepped(model, fresh(), 7)
    expected = numbers(data)
    assert data.plugin_state.any()
    mujoco.mj_resetData(model, data)
    assert not data.plugin_state.any()
    data.qvel[:] = fresh().qvel
    assert numbers(stepped(model, data, 7)) == expected


def test_a_simulations_reset_repeats_the_run(case):
    _, model, fresh = case
    sim = palmfield.Simulation(model)
    seen = []
    for _ in range(3):
        sim.data.qvel[:] = fresh().qvel
        sim.step(6)
        seen.append((numbers(sim.data), sim.skin().displacement.tobytes(), sim.forces.tobytes()))
        sim.reset()
        assert sim.time == 0.0
        assert not sim.data.plugin_state.any()
        assert not sim.skin().displacement.any()
    assert seen[0] == seen[1] == seen[2]


def test_recompile_goes_on_from_rest(small_scene):
    spec = mujoco.MjSpec.from_file(str(small_scene()))
    model = spec.compile()
    data = stepped(model, moving(model), 4)
    haptic = world_of(data).scene.model
    expected = numbers(stepped(model, moving(model), 4))
    model, data = spec.recompile(model, data)
    assert world_of(data).scene.model is haptic  # nothing was factorised again
    mujoco.mj_resetData(model, data)
    data.qvel[0] = SPEED
    assert numbers(stepped(model, data, 4)) == expected


# -- threads, models and processes ---------------------------------------------------------------------------------


def test_rollout_on_8_threads_equals_single_runs(model):
    count, steps = 8, 5
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    starts = np.zeros((count, mujoco.mj_stateSize(model, kind)))
    for row in range(count):
        data = moving(model, 1.0 * row)
        mujoco.mj_getState(model, data, starts[row], kind)
    with mujoco.rollout.Rollout(nthread=8) as pool:
        found, sensors = pool.rollout(model, [mujoco.MjData(model) for _ in range(count)], starts, nstep=steps)
    for row in range(count):
        data = stepped(model, moving(model, 1.0 * row), steps)
        expected = np.empty(starts.shape[1])
        mujoco.mj_getState(model, data, expected, kind)
        np.testing.assert_array_equal(found[row, -1], expected)
        np.testing.assert_array_equal(sensors[row, -1], data.sensordata)
    assert len(np.unique(sensors[:, -1], axis=0)) == count


def test_two_models_at_once_go_their_own_ways(small_scene):
    models, alone = [], []
    for changes in ({}, {"skin": {"material": "gelatin_2"}}, {"stimulus": CIRCLE}):
        models.append(mujoco.MjModel.from_xml_path(str(small_scene(**changes))))
        alone.append(numbers(stepped(models[-1], moving(models[-1]), 5)))
    together = [moving(model) for model in models]
    for _ in range(5):
        for model, data in zip(models, together, strict=True):
            mujoco.mj_step(model, data)
    assert [numbers(data) for data in together] == alone
    assert len({each["plugin_state"] for each in alone}) == 3
    threaded = [moving(model) for model in models]
    threads = [
        threading.Thread(target=mujoco.mj_step, args=(model, data, 5))
        for model, data in zip(models, threaded, strict=True)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [numbers(data) for data in threaded] == alone


def test_a_forked_child_goes_on_as_its_parent(model, many_threads):
    data = stepped(model, moving(model), 5)
    assert many_threads(data) > 1
    reading, writing = os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # Python 3.12: this process has threads
        child = os.fork()
    if child == 0:
        code = 1
        try:
            os.close(reading)
            with os.fdopen(writing, "wb") as pipe:
                pickle.dump(numbers(stepped(model, data, 5)), pipe)
            code = 0
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(code)
    os.close(writing)
    stepped(model, data, 5)
    with os.fdopen(reading, "rb") as pipe:
        sent = pipe.read()
    _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) == 0
    assert pickle.loads(sent) == numbers(data)


# -- a state that another wrote ------------------------------------------------------------------------------------

FOREIGN = "plugin 'palmfield.{}' instance '{}': the state in mjData comes from another solver"


def refused(model, data, plugin="skin", instance="skin"):
    """Stepping says whose state it can't go on from, by NaN and by raise_errors."""
    sentence = FOREIGN.format(plugin, instance)
    mujoco.mj_step(model, data)
    mujoco.mj_step(model, data)  # its sensors belong to the beginning of a step
    with pytest.raises(palmfield.SceneError) as caught:
        palmfield.raise_errors(data)
    assert str(caught.value) == states._foreign(f"plugin 'palmfield.{plugin}' instance '{instance}'")
    assert str(caught.value).startswith(sentence)
    assert np.isnan(data.sensordata).any()
    mujoco.mj_resetData(model, data)
    stepped(model, data, 2)
    assert np.isfinite(data.sensordata).all()


@pytest.mark.parametrize(
    ("wrote", "reads"), [("wedges", "reduced"), ("reduced", "wedges")], ids=["whole to small", "small to whole"]
)
def test_a_state_of_another_solver_is_refused(small_scene, wrote, reads):
    first = mujoco.MjModel.from_xml_path(str(small_scene(skin={"solver": wrote})))
    vector = full_state(first, stepped(first, mujoco.MjData(first), 3))
    second = mujoco.MjModel.from_xml_path(str(small_scene(skin={"solver": reads})))
    assert second.npluginstate == first.npluginstate
    data = mujoco.MjData(second)
    set_state(second, data, vector)
    refused(second, data)


def test_a_state_of_another_scene_is_refused(small_scene):
    first = mujoco.MjModel.from_xml_path(str(small_scene(skin={"material": "hitohada_c7"})))
    vector = full_state(first, stepped(first, mujoco.MjData(first), 3))
    second = mujoco.MjModel.from_xml_path(str(small_scene(skin={"material": "hitohada_c0"})))
    assert second.npluginstate == first.npluginstate
    data = mujoco.MjData(second)
    set_state(second, data, vector)
    refused(second, data)
    set_state(first, data := mujoco.MjData(first), vector)
    stepped(first, data, 1)


def test_a_state_of_another_basis_is_refused(small_scene):
    alike = {"solver": "reduced", "element_m": 0.01}  # so coarse that the mesh doesn't follow the focus
    first = mujoco.MjModel.from_xml_path(str(small_scene(skin=alike)))
    vector = full_state(first, stepped(first, mujoco.MjData(first), 3))
    second = mujoco.MjModel.from_xml_path(str(small_scene(skin=alike, stimulus={"focus_m": "0.006 0.003 0.12"})))
    assert second.npluginstate == first.npluginstate
    data = mujoco.MjData(second)
    set_state(second, data, vector)
    refused(second, data)


def test_a_state_of_another_array_is_refused(small_scene):
    first = mujoco.MjModel.from_xml_path(str(small_scene()))
    vector = full_state(first, stepped(first, mujoco.MjData(first), 3))
    second = mujoco.MjModel.from_xml_path(str(small_scene(array={"response": "off"})))
    data = mujoco.MjData(second)
    set_state(second, data, vector)
    refused(second, data, "array", "array")


@pytest.mark.parametrize(("of", "now"), [("VERSION", states.VERSION + 1), ("version", lambda name: "0.0.1")])
def test_a_state_of_another_version_is_refused(model, monkeypatch, of, now):
    data = stepped(model, mujoco.MjData(model), 3)
    vector = full_state(model, data)
    marks = world_of(data).scene.model.marks
    monkeypatch.setattr(states, of, now)
    marks.clear()
    try:
        later = mujoco.MjData(model)
        set_state(model, later, vector)
        refused(model, later)
        # And an array's, where the skin's is nobody's.
        set_state(model, later, vector)
        later.plugin_state[parts(model)["skin"]] = 0.0
        refused(model, later, "array", "array")
    finally:
        marks.clear()  # the model outlives this test


def test_numbers_that_nobody_wrote_are_refused(model):
    data = mujoco.MjData(model)
    data.plugin_state[-1] = 1e-6
    refused(model, data)


def test_a_simulation_raises_the_refusal(model):
    sim = palmfield.Simulation(model)
    sim.step(2)
    sim.data.plugin_state[parts(model)["skin"].start + 1] += 1.0
    with pytest.raises(palmfield.SceneError, match="instance 'skin': the state in mjData comes from another"):
        sim.step()
    with pytest.raises(palmfield.SceneError, match="start from mj_resetData"):
        _ = sim.skin().displacement
    sim.reset()
    sim.step(2)
