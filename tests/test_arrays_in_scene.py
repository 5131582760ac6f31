"""Several arrays in a scene: placed, tilted, moving, made of sites, with faults."""

import mujoco
import numpy as np
import pytest

import palmfield
from palmfield.acoustics.arrays import layout, placed
from palmfield.acoustics.field import FieldEvaluator
from palmfield.errors import SceneError
from palmfield.types import Air

STEADY = {"modulation": "none", "am_of": None, "am_frequency_Hz": None, "am_depth": None}
SECOND = (
    '<plugin plugin="palmfield.array"><instance name="second">'
    '<config key="site" value="second"/><config key="compute" value="cpu"/>{keys}</instance></plugin>'
)
SLIDER = (
    '<body name="cart" pos="0.3 0 0.05"><joint name="cart" type="slide" axis="0 1 0"/>'
    '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><site name="second" quat="0.9238795 0 -0.3826834 0"/></body>'
)


def with_second(path, keys="", slider=SLIDER):
    plain = path.parent / "plain.xml"
    plain.write_text(plain.read_text().replace("<worldbody>", f"<worldbody>{slider}", 1))
    path.write_text(path.read_text().replace("<extension>", "<extension>" + SECOND.format(keys=keys), 1))
    return path


def sensors(scene, steps=2):
    for _ in range(steps):
        mujoco.mj_step(scene.model, scene.data)
    return scene.data.sensordata.copy()


def test_two_arrays_sound_together(small_scene):
    scene = palmfield.load(with_second(small_scene(stimulus=STEADY)))
    rig = scene.skin.rig
    assert len(rig.array) == 512
    first_site, second_site = (
        scene.data.site(board.config.site) for board in rig.boards
    )  # the order of the instances decides the frame
    second = placed(
        layout("uhev1"),
        first_site.xmat.reshape(3, 3).T @ (second_site.xpos - first_site.xpos),
        first_site.xmat.reshape(3, 3).T @ second_site.xmat.reshape(3, 3),
    )
    drive, _ = rig.unit_drive(rig.reference_focus)
    points = rig.reference_focus + np.random.default_rng(0).uniform(-0.01, 0.01, (50, 3))
    together = rig.reference_emitter.evaluator.pressure(points, drive).pressure
    apart = [
        FieldEvaluator(array, Air(), "cpu").pressure(points, part).pressure
        for array, part in ((layout("uhev1"), drive[:256]), (second, drive[256:]))
    ]
    np.testing.assert_allclose(together, apart[0] + apart[1], atol=3e-5 * np.abs(together).max())
    # Both focus at one point: the pressures add up.
    peak = np.abs(rig.reference_emitter.evaluator.pressure(rig.reference_focus[None], drive).pressure)
    alone = [
        np.abs(FieldEvaluator(array, Air(), "cpu").pressure(rig.reference_focus[None], part).pressure)
        for array, part in ((layout("uhev1"), drive[:256]), (second, drive[256:]))
    ]
    assert peak[0] == pytest.approx(alone[0][0] + alone[1][0], rel=1e-4)


def test_a_moving_array_sounds_from_where_it_is(small_scene):
    scene = palmfield.load(with_second(small_scene(stimulus=STEADY)))
    still = sensors(scene)
    moved = palmfield.load(with_second(small_scene(stimulus=STEADY)))
    moved.data.joint("cart").qpos[0] = 0.05
    shifted = sensors(moved)
    there = palmfield.load(
        with_second(small_scene(stimulus=STEADY), slider=SLIDER.replace('pos="0.3 0 0.05"', 'pos="0.3 0.05 0.05"'))
    )
    assert abs(shifted[5] - still[5]) > 1e-3 * abs(still[5])
    np.testing.assert_allclose(shifted[[2, 3, 5]], sensors(there)[[2, 3, 5]], rtol=1e-5)


def test_sites_make_an_array(small_scene):
    board = layout("uhev1")
    sites = "".join(f'<site name="tx{i}" pos="{x} {y} {z}"/>' for i, (x, y, z) in enumerate(board.positions))
    path = small_scene(stimulus=STEADY, array={"layout": "sites", "sites": "tx"})
    plain = path.parent / "plain.xml"
    plain.write_text(plain.read_text().replace("<worldbody>", f"<worldbody>{sites}", 1))
    found = sensors(palmfield.load(path))
    np.testing.assert_allclose(found, sensors(palmfield.load(small_scene(stimulus=STEADY))), rtol=1e-5, atol=1e-12)


def test_dead_and_inverted_transducers_weaken_the_focus(small_scene):
    whole = sensors(palmfield.load(small_scene(stimulus=STEADY)))[5]
    dead = sensors(palmfield.load(small_scene(stimulus=STEADY, array={"dead": "0 1 2 3 100"})))[5]
    inverted = sensors(palmfield.load(small_scene(stimulus=STEADY, array={"inverted": "0 1 2 3 100"})))[5]
    assert inverted < dead < whole


@pytest.mark.parametrize(
    "keys", [{"layout": "autd3"}, {"directivity": "point"}, {"directivity": "t4010a1"}, {"precision": "accurate"}]
)
def test_other_transducers_run(small_scene, keys):
    found = sensors(palmfield.load(small_scene(stimulus=STEADY, array=keys)))
    assert np.isfinite(found).all() and found[5] > 0


@pytest.mark.parametrize(
    ("keys", "match"),
    [
        ({"dead": "256"}, "palmfield.array.*transducer 256.*0 to 255"),
        ({"dead": "1 1"}, "named twice"),
        ({"dead": "-1"}, "key 'dead' has value '-1'; allowed: whole numbers >= 0"),
        ({"layout": "sites"}, "layout 'sites' needs sites"),
        ({"layout": "sites", "sites": "nose"}, "key 'sites' has value 'nose'"),
        ({"layout": "uhev2"}, "key 'layout' has value 'uhev2'"),
    ],
)
def test_bad_arrays_are_refused(small_scene, keys, match):
    with pytest.raises(SceneError, match=match):
        palmfield.load(small_scene(stimulus=STEADY, array=keys))


def test_arrays_share_their_air_and_a_board_plays_alone(small_scene):
    warm = '<config key="temperature_C" value="30"/>'
    with pytest.raises(SceneError, match=r"key 'temperature_C' has value .*the same for all arrays"):
        palmfield.load(with_second(small_scene(stimulus=STEADY), warm))
    with pytest.raises(SceneError, match="drives one array; the scene has 2"):
        palmfield.load(with_second(small_scene(stimulus=STEADY, driver={"device": "sonicsurface"})))
