"""The modules inside plain MuJoCo: no runner of palmfield's takes part."""

import copy
import pickle
import subprocess
import sys
import threading
from pathlib import Path

import mujoco
import numpy as np
import pytest
from unestimated import UNESTIMATED

import palmfield
from palmfield.engine.host import raise_errors, world_of

PALM = Path(__file__).parents[2] / "mjcf" / "scenes" / "palm_am200.xml"


def stepped(model, count, change=None):
    data = mujoco.MjData(model)
    if change is not None:
        change(data)
    for _ in range(count):
        mujoco.mj_step(model, data)
    raise_errors(data)
    return data


STEADY = {"modulation": "none", "am_quantity": None, "am_frequency_Hz": None, "am_depth": None}


@pytest.fixture
def model(small_scene):
    return mujoco.MjModel.from_xml_path(str(small_scene()))


def test_sensor_reads_force_and_motion(small_scene):
    data = stepped(mujoco.MjModel.from_xml_path(str(small_scene(stimulus=STEADY))), 5)
    force, displacement, arp = data.sensordata[2], data.sensordata[3], data.sensordata[5]
    assert force > 0  # the array below pushes the pad up
    assert displacement < 0  # and dents it
    assert 0 < arp < 200


def test_force_reaches_the_joints(small_scene):
    tilted = small_scene(stimulus=STEADY)
    text = (tilted.parent / "plain.xml").read_text()
    (tilted.parent / "plain.xml").write_text(text.replace('axis="1 0 0"', 'axis="0 0 -1"').replace('gravcomp="1"', ""))
    model = mujoco.MjModel.from_xml_path(str(tilted))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    # The joint's axis is the body's -z; the body is upside down, so this is the world's +z.
    assert data.qfrc_passive[0] == pytest.approx(data.sensordata[2], rel=1e-12)
    assert data.qfrc_passive[0] > 1e-4


def test_moving_the_body_changes_force_and_displacement(model):
    still = stepped(model, 5)
    moved = stepped(model, 5, lambda data: data.qpos.__setitem__(0, 0.02))
    assert abs(moved.sensordata[2] / still.sensordata[2] - 1) > 0.05
    assert abs(moved.sensordata[3] / still.sensordata[3] - 1) > 0.05


def test_reset_starts_again_from_rest(model):
    data = stepped(model, 5)
    first = data.sensordata.copy()
    mujoco.mj_resetData(model, data)
    assert not data.plugin_state.any()
    for _ in range(5):
        mujoco.mj_step(model, data)
    np.testing.assert_array_equal(data.sensordata, first)


def test_a_copy_goes_on_by_itself(model):
    data = stepped(model, 3)
    twin = copy.copy(data)
    for _ in range(2):
        mujoco.mj_step(model, twin)
    assert data.time < twin.time
    for _ in range(2):
        mujoco.mj_step(model, data)
    np.testing.assert_array_equal(data.sensordata, twin.sensordata)
    np.testing.assert_array_equal(data.plugin_state, twin.plugin_state)


def test_pickled_data_goes_on(model):
    data = stepped(model, 3)
    twin = pickle.loads(pickle.dumps(data))
    mujoco.mj_step(model, data)
    mujoco.mj_step(model, twin) if not hasattr(twin, "model") else mujoco.mj_step(twin.model, twin)
    np.testing.assert_array_equal(data.plugin_state, twin.plugin_state)


def test_state_can_be_saved_and_set_back(model):
    data = stepped(model, 3)
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    state = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)
    mujoco.mj_step(model, data)
    mujoco.mj_setState(model, data, state, kind)
    mujoco.mj_step(model, data)
    np.testing.assert_array_equal(data.plugin_state, stepped(model, 4).plugin_state)


def test_another_timestep_after_loading_is_refused(model):
    data = stepped(model, 2)
    model.opt.timestep = 0.002
    mujoco.mj_step(model, data)
    with pytest.raises(palmfield.SceneError, match=r"'timestep' has value 0.002, but was 0.001 when the scene was"):
        raise_errors(data)


def test_two_models_at_once(small_scene):
    strong = mujoco.MjModel.from_xml_path(str(small_scene()))
    weak = mujoco.MjModel.from_xml_path(str(small_scene(stimulus={"drive_amplitude": 0.5})))
    one, two = mujoco.MjData(strong), mujoco.MjData(weak)
    for _ in range(4):
        mujoco.mj_step(strong, one)
        mujoco.mj_step(weak, two)
    # Half the pressure is a quarter of the radiation pressure, and the skin is linear.
    assert two.sensordata[3] == pytest.approx(one.sensordata[3] / 4, rel=1e-5)


def test_threads_give_the_same_numbers(model):
    expected = stepped(model, 4).sensordata.copy()
    results: list[np.ndarray] = []

    def work():
        results.append(stepped(model, 4).sensordata.copy())

    threads = [threading.Thread(target=work) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(results) == 8
    for result in results:
        np.testing.assert_array_equal(result, expected)


def test_recompile_keeps_working(small_scene):
    spec = mujoco.MjSpec.from_file(str(small_scene()))
    model = spec.compile()
    data = stepped(model, 3)
    before = data.sensordata[3]
    model, data = spec.recompile(model, data)
    mujoco.mj_resetData(model, data)
    for _ in range(3):
        mujoco.mj_step(model, data)
    assert data.sensordata[3] == before


def test_data_is_forgotten_when_freed(model):
    data = stepped(model, 1)
    assert world_of(data) is not None
    address = data._address
    del data
    from palmfield.engine import host

    assert address not in host._worlds


def test_process_exits_cleanly_with_live_data(small_scene):
    code = (
        "import mujoco, sys\n"
        f"m = mujoco.MjModel.from_xml_path({str(small_scene())!r})\n"
        "d = mujoco.MjData(m)\nmujoco.mj_step(m, d, 2)\nprint(d.sensordata[5] > 0)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)
    assert (done.returncode, done.stdout.strip(), done.stderr.strip()) == (0, "True", "")


def test_importing_mujoco_does_not_load_warp():
    code = "import mujoco, sys; print('warp' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.strip() == "False"


def test_an_error_while_stepping_is_kept_and_shown(small_scene, capfd):
    path = small_scene()
    text = (path.parent / "plain.xml").read_text()
    (path.parent / "plain.xml").write_text(text.replace('axis="1 0 0"', 'axis="0 0 1"'))
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    data.qpos[0] = 0.125  # along the body's z, down into the array
    mujoco.mj_step(model, data)
    assert np.isnan(data.sensordata).all()
    with pytest.raises(palmfield.SceneError, match="is too close to the array"):
        raise_errors(data)


@UNESTIMATED
def test_plain_mj_step_equals_palmfield_run():
    """Consistency: after 50 ms of the main example, force and skin displacement agree to 1e-6."""
    scene = palmfield.load(PALM)
    result = palmfield.run(scene, duration_s=0.05, progress=False)
    mujoco.mj_forward(scene.model, scene.data)
    code = (
        "import mujoco\n"
        f"m = mujoco.MjModel.from_xml_path({str(PALM)!r})\n"
        "d = mujoco.MjData(m)\n"
        "while d.time < 0.05 - 1e-9: mujoco.mj_step(m, d)\n"
        "print(*d.sensordata)\n"
        "mujoco.mj_forward(m, d)\nprint(*d.sensordata)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300, check=True)
    before, plain = (np.array([float(x) for x in line.split()]) for line in done.stdout.splitlines())
    assert np.linalg.norm(plain[:3]) > 1e-6 or abs(plain[3]) > 1e-8
    np.testing.assert_allclose(scene.data.sensordata[:5], plain[:5], rtol=1e-6, atol=1e-15)
    ds = result.dataset
    skin = ds["skin/skin"]
    distance = np.linalg.norm(skin["rest_position"].values, axis=1)
    nearest = int(distance.argmin())
    motion = skin["displacement"].values[:, nearest] @ skin["rest_normal"].values[nearest]
    # Without mj_forward the sensor belongs to the last step's beginning, as the file says.
    assert ds["step_time"].values[-1] == pytest.approx(0.049)
    np.testing.assert_allclose(ds["forces/skin"]["force"].values[-1], before[:3], rtol=1e-6)
    # The nearest node of the mesh is not quite the site, and at 50 ms the skin passes through zero.
    assert abs(motion[-1] - plain[3]) < 0.02 * np.abs(motion).max()
