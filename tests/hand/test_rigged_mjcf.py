from dataclasses import replace

import mujoco
import numpy as np
import pytest
import trimesh
from scipy import sparse
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from palmfield.errors import SceneError
from palmfield.hand.mjcf_text import DENSITY_kg_m3
from palmfield.hand.preset import load_preset, mirrored
from palmfield.hand.rigged import Joints, RiggedMesh, joint_of_body, strongest
from palmfield.hand.rigged_mjcf import rigged_mjcf
from palmfield.hand.skinning import SkinnedHand, skinned_mesh
from palmfield.types import Surface

TURN = Rotation.from_euler("xyz", [-90.0, 25.0, 10.0], degrees=True)
SHIFT = np.array([0.3, 1.2, -0.1])


def mesh_of(hand):
    """A parametric hand as a user's file has it: in axes of its own, far from the origin."""
    surface = Surface(TURN.apply(hand.surface.vertices) + SHIFT, hand.surface.faces, TURN.apply(hand.surface.normals))
    rest = np.tile(np.eye(4), (len(hand.bones), 1, 1))
    rest[:, :3, :3] = Rotation.random(len(rest), rng=np.random.default_rng(2)).as_matrix()
    rest[:, :3, 3] = TURN.apply([bone.origin for bone in hand.bones]) + SHIFT
    names = tuple(bone.name for bone in hand.bones)
    joints = Joints(names, np.array([bone.parent for bone in hand.bones], dtype=np.int32), rest)
    return RiggedMesh(surface, joints, *strongest(sparse.csr_array(hand.weights)))


@pytest.fixture(scope="module")
def hand():
    return SkinnedHand(load_preset("open_men_p50"), 0.004)


@pytest.fixture(scope="module")
def mesh(hand):
    return mesh_of(hand)


@pytest.fixture(scope="module")
def model(mesh):
    return mujoco.MjModel.from_xml_string(rigged_mjcf(mesh, "mine"))


def at_rest(model):
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return data


def in_file(data, mesh, points):
    """World points in the file's frame."""
    root = data.body(mesh.joints.names[0])
    return (points - root.xpos) @ root.xmat.reshape(3, 3) + mesh.joints.rest[0, :3, 3]


def test_bodies_are_the_joints_in_the_pose_of_the_file(mesh, model):
    data = at_rest(model)
    bodies = [model.body(name).id for name in mesh.joints.names]
    assert in_file(data, mesh, data.xpos[bodies]) == pytest.approx(mesh.joints.rest[:, :3, 3], abs=1e-8)
    turns = data.xmat[bodies].reshape(-1, 3, 3)
    assert turns == pytest.approx(np.broadcast_to(turns[0], turns.shape), abs=1e-9)
    for number, parent in enumerate(mesh.joints.parents):
        expected = "world" if parent < 0 else mesh.joints.names[parent]
        assert model.body(model.body_parentid[bodies[number]]).name == expected
    assert sum(kind == mujoco.mjtJoint.mjJNT_BALL for kind in model.jnt_type) == 16
    assert model.joint(mesh.joints.names[0]).type[0] == mujoco.mjtJoint.mjJNT_FREE
    assert model.body("hand_target").mocapid[0] == 0 and model.neq == 1


def test_palm_looks_down_and_fingers_along_y(hand, mesh, model):
    data = at_rest(model)
    root = data.body("forearm").xmat.reshape(3, 3)
    # The parametric hand's own axes are the right ones; the estimate from the shape alone may be some degrees off.
    off = Rotation.from_matrix(root @ TURN.as_matrix()).magnitude()
    assert np.rad2deg(off) < 12.0
    skin = (mesh.surface.vertices - mesh.joints.rest[0, :3, 3]) @ root.T + data.body("forearm").xpos
    assert skin[:, 2].min() == pytest.approx(0.2, abs=1e-8)
    assert skin[:, :2].min(axis=0) == pytest.approx(-skin[:, :2].max(axis=0), abs=1e-8)
    marks = hand.hand.skeleton.landmarks
    for digit in ("thumb", "index", "middle", "ring", "little"):
        tip = in_file(data, mesh, data.site(f"{digit}_distal_tip").xpos)
        pad = in_file(data, mesh, data.site(f"{digit}_distal_pad").xpos)
        assert np.linalg.norm(tip - SHIFT - TURN.apply(marks[f"{digit}_tip"])) < 0.008
        assert np.linalg.norm(pad - SHIFT - TURN.apply(marks[f"{digit}_pad"])) < 0.012
        assert min(np.linalg.norm(mesh.surface.vertices - point, axis=1).min() for point in (tip, pad)) < 1e-8


def test_unknown_side_keeps_the_axes_of_the_file(mesh):
    # A flat plate of skin on two joints is no hand of either side.
    plate = trimesh.creation.box([0.08, 0.18, 0.02]).subdivide_to_size(0.01)
    along = np.clip(plate.vertices[:, 1:2] / 0.04 + 0.5, 0.0, 1.0)
    weights = np.pad(np.hstack([1.0 - along, along]), ((0, 0), (0, 2)))
    rest = np.tile(np.eye(4), (3, 1, 1))
    rest[:, 1, 3] = [-0.08, 0.0, 0.09]
    surface = Surface(np.array(plate.vertices), np.array(plate.faces, dtype=np.int32), np.array(plate.vertex_normals))
    joints = Joints(("root", "flap", "end"), np.array([-1, 0, 1], dtype=np.int32), rest)
    indices = np.tile(np.array([0, 1, 0, 0], dtype=np.int32), (len(weights), 1))
    model = mujoco.MjModel.from_xml_string(rigged_mjcf(RiggedMesh(surface, joints, weights, indices), "plate"))
    assert model.body("root").quat == pytest.approx([1.0, 0.0, 0.0, 0.0])
    assert [model.site(i).name for i in range(model.nsite)] == ["flap_tip"]
    # The end carries no skin: it is rigid, and has no mass.
    assert model.njnt == 2 and model.body("end").mass[0] == 0.0 and model.body("flap").mass[0] > 0.0
    assert model.body_mass.sum() == pytest.approx(DENSITY_kg_m3 * 0.08 * 0.18 * 0.02, rel=1e-6)


def test_mass_is_that_of_the_skin_s_volume(mesh, model):
    volume = trimesh.Trimesh(mesh.surface.vertices, mesh.surface.faces, process=False).volume
    assert model.body_mass.sum() == pytest.approx(DENSITY_kg_m3 * volume, rel=1e-6)
    assert (model.body_mass[2:] > 1e-3).all()


def winding(vertices, faces, points):
    """How often a closed mesh goes round each point (van Oosterom & Strackee 1983): 1 within, 0 outside."""
    a, b, c = (vertices[faces[:, i]] - points[:, None] for i in range(3))
    la, lb, lc = (np.linalg.norm(x, axis=2) for x in (a, b, c))
    above = np.einsum("pfi,pfi->pf", a, np.cross(b, c))
    below = la * lb * lc + (a * b).sum(2) * lc + (b * c).sum(2) * la + (c * a).sum(2) * lb
    return np.arctan2(above, below).sum(axis=1) / (2.0 * np.pi)


def test_capsules_lie_along_the_bones_within_the_skin(mesh, model):
    data = at_rest(model)
    tree = cKDTree(mesh.surface.vertices)
    for geom in range(model.ngeom):
        axis = data.geom_xmat[geom].reshape(3, 3)[:, 2]
        steps = np.linspace(-1.0, 1.0, 5)[:, None] * model.geom_size[geom, 1] * axis
        points = in_file(data, mesh, data.geom_xpos[geom] + steps)
        assert winding(mesh.surface.vertices, mesh.surface.faces, points[1:-1]) == pytest.approx(1.0, abs=1e-6)
        assert 0.7 * tree.query(points[2])[0] < model.geom_size[geom, 0] < 0.04
    # The middle finger's middle bone, from the joint to the next one.
    bone = hand_bone(model, "middle_middle")
    length = np.linalg.norm(data.body("middle_distal").xpos - data.body("middle_middle").xpos)
    assert 2.0 * model.geom_size[bone, 1] == pytest.approx(length, abs=0.003)


def hand_bone(model, name):
    return int(np.flatnonzero(model.geom_bodyid == model.body(name).id)[0])


def test_keeps_its_pose_and_yields_a_little(mesh, model):
    data = at_rest(model)
    start = data.qpos.copy()
    assert data.ncon == 0
    for _ in range(100):
        mujoco.mj_step(model, data)
    assert np.abs(data.qpos - start).max() < 1e-6
    for digit in ("thumb", "index", "middle", "ring", "little"):
        data = at_rest(model)
        site, body = data.site(f"{digit}_distal_tip"), model.body(f"{digit}_distal").id
        before = site.xpos.copy()
        for _ in range(250):
            data.qfrc_applied[:] = 0.0
            mujoco.mj_applyFT(model, data, [0.0, 0.0, 0.01], np.zeros(3), site.xpos, body, data.qfrc_applied)
            mujoco.mj_step(model, data)
        assert 1e-5 < np.linalg.norm(site.xpos - before) < 5e-4


def test_each_joint_alone_swings_at_25_Hz(model):
    # Held by hand at one joint: a free pendulum of all that hangs on the knuckle, by MuJoCo's own mass matrix.
    data = at_rest(model)
    matrix = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, matrix)
    for name in ("hand", "index_proximal", "thumb_distal"):
        joint = model.joint(name)
        here = slice(joint.dofadr[0], joint.dofadr[0] + 3)
        inertia = np.linalg.eigvalsh(matrix[here, here])[-1]
        assert np.sqrt(joint.stiffness[0] / inertia) == pytest.approx(2.0 * np.pi * 25.0, rel=1e-6)
        assert model.dof_damping[here] == pytest.approx(2.0 * np.sqrt(joint.stiffness[0] * inertia), rel=1e-6)


def test_follows_its_target_without_ringing_at_2_ms(model):
    assert model.opt.timestep == 0.002
    data = at_rest(model)
    place, turn = data.mocap_pos[0].copy(), Rotation.from_quat(data.mocap_quat[0], scalar_first=True)
    for step in range(500):
        swing = np.sin(2.0 * np.pi * 0.002 * step)
        data.mocap_pos[0] = place + swing * np.array([0.05, 0.0, 0.03])
        data.mocap_quat[0] = (Rotation.from_rotvec(swing * np.array([0.3, 0.5, 0.2])) * turn).as_quat(scalar_first=True)
        mujoco.mj_step(model, data)
    for _ in range(250):
        mujoco.mj_step(model, data)
    assert data.warning.number.sum() == 0
    assert np.abs(data.qvel).max() < 0.05
    assert data.body("forearm").xpos == pytest.approx(data.mocap_pos[0], abs=1e-4)


def test_left_hand_and_other_names(hand):
    left = mesh_of(SkinnedHand(mirrored(load_preset("open_men_p50")), 0.004))
    joints = replace(left.joints, names=tuple(f'mixamo:<{name}> "L"' for name in left.joints.names))
    text = rigged_mjcf(replace(left, joints=joints), "left")
    assert "Side: left" in text
    model = mujoco.MjModel.from_xml_string(text)
    assert model.body('mixamo:<index_distal> "L"').id > 0


def test_joints_in_any_order_and_further_roots(mesh):
    order = np.random.default_rng(0).permutation(17)
    back = np.argsort(order)
    old = mesh.joints
    parents = np.where(old.parents < 0, -1, back[old.parents])[order].astype(np.int32)
    shuffled = Joints(tuple(old.names[i] for i in order), parents, old.rest[order])
    model = mujoco.MjModel.from_xml_string(
        rigged_mjcf(replace(mesh, joints=shuffled, indices=back[mesh.indices].astype(np.int32)), "shuffled")
    )
    twin = mujoco.MjModel.from_xml_string(rigged_mjcf(mesh, "plain"))
    for name in old.names:
        assert model.body(name).mass == pytest.approx(twin.body(name).mass, rel=1e-9)
        assert model.body(name).ipos == pytest.approx(twin.body(name).ipos, abs=1e-9)
    cut = parents.copy()
    cut[shuffled.names.index("thumb_metacarpal")] = -1
    text = rigged_mjcf(
        replace(mesh, joints=replace(shuffled, parents=cut), indices=back[mesh.indices].astype(np.int32)), "cut"
    )
    roots = [shuffled.names[i] for i in np.flatnonzero(cut < 0)]
    model = mujoco.MjModel.from_xml_string(text)
    assert model.body(model.body(roots[1]).parentid[0]).name == roots[0]


@pytest.mark.parametrize(
    "name, reason", [("index_distal", "names 2 joints"), ("hand_target", "is a reserved name in this file")]
)
def test_names_that_cannot_be_bodies(mesh, name, reason):
    joints = replace(mesh.joints, names=(*mesh.joints.names[:-1], name))
    with pytest.raises(SceneError, match=f"'{name}' {reason}; rename the joint"):
        rigged_mjcf(replace(mesh, joints=joints), "bad")


def test_bodies_and_joints_by_name(mesh):
    assert joint_of_body("hand", mesh.joints) == (1, "")
    assert joint_of_body("left_forearm", mesh.joints) == (0, "left_")
    with pytest.raises(SceneError, match=r"^'paw' does not end with .*; allowed with shape 'rigged': \[prefix\]"):
        joint_of_body("paw", mesh.joints)


def test_frame_of_the_skin_may_be_any_joint(mesh):
    origin = mesh.joints.rest[5, :3, 3]
    skin = skinned_mesh(mesh, origin)
    assert skin.bones[5].origin == pytest.approx(np.zeros(3))
    places = np.array([bone.origin for bone in skin.bones])
    away = np.array([0.1, 0.0, 0.0])
    posed = skin.posed(places + away, np.tile(np.eye(3), (len(places), 1, 1)))
    assert posed == pytest.approx(mesh.surface.vertices - origin + away, abs=1e-7)


def test_a_rig_of_two_joints_is_skinned(mesh):
    joints = Joints(mesh.joints.names[:2], mesh.joints.parents[:2], mesh.joints.rest[:2])
    share = np.linspace(0.0, 1.0, len(mesh.weights))
    weights = np.column_stack([share, 1.0 - share, 0.0 * share, 0.0 * share])
    indices = np.tile(np.array([0, 1, 0, 0], dtype=np.int32), (len(weights), 1))
    skin = skinned_mesh(RiggedMesh(mesh.surface, joints, weights, indices), np.zeros(3))
    places = np.array([bone.origin for bone in skin.bones])
    posed = skin.posed(places + np.array([[0.0, 0.0, 0.0], [0.0, 0.01, 0.0]]), np.tile(np.eye(3), (2, 1, 1)))
    moved = np.column_stack([0.0 * share, 0.01 * (1.0 - share), 0.0 * share])
    # float32 of 1.3 m
    assert posed == pytest.approx(mesh.surface.vertices + moved, abs=4e-7)
