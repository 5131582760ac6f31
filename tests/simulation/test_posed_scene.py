"""What frames of MuJoCo's bodies mean for sound and skin, against the frames' own algebra."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from palmfield.session.simulation import load
from palmfield.simulation.emission import array_drives
from palmfield.simulation.posed_scene import PoseLayout, posed_scene, reference_scene, settled_worlds
from palmfield.simulation.radiation import Radiation
from palmfield.transforms import IDENTITY, Transform, relative

STEADY = {"modulation": "none", "am_quantity": None, "am_frequency_Hz": None, "am_depth": None}
SITES = "".join(f'<site name="tx{i}" pos="{0.02 * i} 0 0"/>' for i in range(4))


def as_arrays(frames):
    return np.array([frame.position for frame in frames]), np.array([frame.rotation for frame in frames])


def at_rest(model):
    """Frames of the rows of a scene of discs in its reference pose."""
    reference = reference_scene(model)
    return [IDENTITY, *reference.frames, *(body.frame for body in reference.bodies)]


def posed(model, frames, previous=None):
    reference = reference_scene(model)
    return posed_scene(model, PoseLayout(model), *as_arrays(frames), previous or reference, reference)


def assert_same(found, expected):
    np.testing.assert_allclose(found.position, expected.position, atol=1e-12)
    np.testing.assert_allclose(found.rotation, expected.rotation, atol=1e-12)


def test_all_is_seen_from_the_first_array_wherever_that_is(small_scene):
    path = small_scene(stimulus=STEADY, array={"layout": "sites", "sites": "tx"})
    plain = path.with_name("plain.xml")
    plain.write_text(plain.read_text().replace("<worldbody>", f"<worldbody>{SITES}", 1))
    model = load(path).runtime.model
    layout, random = PoseLayout(model), np.random.default_rng(0)
    turns = Rotation.random(layout.obstacles[-1].stop, random).as_matrix()
    frames = [Transform(random.normal(size=3), turn) for turn in turns]
    first, scene = frames[0], posed(model, frames)
    assert_same(scene.array_frame, first)
    assert_same(scene.frames[0], relative(first, frames[layout.frames.start]))
    assert_same(scene.bodies[0].frame, relative(first, frames[layout.bodies[0][0]]))
    transducers = [relative(first, frame) for frame in frames[layout.transducers[0]]]
    array = scene.arrays.array
    np.testing.assert_allclose(array.positions, [one.position for one in transducers], atol=1e-12)
    np.testing.assert_allclose(array.normals, [one.rotation[:, 2] for one in transducers], atol=1e-12)


def test_worlds_rest_where_their_scenes_do_however_all_is_turned(small_scene):
    model = load(small_scene(skin={"solver": "reduced"})).runtime.model
    reference, [still_m] = reference_scene(model), model.still_m
    random, worlds = np.random.default_rng(1), []
    for shift in (0.0, 0.7, 1.4):
        for angle in (0.0, 0.7, 1.4):
            *others, body = at_rest(model)
            way = Rotation.random(rng=random).as_matrix()[0]
            turn = Rotation.from_rotvec(angle * still_m / 0.02 * way).as_matrix()
            body = Transform(body.position + shift * still_m * way, body.rotation @ turn)
            whole = Transform(random.normal(size=3), Rotation.random(rng=random).as_matrix())
            worlds.append([relative(whole, frame) for frame in (*others, body)])
    together = (np.array(part) for part in zip(*map(as_arrays, worlds), strict=True))
    found = settled_worlds(model, PoseLayout(model), *together, reference)
    alone = [posed_scene(model, PoseLayout(model), *as_arrays(one), reference, reference) for one in worlds]
    assert found.tolist() == [one.bodies[0] is reference.bodies[0] for one in alone]
    assert 1 < found.sum() < 8


@pytest.mark.parametrize("body_sound", ["none", "shadows"])
def test_another_body_counts_where_it_may_cast_a_shadow(small_scene, add_skin, body_sound):
    path = add_skin(small_scene(stimulus=STEADY, skin={"body_sound": body_sound}), "0.1 0 0.12")
    model = load(path).runtime.model
    frames = at_rest(model)
    before = posed(model, frames)
    frames[-1] = Transform(frames[-1].position + 0.01, frames[-1].rotation)
    after = posed(model, frames, before)
    first, second = (one == other for one, other in zip(before.sound_keys, after.sound_keys, strict=True))
    assert first == (body_sound == "none") and not second


def test_forces_follow_a_body_that_turns(small_scene):
    """By the samples where they are now, about where the body's origin is now."""
    model = load(small_scene(stimulus=STEADY)).runtime.model
    radiation, frames = Radiation(model), at_rest(model)
    drive = array_drives(model, model.arrays)[0].unit_drive(model.stimuli[0].first_focus).amplitudes
    for degrees in (0.0, 25.0, 25.0):
        turn = Rotation.from_euler("y", degrees, degrees=True).as_matrix()
        frames[-1] = Transform(frames[-1].position + 0.002, turn @ frames[-1].rotation)
        scene = posed(model, frames)
        found = radiation.force(scene, 0, radiation.on(scene, 0, "samples", drive).arp)
        points, normals, areas = scene.bodies[0].samples
        pushes = -(Radiation(model).at(scene, 0, "samples", points, normals, drive).arp * areas)[:, None] * normals
        np.testing.assert_allclose(found[0, 0], pushes.sum(axis=0), rtol=0.0, atol=1e-5 * np.abs(found[0]).max())
        torque = np.cross(points - frames[-1].position, pushes).sum(axis=0)
        np.testing.assert_allclose(found[1, 0], torque, rtol=0.0, atol=1e-5 * np.abs(found[1]).max())
