import mujoco
import numpy as np
import pytest
from mjcf_files import assert_same_file
from preset_mjcf import articulated_mjcf
from scipy.spatial.transform import Rotation

from palmfield.data import folder
from palmfield.errors import SceneError
from palmfield.hand.articulated import articulate, bone_poses, checked_angles, posed_landmark
from palmfield.hand.preset import DIGITS, load_preset, mirrored, preset_names

MEN = load_preset("open_men_p50")
FILE = folder("mjcf") / "hands" / "articulated_men_p50.xml"


@pytest.fixture(scope="module")
def hand():
    return articulate(MEN)


@pytest.fixture(scope="module")
def model():
    return mujoco.MjModel.from_xml_string(articulated_mjcf(MEN))


def landmark(hand, name, **angles):
    return posed_landmark(hand, name, *bone_poses(hand, angles))


def test_committed_file_is_what_the_generator_writes():
    assert_same_file(FILE.read_text(encoding="utf-8"), articulated_mjcf(MEN))


@pytest.mark.parametrize("name", preset_names())
def test_every_preset_has_plausible_mass_and_no_contacts_at_rest(name):
    for preset in (load_preset(name), mirrored(load_preset(name))):
        model = mujoco.MjModel.from_xml_string(articulated_mjcf(preset, skin=False))
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        assert data.ncon == 0
        assert 0.2 < model.body_mass.sum() < 0.75
        moving = [model.body(bone.name).id for bone in articulate(preset).bones]
        assert (model.body_inertia[moving] > 0).all()
        matrix = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, matrix)
        assert np.linalg.eigvalsh(matrix).min() > 0


def test_median_mass(model):
    assert 0.3 < model.body_mass.sum() < 0.6


def test_number_of_joints(hand, model):
    fingers = [joint for joint in hand.joints if not joint.name.startswith("wrist")]
    assert len(fingers) == 20 and len(hand.joints) == 22
    assert model.nu == 22 and model.njnt == 23


@pytest.mark.parametrize("side", ["right", "left"])
def test_bones_are_where_mujoco_has_them(side):
    preset = MEN.model_copy(update={"side": side})
    hand, model = articulate(preset), mujoco.MjModel.from_xml_string(articulated_mjcf(preset))
    data = mujoco.MjData(model)
    rng = np.random.default_rng(1)
    for _ in range(5):
        angles = {j.name: rng.uniform(j.low_deg, j.high_deg) for j in hand.joints}
        for name, angle in angles.items():
            data.joint(name).qpos[0] = np.deg2rad(angle)
        mujoco.mj_kinematics(model, data)
        positions, rotations = bone_poses(hand, angles)
        bodies = [model.body(bone.name).id for bone in hand.bones]
        assert data.xpos[bodies] - [0, 0, 0.2] == pytest.approx(positions, abs=1e-8)
        assert data.xmat[bodies].reshape(-1, 3, 3) == pytest.approx(rotations, abs=1e-8)
        for name in ("index_tip", "thumb_pad", "palm_centre"):
            at = posed_landmark(hand, name, positions, rotations)
            assert data.site(name).xpos - [0, 0, 0.2] == pytest.approx(at, abs=1e-8)


def test_rest_pose_is_that_of_the_preset(hand):
    positions, rotations = bone_poses(hand, {})
    assert positions == pytest.approx(np.array([bone.origin for bone in hand.bones]), abs=1e-15)
    assert rotations == pytest.approx(np.tile(np.eye(3), (17, 1, 1)), abs=1e-15)


def test_index_finger_by_hand(hand):
    # Written out: Rz turns to the thumb's side (-x) and R about -x flexes, in the finger's own frame.
    spread = Rotation.from_euler("z", -MEN.digits["index"].spread_deg, degrees=True)
    knuckle, lengths = hand.skeleton.landmarks["index_knuckle"], np.array(MEN.digits["index"].bones_m[1:])
    angles = dict(index_mcp_abduction=12.0, index_mcp_flexion=40.0, index_pip_flexion=70.0, index_dip_flexion=30.0)
    bends = np.deg2rad(np.cumsum([40.0, 70.0, 30.0]))
    joints = np.zeros((3, 3))
    joints[:, 1], joints[:, 2] = np.cumsum(lengths * np.cos(bends)), -np.cumsum(lengths * np.sin(bends))
    aside = Rotation.from_euler("z", 12.0, degrees=True)
    expected = knuckle + (aside * spread).apply(joints)
    positions, _ = bone_poses(hand, angles)
    assert positions[hand.bone("index_middle")] == pytest.approx(expected[0], abs=1e-6)
    assert positions[hand.bone("index_distal")] == pytest.approx(expected[1], abs=1e-6)
    beyond = landmark(hand, "index_tip", **angles) - positions[hand.bone("index_distal")]
    assert np.linalg.norm(beyond) == pytest.approx(lengths[2] + MEN.digits["index"].tip_m, abs=1e-9)


def test_flat_hand_has_straight_level_fingers(hand):
    flat = {joint.name: 0.0 for joint in hand.joints}
    for digit in DIGITS[1:]:
        heights = [landmark(hand, f"{digit}_tip", **flat)[2], hand.skeleton.landmarks[f"{digit}_knuckle"][2]]
        assert heights[0] == pytest.approx(heights[1], abs=1e-9)


@pytest.mark.parametrize("side", ["right", "left"])
def test_each_joint_moves_its_own_bones_the_right_way(side):
    hand = articulate(MEN.model_copy(update={"side": side}))
    ulnar = 1.0 if side == "right" else -1.0
    for joint in hand.joints:
        angles = {joint.name: joint.rest_deg + 5.0}
        rotations = bone_poses(hand, angles)[1]
        below = {joint.bone}
        for number, bone in enumerate(hand.bones):
            if bone.parent in below:
                below.add(number)
        turned = {b for b in range(len(hand.bones)) if abs(rotations[b] - np.eye(3)).max() > 1e-9}
        assert turned == below, joint.name
        digit = "middle" if joint.name.startswith("wrist") else joint.name.split("_")[0]
        move = landmark(hand, f"{digit}_tip", **angles) - hand.skeleton.landmarks[f"{digit}_tip"]
        if digit != "thumb" and joint.name.endswith("flexion"):
            assert move[2] < -1e-4, joint.name
        elif joint.name == "thumb_cmc_abduction":
            assert move[2] < -1e-3 and abs(move[2]) > 0.4 * np.linalg.norm(move)
        elif digit == "thumb":
            assert move[0] * ulnar > 1e-4, joint.name
        else:
            assert move[0] * (-ulnar if digit == "index" else ulnar) > 1e-3, joint.name


@pytest.mark.parametrize("integrator", ["mjINT_EULER", "mjINT_IMPLICITFAST"])
def test_stays_stable_through_a_sine_of_all_joints(integrator):
    model = mujoco.MjModel.from_xml_string(articulated_mjcf(MEN))
    model.opt.integrator = getattr(mujoco.mjtIntegrator, integrator)
    assert model.opt.timestep == 0.002
    data = mujoco.MjData(model)
    low, high = model.actuator_ctrlrange.T
    fastest = 0.0
    for step in range(500):
        data.mocap_pos[0] = [0.05 * np.sin(2 * np.pi * 0.002 * step), 0, 0.2]
        data.ctrl[:] = 0.5 * (low + high) + 0.25 * (high - low) * np.sin(2 * np.pi * 0.002 * step)
        mujoco.mj_step(model, data)
        fastest = max(fastest, np.abs(data.qvel).max())
    assert data.warning.number.sum() == 0 and data.time == pytest.approx(1.0)
    # The sine's own peak is 0.25 (high - low) 2 pi; the first step from rest to mid-range is faster.
    assert fastest < 200.0
    data.ctrl[:] = 0.0
    mujoco.mj_step(model, data, nstep=700)
    joints = [data.joint(j.name).qpos[0] for j in articulate(MEN).joints]
    assert np.abs(data.qvel).max() < 0.02 and joints == pytest.approx(np.zeros(22), abs=0.01)


def test_follows_its_target_and_turns_with_it(model):
    data = mujoco.MjData(model)
    data.mocap_pos[0], data.mocap_quat[0] = [0.1, -0.05, 0.25], [np.sqrt(0.5), 0, np.sqrt(0.5), 0]
    mujoco.mj_step(model, data, nstep=1000)
    assert data.body("forearm").xpos == pytest.approx([0.1, -0.05, 0.25], abs=1e-4)
    assert data.body("forearm").xmat.reshape(3, 3) == pytest.approx(
        Rotation.from_euler("y", 90, degrees=True).as_matrix(), abs=1e-3
    )


@pytest.mark.parametrize(
    ("angles", "words"),
    [
        ({"index_mcp": 10.0}, "'index_mcp' is unknown"),
        ({"index_pip_flexion": 101.0}, "index_pip_flexion is 101 degrees; use 0 to 100"),
        ({"thumb_ip_flexion": float("nan")}, "thumb_ip_flexion is nan"),
    ],
)
def test_wrong_angles_are_refused(hand, angles, words):
    with pytest.raises(SceneError, match=words):
        checked_angles(hand, angles)
