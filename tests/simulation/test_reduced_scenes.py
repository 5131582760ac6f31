"""The small model of the skin inside MuJoCo: same motion, whole state, and what happens where it can't go on."""

import copy

import mujoco
import numpy as np
import pytest

from palmfield import cache
from palmfield.engine.host import raise_errors
from palmfield.errors import SceneError
from palmfield.estimate.estimated_run import run
from palmfield.planning.scene_plan import plan
from palmfield.session.simulation import load
from palmfield.simulation.posed_scene import reference_scene
from palmfield.simulation.small_models import known_load
from palmfield.simulation.small_models.known_load import MOST_TURNS, refusal
from palmfield.simulation.state import BEGUN, HEADER, WHOLE
from palmfield.skin.fem.solver import harmonic
from palmfield.skin.fem.wedge_stepper import WedgeStepper
from palmfield.skin.reduction import reduced_stepper
from palmfield.skin.reduction.reduced_stepper import ReducedStepper
from palmfield.stimulus.modulation import arp_lines

JOINT = '<joint name="slide" type="slide" axis="1 0 0" stiffness="400" damping="10"/>'
STEADY = {"modulation": "none", "am_quantity": None, "am_frequency_Hz": None, "am_depth": None}
CIRCLE = STEADY | {"path": "circle", "path_diameter_m": 0.01, "path_rate_Hz": 140, "stop_s": 0.011}
SKIN = {"step_s": 0.00005, "solver": "reduced"}


def fixed(path, place="", position="0 0 0.12"):
    """The scene with its pad nailed down."""
    plain = path.parent / "plain.xml"
    text = plain.read_text().replace(JOINT, "").replace('<body name="pad" pos="0 0 0.12"', f'<body name="pad"{place}')
    plain.write_text(text.replace('<body name="pad"', f'<body name="pad" pos="{position}"'))
    return path


def watched(path, steps=15, change=lambda sim, step: None):
    """Normal displacement and velocity of the surface after every step of the skin, shape (t, 2, S), and the scene."""
    sim = load(path)
    work, seen = sim.runtime.work, []
    work.observe = (sim.runtime.model.skins[0].layer.surface_operator,)
    sim.steps.observer = lambda trace: seen.extend(trace.motion[0][0][1][0].copy())
    for step in range(steps):
        change(sim, step)
        sim.step()
    return np.array(seen), sim


def stepper_of(sim):
    """What the scene's one skin begins with."""
    return sim.runtime.model.begin[0].value


def choice_of(sim):
    return sim.runtime.model.skins[0].choice


def kind_of(sim):
    """Whose numbers the skin's state holds: BEGUN or WHOLE."""
    return sim.runtime.state.skins[0][0, 0]


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


def test_the_whole_layer_is_not_factorised_while_a_small_model_steps(small_scene):
    sim = load(fixed(small_scene(skin=SKIN)))
    sim.step(3)
    sim.copy().step()
    assert sim.skin().solver == "reduced" and not sim.runtime.model.whole[0].made


@pytest.mark.parametrize("changes", CASES.values(), ids=CASES)
def test_motion_is_the_whole_layers(small_scene, changes):
    """To the two solvers' own errors: (w h)^2 / 10 of the whole layer's step is 0.6 % at 400 Hz, and the reduction."""
    keys = {name: dict(values) for name, values in changes.items()}
    small, sim = watched(fixed(small_scene(**keys | {"skin": SKIN | keys.get("skin", {})})))
    whole, _ = watched(fixed(small_scene(**keys | {"skin": SKIN | keys.get("skin", {}) | {"solver": "wedges"}})))
    skin, stepper = sim.runtime.model.skins[0], stepper_of(sim)
    error = relative(small[:, 0], whole[:, 0])
    print(skin.layer.system.ndof, stepper.order, "estimate", stepper.error, "difference", error)
    assert isinstance(stepper, ReducedStepper)
    assert stepper.error <= 0.1 * skin.spec.config.accuracy
    assert error < 0.01 + stepper.error
    assert kind_of(sim) == BEGUN and sim.skin().solver == "reduced"


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
    # Headers of the array and of the skin, and a small model's numbers
    assert 0 < np.count_nonzero(data.plugin_state) < 400 + 2 * HEADER
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
    raise_errors(data)
    np.testing.assert_array_equal(data.plugin_state, after)
    np.testing.assert_array_equal(data.plugin_state, stepped(model, 4).plugin_state)


def shift(sim, step):
    if step >= 5:
        sim.data.mocap_pos[0, 1] = 1e-4 * (step - 4)


def test_a_body_that_moves_goes_on_with_the_whole_layer(small_scene):
    def path(solver, **scene):
        return fixed(small_scene(skin=SKIN | {"solver": solver}, array={"response": "off"}, **scene), ' mocap="true"')

    still, _ = watched(path("wedges"), 5)
    with pytest.raises(
        SceneError, match=r"palmfield\.skin' instance 'skin'.*'solver'.*'reduced'.*moved.*set solver to auto"
    ):
        watched(path("reduced"), 8, shift)
    moved, sim = watched(path("auto", duration_s=10), 15, shift)
    assert choice_of(sim).name == "reduced"
    assert kind_of(sim) == WHOLE and sim.skin().solver == "wedges"
    whole, _ = watched(path("wedges"), 15, shift)
    assert relative(moved[:, 0], whole[:, 0]) < 0.015
    assert relative(moved[: len(still), 0], still[:, 0]) < 0.015


def test_what_moves_less_than_matters_stays_small(small_scene):
    path = small_scene(skin=SKIN, stimulus=STEADY)

    def slowly(sim, step):
        if step == 0:
            sim.data.qvel[:] = 5e-3

    seen, sim = watched(path, change=slowly)
    assert 1e-6 < np.abs(sim.data.qpos).max() < sim.runtime.model.skins[0].still_m
    assert kind_of(sim) == BEGUN and sim.skin().solver == "reduced"
    whole, _ = watched(small_scene(skin=SKIN | {"solver": "wedges"}, stimulus=STEADY), change=slowly)
    assert relative(seen[:, 0], whole[:, 0]) < 0.015


def test_a_path_met_half_way_is_not_for_the_small_model(small_scene):
    path = fixed(small_scene(skin=SKIN, stimulus=CIRCLE, array={"response": "off"}))

    def later(sim, step):
        if step == 0:
            sim.data.time = 0.004

    with pytest.raises(SceneError, match="begins at rest"):
        watched(path, 1, later)
    _, sim = watched(fixed(small_scene(skin=SKIN, array={"response": "off"})), 1, later)
    assert kind_of(sim) == BEGUN and sim.skin().solver == "reduced"


@pytest.mark.parametrize(
    ("stimulus", "reason"),
    [
        ({"drive_amplitude": 0}, "silent"),
        (CIRCLE | {"control_rate_Hz": 1000}, "control_rate_Hz"),
        ({"path": "circle", "path_diameter_m": 0.01, "path_rate_Hz": 141}, f"more than {MOST_TURNS} turns"),
        (CIRCLE | {"path_rate_Hz": 0.5}, "repeats only after 2 s"),
    ],
)
def test_a_load_without_a_small_model_is_refused_by_name(small_scene, stimulus, reason):
    refused = f"palmfield.skin' instance 'skin': key 'solver' has value 'reduced'.*{reason}.*set it to auto"
    with pytest.raises(SceneError, match=refused):
        load(small_scene(stimulus=stimulus, skin=SKIN))
    sim = load(small_scene(stimulus=stimulus, skin=SKIN | {"solver": "auto"}))
    assert choice_of(sim).name == "wedges" and reason in choice_of(sim).why
    assert isinstance(stepper_of(sim), WedgeStepper)


def test_modulation_that_comes_round_with_the_path_is_taken(small_scene):
    path = {"path": "circle", "path_diameter_m": 0.01, "path_rate_Hz": 80}
    model = load(small_scene(stimulus=path, skin=SKIN)).runtime.model
    skin = model.skins[0]
    assert refusal(skin.spec, skin.layer, model.stimuli) is None


def test_auto_weighs_making_against_stepping(small_scene):
    def chosen(duration_s):
        return load(fixed(small_scene(skin=SKIN | {"solver": "auto"}, duration_s=duration_s)))

    short, long = chosen(0.002), chosen(1.0)
    assert (choice_of(short).name, choice_of(long).name) == ("wedges", "reduced")
    assert isinstance(stepper_of(short), WedgeStepper)
    assert choice_of(long).seconds < choice_of(long).wedges_s
    said = {row.what: row for row in plan(long).modelled}
    assert "wedges about" in said["skin solver reduced"].size
    assert "full wedge model takes over" in said["skin solver reduced"].why
    assert "skin solver wedges" in {row.what for row in plan(short).modelled}
    assert plan(chosen(1.0)).seconds > plan(chosen(0.002)).seconds


def test_a_model_that_grows_too_large_is_left(small_scene, monkeypatch):
    monkeypatch.setattr(reduced_stepper, "MOST_VECTORS", 8)

    def scene(solver, **more):
        return load(fixed(small_scene(skin=SKIN | {"accuracy": 0.049, "solver": solver}, **more)))

    with pytest.raises(SceneError, match="vectors"):
        stepper_of(scene("reduced"))
    sim = scene("auto", duration_s=10)
    assert choice_of(sim).name == "reduced"
    assert isinstance(stepper_of(sim), WedgeStepper)


def test_the_reduction_is_in_the_error_budget(small_scene):
    result = run(load(fixed(small_scene(skin=SKIN))), progress=False)
    found = result.summary["skins"][0]
    assert 0.0 < found["reduction_error_relative"] <= 0.006
    assert found["displacement_error_relative"] > found["reduction_error_relative"]
    # A sine sampled at steps of h keeps sinc(f h)^2 of itself between straight lines.
    assert found["step_error_relative"] == pytest.approx((2 * np.pi * 200 * 5e-5) ** 2 / 12, rel=0.01)
    assert found["solver"].startswith("reduced, ")


def test_one_small_model_serves_a_load_at_any_level(small_scene, tmp_path, monkeypatch):
    """The cache has one model for three levels, and another one for another focus."""
    monkeypatch.setenv("PALMFIELD_CACHE", str(tmp_path / "cache"))

    def made(**keys):
        assert stepper_of(load(fixed(small_scene(stimulus=keys, skin=SKIN)))).name == "reduced"
        return sum(entry.kind == "small-model" for entry in cache.entries())

    assert [made(drive_amplitude=level) for level in (1.0, 0.7, 0.123)] == [1, 1, 1]
    assert made(drive_amplitude=0.7, focus_m="0.002 0 0.12") == 2


def test_the_error_holds_at_every_frequency_of_the_band(small_scene):
    """Modulated motion of lightly damped gelatin, displacement and velocity, in the model of 200 Hz."""
    sim = load(small_scene(skin=SKIN | {"material": "gelatin_2", "accuracy": 0.2}, array={"response": "off"}))
    model, small = sim.runtime.model, stepper_of(sim)
    layer, lines = model.skins[0].layer, arp_lines(model.stimuli[0].config)
    pressure = known_load.known_load(model, 0, reference_scene(model))[1][0].astype(float)
    force, read = layer.quadrature.operator @ pressure, layer.surface_operator
    shares = np.array([[lines.first], [lines.second]])
    for f_Hz in (23.0, 61.0, 97.0, 143.0, 187.0):
        whole = shares * [read @ harmonic(layer.system, force, n * f_Hz) for n in (1, 2)]
        mine = shares * [small.harmonic(pressure[small.points], n * f_Hz, read) for n in (1, 2)]
        rates = np.array([[1.0], [2.0]])
        print(f_Hz, small.error, relative(mine, whole), relative(rates * mine, rates * whole))
        assert max(relative(mine, whole), relative(rates * mine, rates * whole)) < small.error


def test_all_frequencies_of_a_band_share_a_small_model(small_scene, tmp_path, monkeypatch):
    monkeypatch.setenv("PALMFIELD_CACHE", str(tmp_path / "cache"))
    for f_Hz in (200, 187, 163.7):
        stepper_of(load(fixed(small_scene(stimulus={"am_frequency_Hz": f_Hz}, skin=SKIN))))
    assert sum(entry.kind == "small-model" for entry in cache.entries()) == 1


def test_a_run_from_the_cache_does_not_compute_its_load(small_scene, tmp_path, monkeypatch):
    monkeypatch.setenv("PALMFIELD_CACHE", str(tmp_path / "cache"))
    path = fixed(small_scene(stimulus=CIRCLE, skin=SKIN))

    def made():
        # Equal specs share a model, and what has been made of it
        monkeypatch.setattr("palmfield.simulation.build._models", [])
        return stepper_of(load(path))

    computed = known_load.known_load
    first = made()
    monkeypatch.setattr(known_load, "known_load", lambda *arguments: pytest.fail("the load is computed again"))
    second = made()
    for name in ("vectors", "shares", "points", "error", "any_course"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    # Room was needed: what its name leads to has gone
    (kept,) = (entry for entry in cache.entries() if entry.kind == "small-model")
    kept.path.unlink()
    monkeypatch.setattr(known_load, "known_load", computed)
    np.testing.assert_array_equal(made().vectors, first.vectors)


def test_a_pose_that_a_small_model_left_is_left_again(small_scene):
    """After a reset too, where MuJoCo's own reset was called and the pose is the same as before."""
    sim = load(small_scene(array={"response": "off"}, skin=SKIN | {"solver": "auto"}, duration_s=5.0))
    ends = []
    for _ in range(2):
        kinds = set()
        for _ in range(6):
            sim.data.qpos[:], sim.data.qvel[:] = 0.003, 0.0
            mujoco.mj_step(sim.model, sim.data)
            kinds.add(kind_of(sim))
        assert kinds == {WHOLE}
        ends.append(sim.skin().displacement.copy())
        mujoco.mj_resetData(sim.model, sim.data)
    np.testing.assert_allclose(ends[1], ends[0], rtol=1e-9, atol=1e-15)
