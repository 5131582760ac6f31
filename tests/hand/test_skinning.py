import mujoco
import numpy as np
import pytest
from preset_mjcf import articulated_mjcf
from scipy.spatial.transform import Rotation

from palmfield.errors import SceneError
from palmfield.hand.articulated import bone_poses
from palmfield.hand.preset import load_preset, mirrored
from palmfield.hand.skinning import SkinnedHand, SMOOTHING_m
from palmfield.hand.triangles import vertex_normals

MEN = load_preset("open_men_p50")


@pytest.fixture(scope="module")
def hand():
    return SkinnedHand(MEN, 0.004)


def random_angles(hand, seed):
    rng = np.random.default_rng(seed)
    return {joint.name: rng.uniform(joint.low_deg, joint.high_deg) for joint in hand.hand.joints}


def with_skin(hand):
    """The hand's MJCF with MuJoCo's own skin of the same weights."""
    surface, parts = hand.surface, []
    for number, bone in enumerate(hand.hand.bones):
        held = np.flatnonzero(hand.weights[:, number])
        where = " ".join(f"{x:.9g}" for x in bone.origin)
        share = " ".join(f"{w:.9g}" for w in hand.weights[held, number])
        ids = " ".join(map(str, held))
        parts.append(
            f'<bone body="{bone.name}" bindpos="{where}" bindquat="1 0 0 0" vertid="{ids}" vertweight="{share}"/>'
        )
    vertices = " ".join(f"{x:.9g}" for x in surface.vertices.ravel())
    faces = " ".join(map(str, surface.faces.ravel()))
    skin = f'<deformable><skin name="s" vertex="{vertices}" face="{faces}">{"".join(parts)}</skin></deformable>'
    return articulated_mjcf(hand.hand.preset, skin=False).replace("</mujoco>", skin + "</mujoco>")


@pytest.mark.parametrize("side", ["right", "left"])
def test_equals_mujoco_own_skin(hand, side):
    skinned = hand if side == "right" else SkinnedHand(mirrored(MEN), 0.004)
    model = mujoco.MjModel.from_xml_string(with_skin(skinned))
    data, scene = mujoco.MjData(model), mujoco.MjvScene(model, maxgeom=200)
    option, camera = mujoco.MjvOption(), mujoco.MjvCamera()
    for seed in range(3):
        for name, angle in random_angles(skinned, seed).items():
            data.joint(name).qpos[0] = np.deg2rad(angle)
        data.qpos[:3] = [0.03, -0.02, 0.3]
        data.qpos[3:7] = Rotation.from_euler("xyz", [20.0, -30.0, 50.0 + seed], degrees=True).as_quat(scalar_first=True)
        mujoco.mj_kinematics(model, data)
        mujoco.mjv_updateScene(model, data, option, None, camera, mujoco.mjtCatBit.mjCAT_ALL, scene)
        theirs = np.array(scene.skinvert).reshape(-1, 3)
        bodies = [model.body(bone.name).id for bone in skinned.hand.bones]
        ours = skinned.posed(data.xpos[bodies], data.xmat[bodies].reshape(-1, 3, 3))
        assert np.abs(ours - skinned.surface.vertices).max() > 0.05
        assert np.abs(ours - theirs).max() < 1e-5


def test_rest_pose_is_the_surface_itself(hand):
    vertices = hand.posed(*bone_poses(hand.hand, {}))
    # float32 of 0.2 m
    assert np.abs(vertices - hand.surface.vertices).max() < 3e-8


def test_rigid_motion_keeps_shape(hand):
    turn = Rotation.from_euler("xyz", [40.0, 10.0, -70.0], degrees=True)
    shift = np.array([0.1, -0.2, 0.3])
    positions, rotations = bone_poses(hand.hand, {})
    moved = hand.posed(turn.apply(positions) + shift, turn.as_matrix() @ rotations)
    assert np.abs(moved - turn.apply(hand.surface.vertices) - shift).max() < 1e-7


def test_weights(hand):
    weights = hand.weights
    assert (weights >= 0.0).all() and weights.sum(axis=1) == pytest.approx(1.0, abs=1e-12)
    held = (weights > 0.0).sum(axis=1)
    assert held.max() <= 4 and held.min() >= 1
    vertices, marks = hand.surface.vertices, hand.hand.skeleton.landmarks
    for digit in ("thumb", "index", "middle", "ring", "little"):
        tip = np.argmin(np.linalg.norm(vertices - marks[f"{digit}_tip"], axis=1))
        assert weights[tip, hand.hand.bone(f"{digit}_distal")] > 0.95
    assert weights[np.argmin(vertices[:, 1]), hand.hand.bone("forearm")] > 0.95
    assert weights[np.argmin(np.linalg.norm(vertices, axis=1)), hand.hand.bone("hand")] > 0.8


def test_fingers_side_by_side_do_not_move_each_other(hand):
    # Skins of two fingers are a few millimetres apart through the air, but diffusion goes along the skin: 20 mm beyond
    # the web, less than exp(-20 mm / SMOOTHING_m) of a neighbour is left.
    far = hand.surface.vertices[:, 1] > hand.hand.skeleton.landmarks["index_knuckle"][1] + 0.045
    middle, index = (
        hand.weights[far][:, [hand.hand.bone(f"{digit}_{part}") for part in ("proximal", "middle", "distal")]].sum(
            axis=1
        )
        for digit in ("middle", "index")
    )
    assert far.sum() > 100 and (middle > 0.9).any() and (index > 0.9).any()
    assert np.minimum(middle, index).max() < np.exp(-0.020 / SMOOTHING_m)


def test_normals_are_those_of_the_posed_mesh(hand):
    posed = hand.posed_surface(*bone_poses(hand.hand, {"index_mcp_flexion": 50.0, "wrist_flexion": 30.0}))
    expected = vertex_normals(posed.vertices, posed.faces)
    assert np.einsum("ij,ij->i", posed.normals, expected).min() > np.cos(np.deg2rad(0.1))


def test_bending_the_index_finger_keeps_the_volume(hand):
    def volume(vertices):
        a, b, c = (vertices[hand.surface.faces[:, i]] for i in range(3))
        return np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0

    bent = hand.posed(*bone_poses(hand.hand, {"index_mcp_flexion": 45.0, "index_pip_flexion": 45.0}))
    assert volume(bent) == pytest.approx(volume(hand.surface.vertices), rel=0.01)


def test_wrong_number_of_bones_is_refused(hand):
    with pytest.raises(SceneError, match=r"give \(17, 3\) and \(17, 3, 3\)"):
        hand.posed(np.zeros((16, 3)), np.zeros((16, 3, 3)))
