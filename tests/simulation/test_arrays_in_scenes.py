"""Several arrays in a scene: placed, tilted, moving, made of sites, with faults."""

import numpy as np
import pytest

from palmfield.acoustics.arrays import layout, placed
from palmfield.acoustics.field import FieldEvaluator
from palmfield.config.array import AIR_LIMITS
from palmfield.errors import SceneError
from palmfield.session.simulation import load
from palmfield.simulation.emission import array_drives
from palmfield.types import Air

STEADY = {"modulation": "none", "am_quantity": None, "am_frequency_Hz": None, "am_depth": None}
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


def sensors(sim, steps=2):
    sim.step(steps)
    return sim.data.sensordata.copy()


def arrays_of(sim):
    return sim.runtime.model.arrays


def full_drive(model):
    """Where the sound goes first, and the amplitudes that bring it there."""
    focus = model.stimuli[0].first_focus
    return focus, array_drives(model, model.arrays)[0].unit_drive(focus).amplitudes


def seen_from_the_first(sim, array):
    """A layout where the scene's second array stands, in the frame of the first: that of the instances' order."""
    first, second = (sim.data.site(spec.config.site) for spec in sim.runtime.spec.arrays)
    turn = first.xmat.reshape(3, 3).T
    return placed(array, turn @ (second.xpos - first.xpos), turn @ second.xmat.reshape(3, 3))


def test_two_arrays_sound_together(small_scene):
    sim = load(with_second(small_scene(stimulus=STEADY)))
    model = sim.runtime.model
    assert len(model.arrays) == 512
    second = seen_from_the_first(sim, layout("uhev1"))
    focus, drive = full_drive(model)
    points = focus + np.random.default_rng(0).uniform(-0.01, 0.01, (50, 3))
    together = model.arrays.field.pressure(points, drive).pressure
    alone = [
        FieldEvaluator(array, Air(), "cpu").pressure(points, part).pressure
        for array, part in ((layout("uhev1"), drive[:256]), (second, drive[256:]))
    ]
    np.testing.assert_allclose(together, alone[0] + alone[1], atol=3e-5 * np.abs(together).max())
    # Both focus at one point: the pressures add up.
    peak = np.abs(model.arrays.field.pressure(focus[None], drive).pressure)
    parts = [
        np.abs(FieldEvaluator(array, Air(), "cpu").pressure(focus[None], part).pressure)
        for array, part in ((layout("uhev1"), drive[:256]), (second, drive[256:]))
    ]
    assert peak[0] == pytest.approx(parts[0][0] + parts[1][0], rel=1e-4)


def test_a_moving_array_sounds_from_where_it_is(small_scene):
    still = sensors(load(with_second(small_scene(stimulus=STEADY))))
    moved = load(with_second(small_scene(stimulus=STEADY)))
    moved.data.joint("cart").qpos[0] = 0.05
    shifted = sensors(moved)
    there = load(
        with_second(small_scene(stimulus=STEADY), slider=SLIDER.replace('pos="0.3 0 0.05"', 'pos="0.3 0.05 0.05"'))
    )
    assert abs(shifted[5] - still[5]) > 1e-3 * abs(still[5])
    np.testing.assert_allclose(shifted[[2, 3, 5]], sensors(there)[[2, 3, 5]], rtol=1e-5)


def test_sites_make_an_array(small_scene):
    board = layout("uhev1")
    sites = "".join(f'<site name="tx{i}" pos="{x} {y} {z}"/>' for i, (x, y, z) in enumerate(board.positions))
    path = small_scene(stimulus=STEADY, array={"layout": "sites", "sites": "tx", "p0_Pa_m": 1.27})
    plain = path.parent / "plain.xml"
    plain.write_text(plain.read_text().replace("<worldbody>", f"<worldbody>{sites}", 1))
    felt = sensors(load(path))
    np.testing.assert_allclose(felt, sensors(load(small_scene(stimulus=STEADY))), rtol=1e-5, atol=1e-12)


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
    moved = load(with_sites(small_scene(stimulus=STEADY, array=keys), 0.0))
    moved.data.joint("cart").qpos[0] = 0.05
    shifted = sensors(moved)
    there = sensors(load(with_sites(small_scene(stimulus=STEADY, array=keys), 0.05)))
    still = sensors(load(with_sites(small_scene(stimulus=STEADY, array=keys), 0.0)))
    assert abs(shifted[5] - still[5]) > 0.01 * abs(still[5])
    np.testing.assert_allclose(shifted[[2, 3, 5]], there[[2, 3, 5]], rtol=1e-5)


def test_a_field_is_kept_while_sites_stand_still(small_scene):
    sim = load(with_sites(small_scene(stimulus=STEADY, array={"layout": "sites", "sites": "tx"}), 0.0))
    sensors(sim)
    posed = sim.runtime.posed
    assert sim.runtime.posed is posed and posed.arrays is arrays_of(sim)
    # Moved by less than matters, the arrays and their field are still the same ones
    sim.data.joint("cart").qpos[0] = 1e-10
    sim.step()
    assert sim.runtime.posed.arrays is arrays_of(sim)
    sim.data.joint("cart").qpos[0] = 1e-3
    sim.step()
    assert sim.runtime.posed is not posed and sim.runtime.posed.arrays is not arrays_of(sim)


def test_a_prefix_leaves_the_frame_site_out(small_scene):
    # "a" begins the names of all transducers, and that of the array's own frame site
    path = with_sites(small_scene(stimulus=STEADY, array={"layout": "sites", "sites": "a"}), 0.0, prefix="a")
    assert len(arrays_of(load(path))) == 256
    with pytest.raises(
        SceneError,
        match="instance 'array': key 'sites' has value 'arr'; allowed: the beginning of the names of sites that no key",
    ):
        load(small_scene(stimulus=STEADY, array={"layout": "sites", "sites": "arr"}))


def test_arrays_of_different_directivity_sound_together(small_scene):
    path = with_second(small_scene(stimulus=STEADY), '<config key="layout" value="autd3"/>')
    sim = load(path)
    model = sim.runtime.model
    assert len(model.arrays) == 256 + 249 and len(model.arrays.groups) == 2
    layouts = [layout(array.config.layout) for array in sim.runtime.spec.arrays]
    alone = (layouts[0], seen_from_the_first(sim, layouts[1]))
    focus, drive = full_drive(model)
    points = focus + np.random.default_rng(0).uniform(-0.01, 0.01, (50, 3))
    together = model.arrays.field.pressure(points, drive, gradient=True)
    parts = np.split(drive, [len(alone[0])])
    fields = [
        FieldEvaluator(array, Air(), "cpu").pressure(points, part, gradient=True)
        for array, part in zip(alone, parts, strict=True)
    ]
    expected = sum(field.pressure for field in fields)
    np.testing.assert_allclose(together.pressure, expected, atol=1e-6 * np.abs(expected).max())
    slope = sum(field.gradient for field in fields)
    np.testing.assert_allclose(together.gradient, slope, atol=1e-6 * np.abs(slope).max())
    exact = model.arrays.pressure64(points, drive)
    np.testing.assert_allclose(exact, expected, atol=5e-5 * np.abs(expected).max())
    felt = sensors(sim)
    assert np.isfinite(felt).all() and felt[5] > 0


@pytest.mark.parametrize("keys", [{"layout": "autd3"}, {"directivity": "t4010a1"}, {"directivity": "point"}])
def test_a_pistons_radius_without_a_piston_is_refused(small_scene, keys):
    named = "palmfield.array' instance 'array': key 'piston_radius_m' has value 0.004.*set directivity to piston"
    with pytest.raises(SceneError, match=named):
        load(small_scene(stimulus=STEADY, array=keys | {"piston_radius_m": 0.004}))
    both = {"layout": "autd3", "directivity": "piston", "piston_radius_m": 0.004}
    assert arrays_of(load(small_scene(stimulus=STEADY, array=both))).array.piston_radius_m == 0.004


@pytest.mark.filterwarnings("error")
def test_a_level_that_a_dead_array_cannot_give_is_refused(small_scene):
    dead = {"dead": " ".join(map(str, range(256)))}
    with pytest.raises(SceneError, match="instance 'array': all 256 transducers are dead"):
        load(small_scene(stimulus={"arp_peak_Pa": 5}, array=dead))


@pytest.mark.parametrize("key", ["temperature_C", "humidity_percent", "pressure_Pa"])
def test_air_has_the_same_limits_as_a_key_and_as_a_model(small_scene, key):
    low, high = AIR_LIMITS[key]
    for good in (low, high):
        assert getattr(arrays_of(load(small_scene(stimulus=STEADY, array={key: good}))).air, key) == good
    with pytest.raises(SceneError, match=f"key '{key}' has value '{high + 1:g}'; allowed: .*<= {high:g}"):
        load(small_scene(stimulus=STEADY, array={key: f"{high + 1:g}"}))


def test_dead_and_inverted_transducers_weaken_the_focus(small_scene):
    whole = sensors(load(small_scene(stimulus=STEADY)))[5]
    dead = sensors(load(small_scene(stimulus=STEADY, array={"dead": "0 1 2 3 100"})))[5]
    inverted = sensors(load(small_scene(stimulus=STEADY, array={"inverted": "0 1 2 3 100"})))[5]
    assert inverted < dead < whole


@pytest.mark.parametrize(
    "keys", [{"layout": "autd3"}, {"directivity": "point"}, {"directivity": "t4010a1"}, {"precision": "accurate"}]
)
def test_other_transducers_run(small_scene, keys):
    felt = sensors(load(small_scene(stimulus=STEADY, array=keys)))
    assert np.isfinite(felt).all() and felt[5] > 0


@pytest.mark.parametrize(
    ("keys", "match"),
    [
        ({"dead": "256"}, "palmfield.array' instance 'array': .*transducer 256.*0 to 255"),
        ({"dead": "1 1"}, "listed twice"),
        ({"dead": "-1"}, "key 'dead' has value '-1'; allowed: whole numbers >= 0"),
        ({"layout": "sites"}, "layout 'sites' and key sites"),
        ({"layout": "sites", "sites": "nose"}, "key 'sites' has value 'nose'"),
        ({"layout": "uhev2"}, "key 'layout' has value 'uhev2'"),
    ],
)
def test_bad_arrays_are_refused(small_scene, keys, match):
    with pytest.raises(SceneError, match=match):
        load(small_scene(stimulus=STEADY, array=keys))


def test_arrays_share_their_air_and_a_board_plays_alone(small_scene):
    warm = '<config key="temperature_C" value="30"/>'
    with pytest.raises(SceneError, match=r"instance '\w+': key 'temperature_C' has value .*the same for all arrays"):
        load(with_second(small_scene(stimulus=STEADY), warm))
    with pytest.raises(SceneError, match="drives one array; the scene has 2"):
        load(with_second(small_scene(stimulus=STEADY, driver={"board": "sonicsurface"})))
