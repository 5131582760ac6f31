from dataclasses import replace

import foreign_hands
import mujoco
import numpy as np
import pytest
from scipy import sparse

from palmfield.hand.articulated import bone_poses
from palmfield.hand.chirality import way_from_wrist
from palmfield.hand.joint_tree import joined, named_side, words
from palmfield.hand.meshfile import examine, load_rigged
from palmfield.hand.poses import POSE_NAMES, named_pose, posed_surface
from palmfield.hand.preset import load_preset
from palmfield.hand.rigged import Joints, SkinRig
from palmfield.hand.rigged_mjcf import rigged_mjcf
from palmfield.hand.skinning import SkinnedHand, skinned_mesh
from palmfield.hand.triangles import unique_edges

NAMES = {
    "WebXR": foreign_hands.webxr_name,
    "OpenXR": foreign_hands.openxr_name,
    "camel": lambda _, name: "Left" + name.title().replace("-", ""),
}


@pytest.fixture(scope="module", params=NAMES)
def siblings(request, tmp_path_factory):
    """A file whose 25 joints stand side by side, and what their parents should be."""
    path = tmp_path_factory.mktemp("rig") / "siblings.glb"
    foreign_hands.sibling_rig(path, NAMES[request.param])
    return path, foreign_hands.webxr_joints()[3]


@pytest.mark.parametrize(
    "name, parts",
    [
        ("XR_HAND_JOINT_INDEX_PROXIMAL_EXT", ["xr", "hand", "joint", "index", "proximal", "ext"]),
        ("mixamorig:RightHandIndex1", ["mixamorig", "right", "hand", "index", "1"]),
        ("b_l_pinky0", ["b", "l", "pinky", "0"]),
        ("thumb_02_r", ["thumb", "02", "r"]),
    ],
)
def test_words_of_names(name, parts):
    assert words(name) == parts


def test_side_by_names():
    assert named_side(("hand_r", "index_01_r", "thumb_01_r", "root")) == "right"
    assert named_side(("LeftHand", "LeftHandIndex1")) == "left"
    assert named_side(("hand_r", "hand_l")) == named_side(("wrist", "ring")) == "unknown"


def test_names_make_the_tree_which_is_said(siblings):
    path, parents = siblings
    assert load_rigged(path).joints.parents.tolist() == parents
    (found,) = [finding for finding in examine(path).findings if finding.name == "sibling joints"]
    assert found.outcome == "repaired" and found.count == 24 and "by name" in found.text


def test_a_bent_index_finger_takes_its_own_skin_along_and_tears_none(tmp_path):
    path = tmp_path / "siblings.glb"
    foreign_hands.sibling_rig(path, foreign_hands.webxr_name)
    mesh = load_rigged(path)
    model = mujoco.MjModel.from_xml_string(rigged_mjcf(mesh, "mine"))
    data = mujoco.MjData(model)
    bodies = [model.body(name).id for name in mesh.joints.names]
    knuckle, tip = (mesh.joints.names.index(f"index-finger-{name}") for name in ("phalanx-proximal", "tip"))
    mujoco.mj_forward(model, data)
    start = data.xpos[bodies].copy()
    first = model.joint("index-finger-phalanx-proximal").qposadr[0]
    turned = np.deg2rad(60.0)
    # About the file's x axis, across the fingers: towards the palm
    data.qpos[first : first + 4] = [np.cos(turned / 2), -np.sin(turned / 2), 0.0, 0.0]
    mujoco.mj_forward(model, data)
    length = np.linalg.norm(start[tip] - start[knuckle])
    moved = np.linalg.norm(data.xpos[bodies[tip]] - start[tip])
    # The tip goes along a circle about the knuckle; the chord leaves out what of it lies along the axis
    along_x = data.xmat[bodies[0]].reshape(3, 3)[:, 0] @ (start[tip] - start[knuckle])
    assert moved == pytest.approx(2.0 * np.sin(turned / 2) * np.sqrt(length**2 - along_x**2), rel=1e-6)
    skin = skinned_mesh(mesh, mesh.joints.rest[0, :3, 3])
    posed = skin.posed(data.xpos[bodies], data.xmat[bodies].reshape(-1, 3, 3))
    edges, _ = unique_edges(skin.surface.faces)
    # Skin that the finger's bones alone carry turns with them in one piece
    finger = [n for n, name in enumerate(mesh.joints.names) if name.startswith("index-finger-phalanx")]
    edges = edges[(skin.weights[:, finger].sum(axis=1) > 1.0 - 1e-6)[edges].all(axis=1)]
    assert len(edges) > 200
    before, after = (np.linalg.norm(p[edges[:, 0]] - p[edges[:, 1]], axis=1) for p in (skin.surface.vertices, posed))
    assert np.abs(after - before).max() < 1e-6
    assert np.linalg.norm((posed - skin.surface.vertices)[edges], axis=2).max() > 0.03


POSED = [("open_men_p50", pose) for pose in POSE_NAMES] + [("open_women_p05", "relaxed"), ("open_women_p05", "point")]


@pytest.mark.parametrize("preset, pose", POSED)
def test_without_names_the_skin_makes_the_tree(preset, pose):
    hand = SkinnedHand(load_preset(preset), 0.004)
    surface = posed_surface(hand, named_pose(hand.hand, pose), 0.003)
    positions, _ = bone_poses(hand.hand, named_pose(hand.hand, pose))
    rest = np.tile(np.eye(4), (len(positions), 1, 1))
    rest[:, :3, 3] = positions
    names = tuple(f"bone.{number}" for number in range(len(positions)))
    rig = SkinRig(Joints(names, np.full(len(names), -1), rest), sparse.csr_array(hand.weights))
    got, moved, how = joined(rig, surface.vertices, way_from_wrist(surface.vertices, surface.faces))
    assert how == "skin" and len(moved) == len(names) - 1
    for bone, parent in zip(hand.bones, got.joints.parents.tolist(), strict=True):
        # The thumb's root and the fingers' ones may hang on the forearm in place of the hand: they carry skin of both.
        trunk = ("forearm", "hand")
        names_of = [hand.bones[i].name if i >= 0 else "" for i in (bone.parent, parent)]
        assert names_of[0] == names_of[1] or set(names_of) == set(trunk), (bone.name, names_of)


def test_a_tree_that_holds_together_stays(tmp_path):
    names, places, weights, parents = foreign_hands.webxr_joints()
    rest = np.tile(np.eye(4), (len(names), 1, 1))
    rest[:, :3, 3] = places
    vertices, faces = foreign_hands.plain_hand()
    way = way_from_wrist(vertices, faces)
    joints = Joints(tuple(names), np.array(parents, dtype=np.int32), rest)
    rig = SkinRig(joints, sparse.csr_array(weights))
    assert joined(rig, vertices, way)[2] == ""
    unnamed = replace(joints, names=tuple(f"b{n}" for n in range(len(names))))
    assert joined(replace(rig, joints=unnamed), vertices, way)[2] == ""


def test_numbers_that_run_backwards_are_not_taken_for_ranks(tmp_path):
    """Fingers numbered from the tip on: the skin is asked, and no finger hangs on its tip."""
    backwards = {"metacarpal": 4, "proximal": 3, "intermediate": 2, "distal": 1, "tip": 0}

    def renamed(_, name):
        digit = name.split("-")[0]
        return name if digit == "wrist" else f"{digit}{backwards[name.split('-')[-1]]}"

    path = tmp_path / "backwards.glb"
    foreign_hands.sibling_rig(path, renamed)
    (found,) = [finding for finding in examine(path).findings if finding.name == "sibling joints"]
    assert found.outcome == "noted" and "most skin" in found.text
    joints = load_rigged(path).joints
    for digit in ("index", "middle", "ring", "pinky"):
        assert joints.parents[joints.names.index(f"{digit}1")] == joints.names.index(f"{digit}2")
        assert joints.parents[joints.names.index(f"{digit}2")] == joints.names.index(f"{digit}3")
