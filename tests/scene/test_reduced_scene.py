"""The small model of the skin inside MuJoCo: same motion, whole state, and what happens where it can't go on."""

import copy

import mujoco
import numpy as np
import pytest

import palmfield
from palmfield.engine.host import raise_errors
from palmfield.foresight import MOST_TURNS, refusal
from palmfield.skin.reduction import stepping
from palmfield.skin.reduction.stepping import FullSkin, ReducedSkin

JOINT = '<joint name="slide" type="slide" axis="1 0 0" stiffness="400" damping="10"/>'
STEADY = {"modulation": "none", "am_of": None, "am_frequency_Hz": None, "am_depth": None}
CIRCLE = STEADY | {"path": "circle", "path_diameter_m": 0.01, "path_rate_Hz": 140, "stop_s": 0.011}
SKIN = {"step_s": 0.00005, "solver": "reduced"}


def fixed(path, place="", position="0 0 0.12"):
    """The scene with its pad nailed down."""
    plain = path.parent / "plain.xml"
    text = plain.read_text().replace(JOINT, "").replace('<body name="pad" pos="0 0 0.12"', f'<body name="pad"{place}')
    plain.write_text(text.replace('<body name="pad"', f'<body name="pad" pos="{position}"'))
    return path


def run(path, steps=15, change=lambda scene, step: None):
    """Normal displacement and velocity of the surface after every step of the skin, and the scene."""
    scene = palmfield.load(path)
    chain, seen = scene.skin.chain, []
    chain.observer = lambda t, motion, *rest: seen.append(motion.copy())
    for step in range(steps):
        change(scene, step)
        mujoco.mj_step(scene.model, scene.data)
        raise_errors(scene.data)
    return np.array(seen), scene


def relative(a, b):
    return np.linalg.norm(a - b) / np.linalg.norm(b)


CASES = {
    "am": {"array": {"response": "off"}},
    "am, ringing": {"array": {"response": "on"}},
    "circle": {"stimulus": CIRCLE, "array": {"response": "off"}},
    "circle, ringing": {"stimulus": CIRCLE, "array": {"response": "on"}},
    "circle of points": {"stimulus": CIRCLE | {"path_points": 6}, "array": {"response": "on"}},
    "shadows": {"skin": {"body_sound": "shadows"}, "array": {"response": "off"}},
}


@pytest.mark.parametrize("changes", CASES.values(), ids=CASES)
def test_motion_is_the_whole_layers(small_scene, changes):
    """To the two solvers' own errors: (w h)^2 / 10 of the whole layer's step is 0.6 % at 400 Hz, and the reduction."""
    keys = {name: dict(values) for name, values in changes.items()}
    small, scene = run(fixed(small_scene(**keys | {"skin": SKIN | keys.get("skin", {})})))
    full, _ = run(fixed(small_scene(**keys | {"skin": SKIN | keys.get("skin", {}) | {"solver": "wedges"}})))
    skin = scene.skin.chain.skin.begin
    error = relative(small[:, 0], full[:, 0])
    print(scene.skin.rig.system.ndof, skin.model.order, "estimate", skin.error, "difference", error)
    assert isinstance(skin, ReducedSkin)
    assert skin.error <= 0.1 * scene.skin.rig.skin.accuracy
    assert error < 0.01 + skin.error
    assert not scene.skin.world.state(scene.skin.instance)[scene.skin.rig.skin_room]


@pytest.fixture
def model(small_scene):
    return mujoco.MjModel.from_xml_path(str(fixed(small_scene(skin=SKIN, array={"response": "off"}))))


def stepped(model, count):
    data = mujoco.MjData(model)
    for _ in range(count):
        mujoco.mj_step(model, data)
    raise_errors(data)
    return data


def test_state_is_saved_copied_and_reset(model):
    data = stepped(model, 3)
    assert 0 < np.count_nonzero(data.plugin_state) < 400
    twin = copy.copy(data)
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    state = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)
    mujoco.mj_step(model, data)
    mujoco.mj_step(model, twin)
    np.testing.assert_array_equal(twin.plugin_state, data.plugin_state)
    after = data.plugin_state.copy()
    mujoco.mj_setState(model, data, state, kind)
    mujoco.mj_step(model, data)
    np.testing.assert_array_equal(data.plugin_state, after)
    mujoco.mj_resetData(model, data)
    assert not data.plugin_state.any()
    for _ in range(4):
        mujoco.mj_step(model, data)
    np.testing.assert_array_equal(data.plugin_state, after)
    np.testing.assert_array_equal(data.plugin_state, stepped(model, 4).plugin_state)


def shift(scene, step):
    if step >= 5:
        scene.data.mocap_pos[0, 1] = 1e-4 * (step - 4)


def test_a_body_that_moves_goes_on_with_the_whole_layer(small_scene):
    def path(solver):
        return fixed(small_scene(skin=SKIN | {"solver": solver}, array={"response": "off"}), ' mocap="true"')

    still, _ = run(path("wedges"), 5)
    with pytest.raises(palmfield.SceneError, match=r"palmfield\.skin.*'solver'.*'reduced'.*moved"):
        run(path("reduced"), 8, shift)
    scene = palmfield.load(path("reduced"))
    text = scene.path.read_text().replace('"reduced"', '"auto"').replace('data="0.015"', 'data="10"')
    scene.path.write_text(text)
    moved, scene = run(scene.path, 15, shift)
    assert scene.skin.world.state(scene.skin.instance)[scene.skin.rig.skin_room] == 1.0
    full, _ = run(path("wedges"), 15, shift)
    assert relative(moved[:, 0], full[:, 0]) < 0.015
    assert relative(moved[: len(still), 0], still[:, 0]) < 0.015


def test_what_moves_less_than_matters_stays_small(small_scene):
    path = small_scene(skin=SKIN, stimulus=STEADY)

    def slowly(scene, step):
        if step == 0:
            scene.data.qvel[:] = 5e-3

    seen, scene = run(path, change=slowly)
    assert 1e-6 < np.abs(scene.data.qpos).max() < scene.skin.chain.skin.limit_m
    assert not scene.skin.world.state(scene.skin.instance)[scene.skin.rig.skin_room]
    full, _ = run(small_scene(skin=SKIN | {"solver": "wedges"}, stimulus=STEADY), change=slowly)
    assert relative(seen[:, 0], full[:, 0]) < 0.015


def test_a_path_met_half_way_is_not_for_the_small_model(small_scene):
    path = fixed(small_scene(skin=SKIN, stimulus=CIRCLE, array={"response": "off"}))

    def later(scene, step):
        if step == 0:
            scene.data.time = 0.004

    with pytest.raises(palmfield.SceneError, match="begins at rest"):
        run(path, 1, later)
    _, scene = run(fixed(small_scene(skin=SKIN, array={"response": "off"})), 1, later)
    assert not scene.skin.world.state(scene.skin.instance)[scene.skin.rig.skin_room]


@pytest.mark.parametrize(
    ("stimulus", "reason"),
    [
        ({"drive_amplitude": 0}, "silent"),
        (CIRCLE | {"control_rate_Hz": 1000}, "control_rate_Hz"),
        ({"path": "circle", "path_diameter_m": 0.01, "path_rate_Hz": 141}, f"more than {MOST_TURNS} turns"),
        (CIRCLE | {"path_rate_Hz": 0.5}, "comes round after 2 s only"),
    ],
)
def test_a_load_without_a_small_model_is_refused_by_name(small_scene, stimulus, reason):
    with pytest.raises(palmfield.SceneError, match=f"palmfield.skin.*'solver' has value 'reduced'.*{reason}"):
        palmfield.load(small_scene(stimulus=stimulus, skin=SKIN))
    scene = palmfield.load(small_scene(stimulus=stimulus, skin=SKIN | {"solver": "auto"}))
    assert scene.skin.rig.choice.name == "wedges" and reason in scene.skin.rig.choice.why
    assert isinstance(scene.skin.chain.skin.begin, FullSkin)


def test_modulation_that_comes_round_with_the_path_is_taken(small_scene):
    path = {"path": "circle", "path_diameter_m": 0.01, "path_rate_Hz": 80}
    assert refusal(palmfield.load(small_scene(stimulus=path, skin=SKIN)).skin.rig) is None


def test_auto_weighs_making_against_stepping(small_scene):
    def chosen(duration):
        path = fixed(small_scene(skin=SKIN | {"solver": "auto"}))
        path.write_text(path.read_text().replace('data="0.015"', f'data="{duration}"'))
        return palmfield.load(path)

    short, long = chosen(0.002), chosen(1.0)
    assert (short.skin.rig.choice.name, long.skin.rig.choice.name) == ("wedges", "reduced")
    assert isinstance(short.skin.chain.skin.begin, FullSkin)
    assert long.skin.rig.choice.reduced_s < long.skin.rig.choice.full_s
    said = {row.what: row for row in palmfield.plan(long).modelled}
    assert "full about" in said["skin solver reduced"].size and "whole layer goes on" in said["skin solver reduced"].why
    assert "skin solver full" in {row.what for row in palmfield.plan(short).modelled}
    assert palmfield.plan(chosen(1.0)).seconds > palmfield.plan(chosen(0.002)).seconds


def test_a_model_that_grows_too_large_is_left(small_scene, monkeypatch):
    monkeypatch.setattr(stepping, "MOST_VECTORS", 8)
    path = fixed(small_scene(skin=SKIN | {"accuracy": 0.049}))
    with pytest.raises(palmfield.SceneError, match="vectors"):
        _ = palmfield.load(path).skin.chain.skin.begin
    path.write_text(path.read_text().replace('"reduced"', '"auto"').replace('data="0.015"', 'data="10"'))
    scene = palmfield.load(path)
    assert scene.skin.rig.choice.name == "reduced"
    assert isinstance(scene.skin.chain.skin.begin, FullSkin)


def test_the_reduction_is_in_the_error_budget(small_scene, tmp_path):
    result = palmfield.run(palmfield.load(fixed(small_scene(skin=SKIN))), tmp_path / "out", progress=False)
    found = result.summary
    assert 0.0 < found["reduction_error_relative"] <= 0.006
    assert found["displacement_error_relative"] > found["reduction_error_relative"]
    # A sine sampled at steps of h keeps sinc(f h)^2 of itself between straight lines.
    assert found["step_error_relative"] == pytest.approx((2 * np.pi * 200 * 5e-5) ** 2 / 12, rel=0.01)
    assert found["skin_solver"].startswith("reduced, ")
