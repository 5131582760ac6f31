"""Loads computed ahead for a path on a still body: the same numbers, and given up as soon as anything moves."""

import mujoco
import numpy as np
import pytest
from scipy import sparse

import palmfield
from palmfield.foresight import STEPS

STEADY = {"modulation": "none", "am_of": None, "am_frequency_Hz": None, "am_depth": None}
CIRCLE = STEADY | {"path": "circle", "path_diameter_m": 0.01, "path_rate_Hz": 70}
FULL = {"step_s": 0.0001, "solver": "wedges"}
FIXED = '<joint name="slide" type="slide" axis="1 0 0" stiffness="400" damping="10"/>'


def fixed(path):
    """The scene with its pad nailed down."""
    plain = path.parent / "plain.xml"
    plain.write_text(plain.read_text().replace(FIXED, ""))
    return path


def motion_of(scene):
    """Displacement and velocity over all unknowns."""
    skin = scene.skin
    return skin.chain.skin.read(skin.world.state(skin.instance), sparse.identity(skin.rig.system.ndof, format="csr"))


def watched(path, ahead, steps=22, speed=0.0):
    """Motion after some steps; how many loads were taken from what was foreseen, and how many computed at once."""
    scene = palmfield.load(path)
    chain = scene.skin.chain
    chain.__dict__["_can_foresee"] = chain._can_foresee and ahead
    taken = {True: 0, False: 0}
    take = chain._foresight.take

    def counting(pose, drive):
        load = take(pose, drive)
        taken[load is not None] += 1
        return load

    chain._foresight.take = counting
    scene.data.qvel[:] = speed
    for _ in range(steps):
        mujoco.mj_step(scene.model, scene.data)
    return motion_of(scene), taken, scene


@pytest.mark.parametrize("response", ["off", "on"])
def test_foreseen_loads_are_those_of_each_step(small_scene, response):
    changes = {"stimulus": CIRCLE, "array": {"response": response}, "skin": FULL}
    ahead, taken, _ = watched(fixed(small_scene(**changes)), True)
    at_once, plain, _ = watched(fixed(small_scene(**changes)), False)
    assert plain[True] == 0
    assert taken[True] > 0.75 * plain[False] and taken[False] < 0.25 * plain[False]
    for i in (0, 1):  # displacement, velocity
        assert np.linalg.norm(ahead[i] - at_once[i]) < 1e-5 * np.linalg.norm(at_once[i])


def test_a_moving_body_gets_each_step_its_own_load(small_scene):
    path = small_scene(stimulus=CIRCLE, skin=FULL)
    ahead, taken, scene = watched(path, True, 5, 0.01)
    at_once, _, _ = watched(path, False, 5, 0.01)
    assert scene.data.qpos[0] > 1e-6 and taken[True] == 0
    np.testing.assert_array_equal(ahead, at_once)


def test_what_was_foreseen_is_dropped_when_the_body_moves(small_scene):
    path = fixed(small_scene(stimulus=CIRCLE, array={"response": "off"}, skin=FULL))
    plain = path.parent / "plain.xml"
    plain.write_text(plain.read_text().replace('<body name="pad"', '<body name="pad" mocap="true"'))

    def motion(ahead):
        scene = palmfield.load(path)
        chain = scene.skin.chain
        chain.__dict__["_can_foresee"] = chain._can_foresee and ahead
        for k in range(10):
            if k >= 5:
                scene.data.mocap_pos[0, 1] = 1e-3 * (k - 4)
            mujoco.mj_step(scene.model, scene.data)
            if ahead and k == 4:
                assert chain._foresight.knows(scene.skin.pose(), scene.data.time)
        return motion_of(scene)

    moved, at_once = motion(True), motion(False)
    assert np.linalg.norm(moved[0] - at_once[0]) < 1e-5 * np.linalg.norm(at_once[0])


def test_nothing_is_foreseen_where_it_would_not_pay(small_scene):
    # 4 points a turn at 70 turns/s: fewer than 5 drives in the steps ahead
    few = {"path_points": 4}
    _, taken, scene = watched(fixed(small_scene(stimulus=CIRCLE | few, array={"response": "off"}, skin=FULL)), True, 20)
    assert taken[True] == 0 and scene.skin.chain._foresight.until > STEPS * 0.0001
    shaded = small_scene(stimulus=CIRCLE, skin={"body_sound": "shadows"})
    assert not palmfield.load(shaded).skin.chain._can_foresee
    assert not palmfield.load(small_scene(stimulus=CIRCLE, array={"precision": "accurate"})).skin.chain._can_foresee
    assert palmfield.load(small_scene(stimulus=CIRCLE)).skin.chain._can_foresee
    assert not palmfield.load(small_scene(stimulus=STEADY)).skin.chain._can_foresee
