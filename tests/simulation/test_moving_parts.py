"""What moves without a script is seen by every solver, and what cannot be followed is refused."""

import mujoco
import numpy as np
import pytest

from palmfield.data import folder
from palmfield.engine.host import raise_errors
from palmfield.engine.motion_plugin import place
from palmfield.errors import DeviceError, SceneError
from palmfield.session.simulation import load
from palmfield.simulation.validate import check_clear

SCENES = folder("mjcf") / "scenes"
STEADY = {"modulation": "none", "am_quantity": None, "am_frequency_Hz": None, "am_depth": None}
NO_AM = {"stimulus.am_quantity": None, "stimulus.am_frequency_Hz": None, "stimulus.am_depth": None}
BALL = (
    '<body name="ball" mocap="true" pos="{place}"><geom type="sphere" size="0.03" contype="0" conaffinity="0"/></body>'
)


def with_ball(small_scene, where, **skin):
    path = small_scene(stimulus=STEADY, skin={"body_sound": "shadows", "obstacles": "ball"} | skin)
    plain = path.parent / "plain.xml"
    plain.write_text(plain.read_text().replace("<worldbody>", "<worldbody>" + BALL.format(place=where), 1))
    return load(path)


def felt(sim, steps=3):
    sim.step(steps)
    return sim.data.sensordata.copy()


@pytest.mark.parametrize("solver", ["auto", "wedges"])
def test_an_obstacle_that_comes_between_takes_the_sound(small_scene, solver):
    scene = with_ball(small_scene, "0.3 0 0.06", solver=solver)
    free = felt(scene)
    scene.data.mocap_pos[0] = [0.0, 0.0, 0.06]
    # The board's corners look past the ball
    assert free[5] > 1.0 and abs(felt(scene)[5]) < 0.2 * free[5]
    scene.data.mocap_pos[0] = [0.3, 0.0, 0.06]
    assert felt(scene)[5] == pytest.approx(free[5], rel=0.2)


def test_a_ray_leaves_a_point_lit_or_dark(small_scene):
    """While a ball moves out of the way: by rays all or nothing, by edges more and more. The corners look past it."""
    felt_by = {}
    for edges in ("rays", "knife_edge"):
        scene = with_ball(small_scene, "0.3 0 0.06", shadow_edges=edges)
        free = felt(scene)[5]
        felt_by[edges] = []
        for x in (0.0, 0.022, 0.026, 0.03, 0.034, 0.038, 0.15):
            scene.data.mocap_pos[0] = [x, 0.0, 0.06]
            felt_by[edges].append(felt(scene, 1)[5] / free)
    rays, bent = np.array(felt_by["rays"]), np.array(felt_by["knife_edge"])
    assert ((rays == 0.0) | (np.abs(rays - 1.0) < 0.05)).all() and rays[0] == 0.0
    assert bent[0] < 0.2 and ((bent > 0.2) & (bent < 0.9)).sum() >= 3
    assert abs(bent[-1] - rays[-1]) < 0.02


def test_what_stands_behind_the_array_casts_no_shadow(small_scene):
    behind = felt(with_ball(small_scene, "0 0 -0.05"))
    away = felt(with_ball(small_scene, "0.3 0 0.06"))
    assert behind[5] == pytest.approx(away[5], rel=1e-5) and away[5] > 1.0


def test_an_obstacle_in_the_array_is_refused(small_scene):
    with pytest.raises(SceneError, match="one of the obstacles is too close to the array"):
        with_ball(small_scene, "0 0 0.01")


def test_boxes_hold_obstacles_and_spare_their_vertices(small_scene):
    scene = with_ball(small_scene, "0.3 0 0.06")
    scene.data.mocap_quat[0] = [0.8, 0.0, 0.6, 0.0]
    scene.data.mocap_pos[0] = [0.1, 0.02, 0.07]
    mujoco.mj_kinematics(scene.model, scene.data)
    posed = scene.runtime.posed
    (skin,) = posed.skins
    check_clear(posed)
    assert "obstacles" not in vars(skin)
    directions = np.random.default_rng(0).normal(size=(50, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    reach, own = (skin.obstacle_hull @ directions.T).max(axis=0), (skin.obstacles[0] @ directions.T).max(axis=0)
    # A cube round a ball of 30 mm
    assert (reach >= own).all() and (reach - own).max() < 0.03 * (np.sqrt(3.0) - 1.0) + 1e-3


def unscripted(tmp_path, **keys):
    """The articulated hand without a motion module, in its reference pose."""
    text = (SCENES / "approach_withdraw.xml").read_text()
    begin, end = (
        text.index('    <plugin plugin="palmfield.motion">'),
        text.index('    <plugin plugin="palmfield.stimulus">'),
    )
    text = (text[:begin] + text[end:]).replace('file="plain', f'file="{SCENES}/plain')
    (tmp_path / "still.xml").write_text(text)
    return load(tmp_path / "still.xml", device="cpu", keys={"skin.accuracy": 0.5} | keys)


@pytest.mark.parametrize("solver", ["auto", "wedges"])
def test_a_finger_that_bends_by_itself_is_seen(tmp_path, solver):
    """By MuJoCo's own joints, while the patch on the palm keeps still: surface and force are those of the bent hand."""
    data = unscripted(tmp_path).data
    pulp = data.site("index_pad").xpos - data.site("array").xpos
    focus = " ".join(f"{x:.6f}" for x in pulp)
    scene = unscripted(
        tmp_path, **{"skin.solver": solver, "stimulus.focus_m": focus, "stimulus.modulation": None} | NO_AM
    )
    felt(scene, 3)
    before = scene.runtime.body_forces()[0][0].sum(axis=0)
    scene.data.joint("index_mcp_flexion").qpos[0] = np.deg2rad(60.0)
    mujoco.mj_forward(scene.model, scene.data)
    raise_errors(scene.data)
    body = scene.runtime.posed.bodies[0]
    assert np.linalg.norm(body.vertices - body.model.surface.vertices, axis=1).max() > 0.03
    after = scene.runtime.body_forces()[0][0].sum(axis=0)
    assert np.linalg.norm(after - before) > 0.5 * np.linalg.norm(before)


def test_after_a_reset_the_hand_is_placed_and_all_begins_again():
    keys = {"skin.accuracy": 0.5, "motion.start_s": -0.1}
    scene = load(SCENES / "follow_fingertip.xml", device="cpu", keys=keys)
    first = [felt(scene, 1) for _ in range(4)]
    scene.reset()
    again = [felt(scene, 1) for _ in range(4)]
    assert np.array_equal(first, again) and np.abs(first).max() > 1.0
    mujoco.mj_resetData(scene.model, scene.data)
    place(scene.data)
    by_hand = [felt(scene, 1) for _ in range(4)]
    assert np.array_equal(first, by_hand)


def focus_now(scene):
    """Where the focus is, as the transducers were told last, array frame [m]."""
    runtime = scene.runtime
    [foci] = runtime.work.emission.foci(runtime.posed, np.array([scene.time]))
    return foci[0, 0]


def test_a_tick_holds_the_aim_of_a_moving_frame():
    keys = {"skin.accuracy": 0.5, "stimulus.control_rate_Hz": 200, "motion.start_s": -0.2}
    scene = load(SCENES / "follow_fingertip.xml", device="cpu", keys=keys)
    foci = []
    for _ in range(15):
        felt(scene, 1)
        mujoco.mj_forward(scene.model, scene.data)
        foci.append(focus_now(scene))
    assert len({tuple(focus) for focus in foci}) == 4
    assert np.linalg.norm(foci[-1] - foci[0]) > 1e-3


def test_a_board_of_limited_rate_refuses_a_frame_that_moves(small_scene):
    path = small_scene(
        array={"layout": "sonicsurface"},
        driver={"board": "sonicsurface"},
        stimulus=STEADY | {"frame": "centre", "focus_m": "0 0 0"},
    )
    with pytest.raises(DeviceError, match="a moving frame"):
        load(path)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"skin.hand": "open_women_p05"}, "name the preset of that hand"),
        ({"motion.hand": "open_women_p05"}, "name the preset of that hand"),
        ({"motion.hand": None, "motion.follow": "exact"}, "follow 'exact' needs an articulated hand"),
        ({"motion.hand": None}, "pose and joints_deg need an articulated hand"),
    ],
)
def test_hands_that_do_not_fit_their_bodies_are_refused(keys, words):
    with pytest.raises(SceneError, match=words):
        load(SCENES / "approach_withdraw.xml", device="cpu", keys=keys)


def test_a_sensor_far_from_the_layer_is_refused(tmp_path):
    text = (SCENES / "approach_withdraw.xml").read_text().replace('objname="palm_centre"', 'objname="little_pad"')
    text = text.replace('file="plain', f'file="{SCENES}/plain').replace("../motions", f"{SCENES}/../motions")
    (tmp_path / "far.xml").write_text(text)
    with pytest.raises(
        SceneError, match=r"instance 'skin': sensor 'skin': its site is .* mm below the skin; allowed: at most 5 mm"
    ):
        load(tmp_path / "far.xml", device="cpu", keys={"skin.accuracy": 0.5})
