"""Several arrays in a scene: placed, tilted, moving, made of sites, with faults."""

import mujoco
import numpy as np
import pytest

import palmfield
from palmfield.acoustics.air import LIMITS
from palmfield.acoustics.arrays import from_poses, layout, placed
from palmfield.acoustics.field import FieldEvaluator
from palmfield.chain import CLEARANCE_M, HOUSING_M, clearance
from palmfield.errors import SceneError
from palmfield.report import p0_band, p0_given
from palmfield.types import Air

STEADY = {"modulation": "none", "am_of": None, "am_frequency_Hz": None, "am_depth": None}
SECOND = (
    '<plugin plugin="palmfield.array"><instance name="second">'
    '<config key="site" value="second"/>{keys}</instance></plugin>'
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


def with_sites(path, cart, prefix="tx"):
    """The layout uhev1 as sites on a cart that stands at `cart` [m] along y and may slide there."""
    sites = "".join(
        f'<site name="{prefix}{i}" pos="{x} {y} {z}"/>' for i, (x, y, z) in enumerate(layout("uhev1").positions)
    )
    body = f'<body name="cart" pos="0 {cart} 0"><joint name="cart" type="slide" axis="0 1 0"/>{sites}'
    body += '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>'
    plain = path.parent / "plain.xml"
    plain.write_text(plain.read_text().replace("<worldbody>", f"<worldbody>{body}", 1))
    return path


def test_moving_sites_sound_from_where_they_are(small_scene):
    keys = {"layout": "sites", "sites": "tx"}
    moved = palmfield.load(with_sites(small_scene(stimulus=STEADY, array=keys), 0.0))
    moved.data.joint("cart").qpos[0] = 0.05
    shifted = sensors(moved)
    there = sensors(palmfield.load(with_sites(small_scene(stimulus=STEADY, array=keys), 0.05)))
    still = sensors(palmfield.load(with_sites(small_scene(stimulus=STEADY, array=keys), 0.0)))
    assert abs(shifted[5] - still[5]) > 0.01 * abs(still[5])
    np.testing.assert_allclose(shifted[[2, 3, 5]], there[[2, 3, 5]], rtol=1e-5)


def test_a_field_is_kept_while_sites_stand_still(small_scene):
    scene = palmfield.load(with_sites(small_scene(stimulus=STEADY, array={"layout": "sites", "sites": "tx"}), 0.0))
    sensors(scene)
    assert scene.skin.pose().same(scene.skin.pose())
    assert scene.skin.rig.emitter(scene.skin.pose().arrays) is scene.skin.rig.reference_emitter


def test_a_prefix_leaves_the_frame_site_out(small_scene):
    # "a" begins the names of all transducers, and that of the array's own frame site
    path = with_sites(small_scene(stimulus=STEADY, array={"layout": "sites", "sites": "a"}), 0.0, prefix="a")
    assert len(palmfield.load(path).skin.rig.array) == 256
    with pytest.raises(SceneError, match="key 'sites' has value 'arr'; allowed: how names of sites begin that no key"):
        palmfield.load(small_scene(stimulus=STEADY, array={"layout": "sites", "sites": "arr"}))


def test_arrays_of_different_directivity_sound_together(small_scene):
    path = with_second(small_scene(stimulus=STEADY), '<config key="layout" value="autd3"/>')
    scene = palmfield.load(path)
    rig = scene.skin.rig
    assert len(rig.array) == 256 + 249 and len(rig.reference_emitter.kinds) == 2
    first, second = (scene.data.site(board.config.site) for board in rig.boards)
    turn = first.xmat.reshape(3, 3).T
    other = placed(
        layout(rig.boards[1].config.layout), turn @ (second.xpos - first.xpos), turn @ second.xmat.reshape(3, 3)
    )
    apart = (layout(rig.boards[0].config.layout), other)
    drive, _ = rig.unit_drive(rig.reference_focus)
    points = rig.reference_focus + np.random.default_rng(0).uniform(-0.01, 0.01, (50, 3))
    together = rig.reference_emitter.evaluator.pressure(points, drive, gradient=True)
    parts = np.split(drive, [len(apart[0])])
    fields = [
        FieldEvaluator(array, Air(), "cpu").pressure(points, part, gradient=True)
        for array, part in zip(apart, parts, strict=True)
    ]
    wanted = sum(field.pressure for field in fields)
    np.testing.assert_allclose(together.pressure, wanted, atol=1e-6 * np.abs(wanted).max())
    slope = sum(field.gradient for field in fields)
    np.testing.assert_allclose(together.gradient, slope, atol=1e-6 * np.abs(slope).max())
    exact = rig.reference_emitter.pressure64(points, drive)
    np.testing.assert_allclose(exact, wanted, atol=5e-5 * np.abs(wanted).max())
    found = sensors(scene)
    assert np.isfinite(found).all() and found[5] > 0


def test_the_range_of_p0_is_that_of_all_arrays(small_scene):
    keys = (
        '<config key="p0_Pa_m" value="4"/><config key="p0_low_Pa_m" value="2"/><config key="p0_high_Pa_m" value="6"/>'
    )
    rig = palmfield.load(with_second(small_scene(stimulus=STEADY), keys)).skin.rig
    drive, _ = rig.unit_drive(rig.reference_focus)
    halves = [np.where(np.arange(512) // 256 == i, drive, 0) for i in (0, 1)]
    strengths = [abs(rig.reference_emitter.pressure64(rig.reference_focus[None], half)[0]) for half in halves]
    ranged = [board.config.p0_low_Pa_m is not None for board in rig.boards]
    low = sum(p * (0.5 if has else 1.27 / 2.53) for p, has in zip(strengths, ranged, strict=True)) / sum(strengths)
    high = sum(p * (1.5 if has else 8.02 / 2.53) for p, has in zip(strengths, ranged, strict=True)) / sum(strengths)
    # Both sound in phase at the focus, so that magnitudes add up
    assert p0_band(rig) == pytest.approx((low**2, high**2), rel=1e-6)
    assert not p0_given(rig)


def test_no_range_of_p0_where_the_stimulus_sets_the_level(small_scene):
    assert p0_band(palmfield.load(small_scene(stimulus={"arp_peak_Pa": 1})).skin.rig) is None


@pytest.mark.parametrize("keys", [{"layout": "autd3"}, {"directivity": "t4010a1"}, {"directivity": "point"}])
def test_a_pistons_radius_without_a_piston_is_refused(small_scene, keys):
    with pytest.raises(SceneError, match=r"key 'piston_radius_m' has value 0.004.*set directivity to piston"):
        palmfield.load(small_scene(stimulus=STEADY, array=keys | {"piston_radius_m": 0.004}))
    both = {"layout": "autd3", "directivity": "piston", "piston_radius_m": 0.004}
    assert palmfield.load(small_scene(stimulus=STEADY, array=both)).skin.rig.array.piston_radius_m == 0.004


@pytest.mark.filterwarnings("error")
def test_a_level_that_a_dead_array_cannot_give_is_refused(small_scene):
    dead = {"dead": " ".join(map(str, range(256)))}
    with pytest.raises(SceneError, match=r"arp_peak_Pa 5 is wanted .* dead"):
        palmfield.load(small_scene(stimulus={"arp_peak_Pa": 5}, array=dead))


@pytest.mark.parametrize("key", ["temperature_C", "humidity_percent", "pressure_Pa"])
def test_air_has_the_same_limits_as_a_key_and_as_a_model(small_scene, key):
    low, high = LIMITS[key]
    for good in (low, high):
        assert getattr(palmfield.load(small_scene(stimulus=STEADY, array={key: good})).skin.rig.air, key) == good
    with pytest.raises(SceneError, match=f"key '{key}' has value '{high + 1:g}'; allowed: .*<= {high:g}"):
        palmfield.load(small_scene(stimulus=STEADY, array={key: f"{high + 1:g}"}))


def test_clearance_is_measured_from_the_board_wherever_it_lies():
    board = layout("uhev1")
    half = board.positions[:, 0].max() + HOUSING_M
    for offset in np.array([[0.0, 0.0, 0.0], [0.3, -0.1, 0.05]]):
        moved = from_poses("moved", board.positions + offset, board.normals)
        over, low, beside = offset + np.array([[0, 0, 0.03], [half - 1e-4, 0, -0.01], [half + 1e-4, 0, -0.01]])
        assert clearance(moved, over[None]) == pytest.approx(0.03)
        assert clearance(moved, low[None]) == pytest.approx(-0.01)
        assert clearance(moved, beside[None]) == np.inf


def test_clearance_of_an_array_without_a_board_is_that_of_its_faces():
    # On edge: all transducers lie in one plane of constant z and look along x
    positions = np.array([[0.0, y, 0.0] for y in np.linspace(-0.05, 0.05, 11)])
    upright = from_poses("upright", positions, np.tile([1.0, 0.0, 0.0], (11, 1)))
    assert clearance(upright, np.array([[0.03, 0.0, 0.0]])) == pytest.approx(0.03 - HOUSING_M)
    assert clearance(upright, np.array([[0.006, 0.0, 0.0]])) < CLEARANCE_M


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
        palmfield.load(with_second(small_scene(stimulus=STEADY, driver={"board": "sonicsurface"})))
