"""Motion of a skin under the acceleration of its body: in results beside that of the sound, and what is refused."""

import math

import numpy as np
import pytest

import palmfield
from palmfield.data import folder
from palmfield.errors import SceneError
from palmfield.outputs.summary_table import format_summary

MOTIONS = """
import numpy as np
from palmfield.motion.rates import FrameRates, HandRates

def straight(time_s):
    return [0.05 * time_s, 0.0, 0.12], [0.0, 1.0, 0.0, 0.0], {}

straight.rates = lambda time_s: HandRates(FrameRates.at_rest(), {}, {}, {})

def unknown(time_s):
    return straight(time_s)

def shaken(axis):
    def place(time_s):
        move = -2.0 / 100.0**2 * (np.sin(100.0 * time_s) - 100.0 * time_s)
        return np.array([0.0, 0.0, 0.12]) + move * np.eye(3)[axis], [0.0, 1.0, 0.0, 0.0], {}

    # The body is turned by 180 degrees about x
    own = np.diag([1.0, -1.0, -1.0])[axis]
    still = FrameRates.at_rest()
    place.rates = lambda time_s: HandRates(
        still._replace(acceleration=2.0 * np.sin(100.0 * time_s) * own), {}, {}, {}
    )
    return place

along, across, up = map(shaken, range(3))
"""
HAND = folder("mjcf") / "scenes" / "approach_withdraw.xml"


@pytest.fixture
def shaken(small_scene, tmp_path, monkeypatch):
    """Writes the small scene on a mocap body that a function moves."""
    (tmp_path / "motions_of_the_test.py").write_text(MOTIONS)
    monkeypatch.syspath_prepend(tmp_path)

    def write(function, **skin):
        path = small_scene(skin={"inertia": "on"} | skin)
        plain = path.parent / "plain.xml"
        text = plain.read_text().replace('<body name="pad"', '<body name="pad" mocap="true"')
        plain.write_text("\n".join(line for line in text.splitlines() if "<joint" not in line))
        motion = (
            '<plugin plugin="palmfield.motion"><instance name="motion"><config key="body" value="pad"/>'
            f'<config key="function" value="motions_of_the_test:{function}"/></instance></plugin>'
        )
        path.write_text(path.read_text().replace("<extension>", f"<extension>{motion}"))
        return path

    return write


def ran(path):
    return palmfield.run(path, plots=[], usd=False)


def test_a_body_at_constant_velocity_does_not_move_its_skin(shaken):
    result = ran(shaken("straight"))
    moved = result.dataset["skin/skin/motion_displacement"]
    assert moved.dims == ("step_time", "vertex", "xyz") and not moved.values.any()
    [skin] = result.summary["skins"]
    assert skin["motion_peak_displacement_m"] == 0.0 and skin["motion_reduction_error_relative"] == 0.0


def test_the_parts_are_separate_and_that_of_the_sound_is_the_same(shaken):
    on, off = ran(shaken("along")), ran(shaken("along", inertia="off"))
    skin, without = on.dataset["skin/skin"], off.dataset["skin/skin"]
    assert "motion_displacement" not in without
    for name in ("displacement", "velocity", "arp", "normal_displacement"):
        assert np.array_equal(skin[name].values, without[name].values)
    driven = skin["motion_displacement"].values
    # The layer stays behind, along the acceleration
    assert driven[0].max() == 0.0 and driven[5:, :, 0].mean() < 0.0
    assert np.abs(driven[:, :, 1].mean(axis=1)).max() < 0.02 * np.abs(driven[:, :, 0].mean(axis=1)).max()
    numbers, others = on.summary["skins"][0], off.summary["skins"][0]
    assert numbers["motion_peak_displacement_m"] == pytest.approx(np.linalg.norm(driven, axis=2).max(), rel=1e-6)
    assert 0.0 < numbers["motion_reduction_error_relative"] < 1e-3
    assert {name: numbers[name] for name in others if name != "verdict"} == {
        name: value for name, value in others.items() if name != "verdict"
    }
    assert "by the body's acceleration" in format_summary(on.summary)
    assert "by the body's acceleration" not in format_summary(off.summary)


def test_the_axes_are_those_of_the_body(shaken):
    """A disc moves alike along x and, turned, along y; along its normal it moves far less where its sides are held."""
    along, across, up = (
        ran(shaken(name, side="fixed")).dataset["skin/skin/motion_displacement"].values
        for name in ("along", "across", "up")
    )
    assert across[-1, :, 1].mean() == pytest.approx(-along[-1, :, 0].mean(), rel=0.02)
    assert np.abs(up).max() < 0.05 * np.abs(along).max()


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({}, r"key 'inertia' has value 'on': body 'hand' follows plugin 'palmfield.motion' instance 'motion' by "
             r"springs and servos, .*set follow of that plugin to exact, or inertia to off"),
        ({"motion.follow": "exact"}, r"instance 'motion' may jump; allowed: keyframes with interpolation smooth"),
        ({"skin.base": "deep"}, "inertia 'on' needs bone below the layer, but base is 'deep': set base to bonded"),
        ({"skin.solver": "particles"}, "inertia 'on' adds two motions, but solver 'particles' is not linear"),
    ],
)  # fmt: skip
def test_motions_without_continuous_scripted_acceleration_are_refused(keys, message):
    with pytest.raises(SceneError, match=message):
        palmfield.load(HAND, device="cpu", keys={"skin.inertia": "on", "skin.accuracy": 0.5} | keys)


def test_a_function_without_rates_is_refused(shaken):
    with pytest.raises(SceneError, match=r"instance 'motion' may jump; .* with attribute `rates`"):
        palmfield.load(shaken("unknown"))


def test_a_body_that_mujoco_moves_is_refused(small_scene):
    with pytest.raises(SceneError, match=r"body 'pad' has joints, or a mocap body, that no palmfield.motion sets"):
        palmfield.load(small_scene(skin={"inertia": "on"}))


def test_a_smooth_hand_is_accepted_and_a_body_at_rest_stays_still():
    keys = {"skin.inertia": "on", "skin.accuracy": 0.5, "motion.follow": "exact", "motion.interpolation": "smooth"}
    scene = palmfield.load(HAND, device="cpu", keys=keys)
    from palmfield.engine.host import world_of
    from palmfield.engine.inertia import bone_accelerations

    numbers = bone_accelerations(world_of(scene.data), 0)
    assert numbers is not None and numbers(0.2).shape == (len(scene.runtime.binding.skins[0].bones), 12)
    assert numbers(-1.0).any() is np.False_ and math.isfinite(np.abs(numbers(0.2)).max())
    phantom = palmfield.load(folder("mjcf") / "scenes" / "phantom_am200.xml", keys={"skin.inertia": "on"})
    assert bone_accelerations(world_of(phantom.data), 0) is None
