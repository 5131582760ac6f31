"""Modes for every load inside MuJoCo: same motion as the whole layer, errors that are told, and when they end."""

import mujoco
import numpy as np
import pytest
from check_turned import moved, quaternion

from palmfield.engine.host import raise_errors
from palmfield.errors import SceneError
from palmfield.estimate.estimated_run import run
from palmfield.planning.scene_plan import plan
from palmfield.session.simulation import Simulation, load
from palmfield.simulation.small_models.mode_estimate import corner_Hz
from palmfield.simulation.state import BEGUN, WHOLE
from palmfield.skin.reduction.modal_stepper import ModalStepper

STEADY = {"modulation": "none", "am_quantity": None, "am_frequency_Hz": None, "am_depth": None}
LETTER = STEADY | {"path": "circle", "path_diameter_m": 0.01, "path_rate_Hz": 90, "control_rate_Hz": 1000}
SKIN = {"accuracy": 0.2}


def motion(sim, steps=30, push=0.0):
    """Displacement of the surface after each step, (t, S, 3)."""
    seen = []
    for _ in range(steps):
        sim.data.qvel[:] = push
        sim.step()
        seen.append(sim.skin().displacement.copy())
    return np.array(seen)


def velocity_error(path, steps=30):
    """Relative difference of the surface's velocity between modes and the whole layer."""
    seen = []
    for sim in both(path):
        seen.append([])
        for _ in range(steps):
            sim.step()
            seen[-1].append(sim.skin().velocity.copy())
    return relative(*np.array(seen))


def relative(a, b):
    return np.linalg.norm(a - b) / np.linalg.norm(b)


def both(path, **keys):
    return [Simulation(path, keys={"skin.solver": solver, **keys}) for solver in ("modal", "wedges")]


@pytest.mark.parametrize("push", [0.0, 0.4])
def test_a_hand_that_keeps_still_or_moves_moves_its_skin_as_the_whole_layer(small_scene, push):
    modal, wedges = both(small_scene(skin=SKIN))
    mine, truth = motion(modal, push=push), motion(wedges, push=push)
    assert modal.skin().solver == "modal"
    outside = modal.runtime.work.outside[0].energy_share
    assert relative(mine, truth) < np.hypot(modal.runtime.model.begin[0].value.error, outside) < 0.2


def test_skin_of_several_sheets_moves_by_modes(small_scene):
    keys = SKIN | {"material": None, "materials": "finger_pad ecoflex_00-10", "shares": "0.3 0.7"}
    modal, wedges = both(small_scene(stimulus=LETTER, skin=keys))
    mine, truth = motion(modal), motion(wedges)
    modes = modal.runtime.model.begin[0].value
    assert modal.skin().solver == "modal" and modes.coupled
    assert relative(mine, truth) < modal.runtime.work.outside[0].errors(modes.adds_error)[0] < 0.2


def test_sheets_take_modes_by_themselves_where_these_pay(small_scene):
    keys = SKIN | {"material": None, "materials": "finger_pad palm", "shares": "0.3 0.7"}
    names = []
    for duration_s in (0.1, 1000.0):
        path = small_scene(stimulus=LETTER, skin=keys, duration_s=duration_s)
        names.append(load(path).runtime.model.skins[0].choice.name)
    assert names == ["wedges", "modal"]


def test_the_plan_says_where_the_cache_decides_which_solver_is_taken(small_scene, tmp_path, monkeypatch):
    # Of no other test, and each for itself: equal scenes share their model, with its choice
    rows = []
    for folder, accuracy in ((str(tmp_path / "cache"), 0.21), ("off", 0.22)):
        monkeypatch.setenv("PALMFIELD_CACHE", folder)
        scene = small_scene(stimulus=LETTER, skin=SKIN | {"accuracy": accuracy}, duration_s=0.3)
        rows.append(" ".join(str(plan(scene)).replace("│", " ").split()))
    assert "skin solver modal" in rows[0] and "without a cache wedges would be chosen" in rows[0]
    assert "skin solver wedges" in rows[1] and "with a cache modal would be chosen" in rows[1]
    monkeypatch.setenv("PALMFIELD_CACHE", "off")
    asked = str(plan(small_scene(skin=SKIN | {"solver": "modal", "accuracy": 0.23})))
    assert "built once, not stored, because there is no cache" in " ".join(asked.replace("│", " ").split())


FINGER = (
    '<body name="finger" mocap="true" pos="-0.015 0 0.1" quat="0.7071068 0.7071068 0 0">'
    '<geom type="capsule" size="0.005 0.06" contype="0" conaffinity="0"/></body>'
)


def crossed(sim, steps=30, speed=0.8):
    """Displacement of the surface, (t, S, 3), and its velocity, while a finger's shadow goes over the focus."""
    seen = []
    for _ in range(steps):
        sim.data.mocap_pos[0, 0] += speed * sim.model.opt.timestep
        sim.step()
        skin = sim.skin()
        seen.append((skin.displacement.copy(), skin.velocity.copy()))
    return np.moveaxis(np.array(seen), 1, 0)


def test_a_shadow_that_crosses_the_focus_moves_skin_as_on_the_whole_layer(small_scene):
    path = small_scene(stimulus=STEADY, skin=SKIN | {"body_sound": "shadows", "obstacles": "finger"})
    plain = path.parent / "plain.xml"
    plain.write_text(plain.read_text().replace("<worldbody>", "<worldbody>" + FINGER, 1))
    modal, wedges = both(path)
    mine, truth = crossed(modal), crossed(wedges)
    assert modal.skin().solver == "modal"
    # The shadow is there: without the finger the skin would come to rest
    assert np.linalg.norm(truth[0, 15]) < 0.8 * np.linalg.norm(truth[0, 5])
    outside = modal.runtime.work.outside[0].energy_share
    stated = np.hypot(modal.runtime.model.begin[0].value.error, outside)
    assert relative(mine[0], truth[0]) < min(stated, 0.2)


def test_a_control_rate_moves_by_modes(small_scene):
    modal, wedges = both(small_scene(stimulus=LETTER, skin=SKIN))
    assert relative(motion(modal), motion(wedges)) < 0.2


def test_a_run_states_the_modes_error_and_that_covers(small_scene):
    path = small_scene(stimulus=LETTER, skin=SKIN | {"solver": "modal"})
    result = run(path, progress=False)
    (numbers,) = result.summary["skins"]
    wedges = motion(Simulation(path, keys={"skin.solver": "wedges"}))
    assert numbers["solver"].startswith("modal, ") and numbers["solver"].endswith(" modes")
    assert relative(motion(load(path)), wedges) < numbers["reduction_error_relative"] < 0.3
    assert velocity_error(path) < numbers["reduction_velocity_error_relative"] < 0.6


def test_the_plan_says_what_modes_are_for(small_scene):
    text = str(plan(small_scene(skin=SKIN | {"solver": "modal"})))
    assert "skin solver modal" in text and "every sound of these arrays" in " ".join(text.replace("│", " ").split())


def test_another_stimulus_finds_the_modes_in_the_cache(small_scene, tmp_path, monkeypatch):
    monkeypatch.setenv("PALMFIELD_CACHE", str(tmp_path / "cache"))
    # Of no other test: equal scenes share their model, with its modes
    path = small_scene(skin={"accuracy": 0.19, "solver": "modal"})
    motion(load(path), 2)
    monkeypatch.setattr("palmfield.skin.fem.factor.factorise", lambda *arguments: pytest.fail("factorised again"))
    other = Simulation(path, keys={"stimulus.focus_m": (0.001, 0.0, 0.12), "stimulus.drive_amplitude": 0.5})
    assert np.abs(motion(other, 2)).max() > 0.0


def test_copies_and_resets_are_whole(small_scene):
    sim = Simulation(small_scene(skin=SKIN | {"solver": "modal"}))
    first = motion(sim, 4)
    twin = sim.copy()
    np.testing.assert_array_equal(motion(sim, 4), motion(twin, 4))
    sim.reset()
    np.testing.assert_array_equal(motion(sim, 4), first)


def test_a_saved_state_goes_on(small_scene):
    sim = Simulation(small_scene(skin=SKIN | {"solver": "modal"}))
    motion(sim, 4)
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    saved = np.zeros(mujoco.mj_stateSize(sim.model, kind))
    mujoco.mj_getState(sim.model, sim.data, saved, kind)
    then = motion(sim, 3)
    mujoco.mj_setState(sim.model, sim.data, saved, kind)
    mujoco.mj_forward(sim.model, sim.data)
    raise_errors(sim.data)
    np.testing.assert_allclose(motion(sim, 3), then, atol=1e-6 * np.abs(then).max())


def test_loads_outside_the_class_hand_over_to_the_whole_layer(small_scene, monkeypatch):
    """Where the scene may choose; where modes are asked for they go on, and the error tells."""
    monkeypatch.setattr("palmfield.simulation.small_models.known_load.refusal", lambda *arguments: "not for this test")
    monkeypatch.setattr("palmfield.skin.costs.modes_s", lambda *arguments: 0.0)
    monkeypatch.setattr("palmfield.skin.costs.modal_step_s", lambda *arguments: 0.0)
    chosen = Simulation(small_scene(skin=SKIN))
    asked = Simulation(small_scene(skin=SKIN | {"solver": "modal"}))
    for sim in (chosen, asked):
        stepper = sim.runtime.model.begin[0].value
        assert isinstance(stepper, ModalStepper)
        motion(sim, 3)
        assert sim.runtime.state.skins[0][0, 0] == BEGUN
        whole = sim.steps.host._outside
        much = lambda *step, whole=whole: [seen._replace(energy=1e30) for seen in whole(*step)]  # noqa: E731
        monkeypatch.setattr(sim.steps.host, "_outside", much)
        motion(sim, 1)
    assert chosen.runtime.state.skins[0][0, 0] == WHOLE and chosen.skin().solver == "wedges"
    assert asked.runtime.state.skins[0][0, 0] == BEGUN


@pytest.mark.parametrize(
    ("skin", "why"),
    [
        ({"side": "absorbing"}, "absorbing sides couple"),
        ({"body_sound": "scattering"}, "boundary elements for every sample"),
    ],
)
def test_skins_without_modes_are_refused(small_scene, skin, why):
    with pytest.raises(SceneError, match=f"'solver' has value 'modal'.*{why}"):
        load(small_scene(skin=skin | {"solver": "modal"}))


def test_faster_stimuli_have_more_error(small_scene):
    corners = []
    # Once round a circle as wide as the spot is pi widths
    circle = LETTER | {"path_rate_Hz": 190, "control_rate_Hz": 0}
    for keys in (STEADY, {"am_frequency_Hz": 300}, LETTER, circle):
        model = load(small_scene(stimulus=keys)).runtime.model
        corners.append(corner_Hz(model.stimuli[0], 0.01))
    assert corners == pytest.approx([75.0, 150.0, 500.0, 190.0], rel=1e-4)


def test_modes_do_not_depend_on_the_scene_s_turn_and_the_order_of_its_arrays(tmp_path):
    plain, stated = moved(tmp_path, 0.4, steps=8)
    for keys in ({"swapped": True}, {"turn": quaternion((0.6, 0.0, 0.8), 90), "shift": 1e-7}):
        assert relative(moved(tmp_path, 0.4, steps=8, **keys)[0], plain) < 0.1 * stated < 0.04
