"""Loads computed ahead for a path on a still body: the same numbers, and given up as soon as anything moves."""

import numpy as np
import pytest
from scipy import sparse

from palmfield.session.simulation import load
from palmfield.simulation.emission import AHEAD

STEADY = {"modulation": "none", "am_quantity": None, "am_frequency_Hz": None, "am_depth": None}
CIRCLE = STEADY | {"path": "circle", "path_diameter_m": 0.01, "path_rate_Hz": 70}
WHOLE = {"step_s": 0.0001, "solver": "wedges"}
FIXED = '<joint name="slide" type="slide" axis="1 0 0" stiffness="400" damping="10"/>'
AUTD3 = (
    '<plugin plugin="palmfield.array"><instance name="second"><config key="site" value="second"/>'
    '<config key="layout" value="autd3"/></instance></plugin>'
)
SUBSTEPS = 10


def fixed(path):
    """The scene with its pad nailed down."""
    plain = path.parent / "plain.xml"
    plain.write_text(plain.read_text().replace(FIXED, ""))
    return path


def motion_of(sim):
    """Displacement and velocity over all unknowns, shape (2, ndof)."""
    [(stepper, numbers)] = sim.runtime.skin_states()
    unknowns = sim.runtime.model.skins[0].layer.system.ndof
    return stepper.read(numbers, stepper.reader(sparse.identity(unknowns, format="csr")))[0]


class Watch:
    """How often drives are looked at ahead, and how many substeps take a load that was computed ahead, or at once."""

    def __init__(self, sim, ahead):
        work, host = sim.runtime.work, sim.runtime.steps.host
        self.predictions, self.taken = 0, {True: 0, False: 0}
        look_ahead, patterns = work.emission._look_ahead, host._patterns

        def counting(*arguments):
            self.predictions += 1
            return look_ahead(*arguments)

        def taking(world, skin, stepper, course):
            if len(course.units) > 1:
                self.taken[course.batch is not None] += SUBSTEPS
            return patterns(world, skin, stepper, course)

        work.emission._look_ahead, host._patterns = counting, taking
        if not ahead:
            work._may_look_ahead = False


def watched(path, ahead, steps=22, speed=0.0):
    """Motion after some steps, what was counted in them, and the simulation."""
    sim = load(path)
    watch = Watch(sim, ahead)
    sim.data.qvel[:] = speed
    for _ in range(steps):
        sim.step()
    return motion_of(sim), watch, sim


@pytest.mark.parametrize("response", ["off", "on"])
def test_loads_computed_ahead_are_those_of_each_step(small_scene, response):
    changes = {"stimulus": CIRCLE, "array": {"response": response}, "skin": WHOLE}
    ahead, watch, _ = watched(fixed(small_scene(**changes)), True)
    at_once, plain, _ = watched(fixed(small_scene(**changes)), False)
    assert plain.taken[True] == 0
    assert watch.taken[True] > 0.75 * plain.taken[False] and watch.taken[False] < 0.25 * plain.taken[False]
    for i in (0, 1):  # displacement, velocity
        assert np.linalg.norm(ahead[i] - at_once[i]) < 1e-5 * np.linalg.norm(at_once[i])


def test_points_that_are_held_between_ticks_are_looked_at_ahead(small_scene):
    path = fixed(small_scene(stimulus=CIRCLE | {"control_rate_Hz": 900.0}, skin=WHOLE))
    ahead, watch, _ = watched(path, True, 30)
    at_once, _, _ = watched(path, False, 30)
    assert watch.predictions == 3 and watch.taken[True] > 0.9 * sum(watch.taken.values())
    for i in (0, 1):  # displacement, velocity
        assert np.linalg.norm(ahead[i] - at_once[i]) < 1e-5 * np.linalg.norm(at_once[i])


def test_a_moving_body_gets_each_step_its_own_load(small_scene):
    path = small_scene(stimulus=CIRCLE, skin=WHOLE)
    ahead, watch, sim = watched(path, True, 5, 0.01)
    at_once, _, _ = watched(path, False, 5, 0.01)
    assert sim.data.qpos[0] > 1e-6 and watch.taken[True] == 0
    np.testing.assert_array_equal(ahead, at_once)


def test_what_was_computed_ahead_is_dropped_when_the_body_moves(small_scene):
    path = fixed(small_scene(stimulus=CIRCLE, array={"response": "off"}, skin=WHOLE))
    plain = path.parent / "plain.xml"
    plain.write_text(plain.read_text().replace('<body name="pad"', '<body name="pad" mocap="true"'))

    def motion(ahead):
        sim = load(path)
        watch = Watch(sim, ahead)
        for k in range(10):
            if k >= 5:
                sim.data.mocap_pos[0, 1] = 1e-3 * (k - 4)
            known = watch.taken[True]
            sim.step()
            if ahead and k == 4:
                assert watch.taken[True] == known + SUBSTEPS
            if k >= 5:
                assert watch.taken[True] == known
        return motion_of(sim)

    moved, at_once = motion(True), motion(False)
    assert np.linalg.norm(moved[0] - at_once[0]) < 1e-5 * np.linalg.norm(at_once[0])


def test_nothing_is_computed_ahead_where_it_would_not_pay(small_scene):
    # 4 points a turn at 70 turns/s: fewer than 5 drives in the steps ahead
    few = {"path_points": 4}
    path = fixed(small_scene(stimulus=CIRCLE | few, array={"response": "off"}, skin=WHOLE))
    at_once, watch, _ = watched(path, True, 20)
    assert watch.taken[True] == 0
    # That it does not pay is found out once in the time that is looked ahead, not at each step
    assert 1 <= watch.predictions <= 20 * SUBSTEPS / (AHEAD - SUBSTEPS) + 1
    assert np.abs(at_once[0]).max() > 0.0

    def predictions(**changes):
        return watched(fixed(small_scene(**changes)), True, 4)[1].predictions

    assert predictions(stimulus=CIRCLE, skin=WHOLE) == 1
    assert predictions(stimulus=CIRCLE, skin=WHOLE | {"body_sound": "shadows"}) == 0
    assert predictions(stimulus=CIRCLE, skin=WHOLE, array={"precision": "accurate"}) == 0
    assert predictions(stimulus=STEADY, skin=WHOLE) == 0
    mixed = fixed(small_scene(stimulus=CIRCLE, skin=WHOLE))
    plain = mixed.parent / "plain.xml"
    plain.write_text(plain.read_text().replace("<worldbody>", '<worldbody><site name="second" pos="0.2 0 0"/>', 1))
    mixed.write_text(mixed.read_text().replace("<extension>", "<extension>" + AUTD3, 1))
    assert watched(mixed, True, 4)[1].predictions == 0


def test_equal_drives_are_computed_once(small_scene):
    """A focus that rests at the points of its path loads the skin with as many patterns as it visits."""
    path = fixed(small_scene(stimulus=CIRCLE | {"path_points": 4}, array={"response": "off"}, skin=WHOLE))
    sim = load(path)
    many, computed = sim.runtime.work.radiation.many, []

    def counting(posed, skin, drives, *role):
        computed.append(len(drives))
        return many(posed, skin, drives, *role)

    sim.runtime.work.radiation.many = counting
    for _ in range(14):
        sim.step()
    # The focus rests 3.6 ms at each point: in 14 steps it moves on three times
    assert sum(computed) == 14 + 3
