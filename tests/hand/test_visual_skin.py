"""The skin that viewers show: it is where the simulated one is, and the physics doesn't know of it."""

import mujoco
import numpy as np
import pytest
from preset_mjcf import articulated_mjcf

from palmfield.data import folder
from palmfield.hand.preset import load_preset, mirrored
from palmfield.hand.skinning import SkinnedHand

MEN = load_preset("open_men_p50")
HANDS = folder("mjcf") / "hands"
ROUNDING_m = 5e-5
"""Places to 10 um and shares to a thousandth, of bones some centimetres apart."""


def seen_skin(model, data):
    scene, camera = mujoco.MjvScene(model, maxgeom=2000), mujoco.MjvCamera()
    mujoco.mjv_updateScene(model, data, mujoco.MjvOption(), None, camera, mujoco.mjtCatBit.mjCAT_ALL, scene)
    return np.array(scene.skinvert).reshape(-1, 3)


def moved(model, seed=0):
    data = mujoco.MjData(model)
    data.qpos += np.random.default_rng(seed).uniform(-0.2, 0.2, model.nq)
    mujoco.mj_kinematics(model, data)
    return data


@pytest.mark.parametrize("side", ["", "_left"])
def test_a_shipped_hand_shows_the_skin_that_is_simulated(side):
    skinned = SkinnedHand(mirrored(MEN) if side else MEN, 0.004)
    model = mujoco.MjModel.from_xml_path(str(HANDS / f"articulated_men_p50{side}.xml"))
    data = moved(model)
    bodies = [model.body(bone.name).id for bone in skinned.hand.bones]
    ours = skinned.posed(data.xpos[bodies], data.xmat[bodies].reshape(-1, 3, 3))
    assert np.abs(seen_skin(model, data) - ours).max() < ROUNDING_m
    assert not np.allclose(seen_skin(model, mujoco.MjData(model)), ours, atol=0.02)


def test_the_hand_in_one_piece_shows_it_too():
    model = mujoco.MjModel.from_xml_path(str(HANDS / "open_men_p50.xml"))
    data = moved(model)
    surface = SkinnedHand(MEN, 0.004).surface.vertices
    assert np.abs(seen_skin(model, data) - surface - data.body("hand").xpos).max() < ROUNDING_m


def test_each_hand_of_an_attached_pair_has_its_own():
    model = mujoco.MjModel.from_xml_path(str(HANDS.parent / "scenes" / "two_hands_both_feel.xml"))
    data = mujoco.MjData(model)
    data.mocap_pos[:, 2] += 0.1
    data.qpos[:3] += [0.0, 0.0, 0.1]
    mujoco.mj_kinematics(model, data)
    right, left = np.split(seen_skin(model, data), 2)
    assert model.nskin == 2 and right[:, 2].mean() - left[:, 2].mean() == pytest.approx(0.1, abs=0.03)


def test_the_physics_does_not_know_of_it():
    """The same masses, and the same motion to the bit under the same push."""
    ends = []
    for skin in (True, False):
        model = mujoco.MjModel.from_xml_string(articulated_mjcf(MEN, skin=skin))
        data = mujoco.MjData(model)
        data.xfrc_applied[model.body("index_distal").id, 2] = 0.05
        mujoco.mj_step(model, data, nstep=50)
        ends.append((model.nskin, model.body_mass.copy(), data.qpos.copy()))
    assert ends[0][0] == 1 and ends[1][0] == 0
    assert np.array_equal(ends[0][1], ends[1][1]) and np.array_equal(ends[0][2], ends[1][2])
