"""A user's rigged glTF in a scene: its skin follows the bodies, the sound follows the skin and pushes the bones."""

import re
import sys
from pathlib import Path

import mujoco
import numpy as np
import pygltflib as g
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from palmfield.cli.app import main
from palmfield.drive.transducer_response import present_drive
from palmfield.errors import SceneError
from palmfield.hand.preset import load_preset
from palmfield.hand.rigged_mjcf import rigged_mjcf
from palmfield.hand.skinning import SkinnedHand, rigged_file
from palmfield.session.simulation import load

ARRAYS = Path(__file__).parent.parent.parent / "mjcf" / "arrays"
HANDS = ARRAYS.parent / "hands"
# glTF has y up: our palm looks down along -y there, and stands aside.
FILE_TURN = Rotation.from_euler("x", -90.0, degrees=True)
FILE_SHIFT = np.array([0.3, 1.2, -0.1])
BENDS_deg = {"index_mcp_flexion": 30.0, "index_pip_flexion": 40.0, "index_dip_flexion": 20.0}
SCENE = """
<mujoco>
  <include file="{arrays}/uhev1.xml"/>
  <include file="{hand}"/>
  <option timestep="0.001"/>
  <custom><text name="palmfield_device" data="cpu"/></custom>
  <extension>
    <plugin plugin="palmfield.array"><instance name="array">
      <config key="response" value="off"/>
    </instance></plugin>
    <plugin plugin="palmfield.stimulus"><instance name="stimulus">
      <config key="focus_m" value="{focus}"/><config key="modulation" value="none"/>
    </instance></plugin>
    <plugin plugin="palmfield.skin"><instance name="skin">
      {keys}<config key="patch_radius_m" value="0.006"/>
      <config key="material" value="finger_pad"/><config key="accuracy" value="0.2"/>
    </instance></plugin>
    <plugin plugin="palmfield.driver"><instance name="driver"><config key="board" value="ideal"/></instance></plugin>
  </extension>
</mujoco>
"""


def write_glb(path, hand):
    """The hand's skin on its bones as a GLB with one skin, under an armature that is turned and shifted."""
    joints = np.argsort(-hand.weights, axis=1)[:, :4]
    weights = np.take_along_axis(hand.weights, joints, axis=1)
    origins = np.array([bone.origin for bone in hand.bones])
    inverse = np.tile(np.eye(4), (len(origins), 1, 1))
    inverse[:, :3, 3] = -origins
    parts = [
        (hand.surface.vertices, "<f4", g.FLOAT, "VEC3"),
        (joints, "<u2", g.UNSIGNED_SHORT, "VEC4"),
        (weights, "<f4", g.FLOAT, "VEC4"),
        (hand.surface.faces.reshape(-1, 1), "<u4", g.UNSIGNED_INT, "SCALAR"),
        (inverse.transpose(0, 2, 1).reshape(-1, 16), "<f4", g.FLOAT, "MAT4"),
    ]
    blob, views, accessors = b"", [], []
    for number, (values, kind, component, shape) in enumerate(parts):
        raw = values.astype(kind).tobytes()
        views.append(g.BufferView(buffer=0, byteOffset=len(blob), byteLength=len(raw)))
        accessors.append(g.Accessor(bufferView=number, componentType=component, count=len(values), type=shape))
        blob += raw
    nodes = [g.Node(name="armature", rotation=FILE_TURN.as_quat().tolist(), translation=FILE_SHIFT.tolist())]
    nodes[0].children = [1, len(origins) + 1]
    for number, bone in enumerate(hand.bones):
        base = np.zeros(3) if bone.parent < 0 else origins[bone.parent]
        children = [i + 1 for i, other in enumerate(hand.bones) if other.parent == number]
        nodes.append(g.Node(name=bone.name, translation=(bone.origin - base).tolist(), children=children))
    nodes.append(g.Node(name="skin", mesh=0, skin=0))
    attributes = g.Attributes(POSITION=0, JOINTS_0=1, WEIGHTS_0=2)
    scene = g.GLTF2(
        scene=0, scenes=[g.Scene(nodes=[0])], nodes=nodes, accessors=accessors, bufferViews=views,
        meshes=[g.Mesh(primitives=[g.Primitive(attributes=attributes, indices=3, mode=4)])],
        skins=[g.Skin(joints=list(range(1, len(origins) + 1)), inverseBindMatrices=4)],
        buffers=[g.Buffer(byteLength=len(blob))],
    )  # fmt: skip
    scene.set_binary_blob(blob)
    scene.save(str(path))


def config(**keys):
    return "".join(f'<config key="{key}" value="{value}"/>' for key, value in keys.items())


def bend_hinges(data):
    for name, angle in BENDS_deg.items():
        data.joint(name).qpos[0] = np.deg2rad(angle)
    mujoco.mj_forward(data.model, data)


def bend_balls(data, hand):
    """The pose of `bend_hinges`, with the bodies' axes parallel to the file's."""
    for joint in hand.hand.joints:
        if joint.name in BENDS_deg:
            turned = np.deg2rad(BENDS_deg[joint.name] - joint.rest_deg) * FILE_TURN.apply(joint.axis)
            data.joint(hand.bones[joint.bone].name).qpos[:] = Rotation.from_rotvec(turned).as_quat(scalar_first=True)
    mujoco.mj_forward(data.model, data)


@pytest.fixture(scope="module")
def hand():
    return SkinnedHand(load_preset("open_men_p50"))


@pytest.fixture(scope="module")
def rest(tmp_path_factory, hand):
    """Folder with hand.glb and the MJCF of its bodies."""
    folder = tmp_path_factory.mktemp("rigged")
    write_glb(folder / "hand.glb", hand)
    mesh = rigged_file(str(folder / "hand.glb"), "m")
    (folder / "hand.xml").write_text(rigged_mjcf(mesh, "hand"))
    return folder


RIGGED = dict(shape="rigged", body="hand", mesh="hand.glb", mesh_unit="m", patch_site="index_distal_pad")


def loaded(folder, name, focus="0 0 0.2", hand="hand.xml", **keys):
    path = folder / f"{name}.xml"
    given = config(**{key: value for key, value in keys.items() if value})
    path.write_text(SCENE.format(arrays=ARRAYS, hand=hand, focus=focus, keys=given))
    return load(path)


@pytest.fixture(scope="module")
def pair(rest, hand):
    """Scenes of the articulated hand and of the rigged one, in the same bent pose, focus on the bent fingertip."""
    plain = mujoco.MjModel.from_xml_path(str(HANDS / "articulated_men_p50.xml"))
    bent = mujoco.MjData(plain)
    bend_hinges(bent)
    focus = " ".join(f"{x:.6f}" for x in bent.site("index_pad").xpos)
    # Each face is a sample: with fewer, those at joints push other bones where weights differ in the last digits
    keys = dict(shape="articulated", patch_site="index_pad", force_accuracy=0.004)
    articulated = loaded(rest, "articulated", focus, HANDS / "articulated_men_p50.xml", **keys)
    bend_hinges(articulated.data)
    rigged = loaded(rest, "rigged", focus, **(RIGGED | {"force_accuracy": 0.004}))
    rigged.data.qpos[:3] = articulated.data.body("forearm").xpos
    rigged.data.qpos[3:7] = FILE_TURN.inv().as_quat(scalar_first=True)
    bend_balls(rigged.data, hand)
    return articulated, rigged


def body_of(scene):
    """The hand's body as it is posed, and the frame of the first array in the world."""
    posed = scene.runtime.posed
    return posed.bodies[0], posed.array_frame


def world_skin(scene):
    """Posed vertices of a scene's surface [m], shape (n, 3), in world axes."""
    position, turn = scene.data.body("hand").xpos, scene.data.body("hand").xmat.reshape(3, 3)
    return body_of(scene)[0].vertices @ turn.T + position


def sound_on(scene, points, normals):
    """ARP [Pa] at world points."""
    posed, course = scene.runtime.now()
    drive, factor = present_drive(course)
    frame = posed.array_frame
    places, outward = frame.inverse_points(points), frame.inverse_vectors(normals)
    return factor * scene.runtime.work.radiation.at(posed, 0, "vertices", places, outward, drive).arp


def samples(scene):
    """Middles [m] of the posed skin's faces, normals and areas [m^2], world axes, and their corners."""
    vertices, faces = world_skin(scene), body_of(scene)[0].model.surface.faces
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = 0.5 * np.linalg.norm(cross, axis=1)
    return corners.mean(axis=1), cross / (2.0 * areas[:, None]), areas, faces


def test_posed_skin_is_the_linear_blend_of_the_bodies(pair, hand):
    _, rigged = pair
    data = rigged.data
    places = data.xpos[[data.model.body(bone.name).id for bone in hand.bones]]
    turns = data.xmat[[data.model.body(bone.name).id for bone in hand.bones]].reshape(-1, 3, 3)
    rest = FILE_TURN.apply(hand.surface.vertices)
    origins = FILE_TURN.apply([bone.origin for bone in hand.bones])
    expected = np.zeros_like(rest)
    for bone in range(len(hand.bones)):
        moved = (rest - origins[bone]) @ turns[bone].T + places[bone]
        expected += hand.weights[:, bone, None] * moved
    # Reading merges and mends, which may change the order, and halves long edges, which adds vertices.
    surface = body_of(rigged)[0].model.surface.vertices
    gap, same = cKDTree(surface).query(rest)
    assert gap.max() < 2e-7 and len(np.unique(same)) == len(rest)
    found = world_skin(rigged)
    hand_body = data.body("hand")
    stiff = surface @ hand_body.xmat.reshape(3, 3).T + hand_body.xpos
    assert np.linalg.norm(found - stiff, axis=1).max() > 0.04
    assert np.abs(found[same] - expected).max() < 1e-6


def test_sound_on_a_bent_fingertip_is_that_of_the_articulated_hand(pair):
    articulated, rigged = pair
    a, b = world_skin(articulated), world_skin(rigged)
    gap, same = cKDTree(b).query(a)
    assert gap.max() < 2e-6
    down = np.tile([0.0, 0.0, -1.0], (len(a), 1))
    expected, found = sound_on(articulated, a, down), sound_on(rigged, b[same], down)
    assert expected.max() > 5.0
    assert np.abs(found - expected).max() < 0.01 * expected.max()
    # The loudest place is the fingertip where it is now.
    tip = rigged.data.body("index_distal").xpos
    assert np.linalg.norm(b[np.argmax(sound_on(rigged, b, np.tile([0.0, 0.0, -1.0], (len(b), 1))))] - tip) < 0.025


def test_sound_pushes_the_bones(pair, hand):
    articulated, rigged = pair
    distal = hand.hand.bone("index_distal")
    expected, found = articulated.runtime.body_forces()[0][0], rigged.runtime.body_forces()[0][0]
    assert np.linalg.norm(expected[distal]) > 2e-4
    assert np.abs(found - expected).max() < 0.02 * np.linalg.norm(expected[distal])
    # The torque that reaches the ball joint, by hand, in the bone's axes.
    points, normals, areas, faces = samples(rigged)
    of_bone = body_of(rigged)[0].model.hand.weights[faces].mean(axis=1).argmax(axis=1) == distal
    push = -(sound_on(rigged, points, normals) * areas)[:, None] * normals
    data = rigged.data
    arm = points - data.body("index_distal").xpos
    torque = data.body("index_distal").xmat.reshape(3, 3).T @ np.cross(arm, push)[of_bone].sum(axis=0)
    here = slice(*(data.model.joint("index_distal").dofadr[0] + np.array([0, 3])))
    applied = (data.qfrc_passive - data.qfrc_spring - data.qfrc_damper - data.qfrc_gravcomp)[here]
    assert np.linalg.norm(torque) > 1e-6
    np.testing.assert_allclose(applied, torque, atol=1e-3 * np.linalg.norm(torque))


def test_sound_bends_the_finger_that_it_is_on(rest):
    plain = mujoco.MjModel.from_xml_path(str(rest / "hand.xml"))
    before = mujoco.MjData(plain)
    mujoco.mj_forward(plain, before)
    for digit in ("index", "little"):
        pad, tip = f"{digit}_distal_pad", f"{digit}_distal_tip"
        focus = " ".join(f"{x:.6f}" for x in before.site(pad).xpos)
        scene = loaded(rest, digit, focus, **(RIGGED | {"patch_site": pad}))
        scene.step(20)
        turned = {d: np.linalg.norm(scene.data.joint(f"{d}_distal").qpos[1:]) for d in ("index", "middle", "little")}
        assert max(turned, key=lambda d: turned[d]) == digit
        assert scene.data.site(tip).xpos[2] > before.site(tip).xpos[2] + 1e-6


def refused(rest, match, **keys):
    with pytest.raises(SceneError, match=match) as caught:
        loaded(rest, "bad", **(RIGGED | keys))
    assert "\n" not in str(caught.value)


def test_bodies_that_are_missing_or_misplaced_are_named(rest):
    text = (rest / "hand.xml").read_text()
    (rest / "lost.xml").write_text(text.replace('"ring_middle"', '"ring_center"'))
    refused(rest, "shape' has value 'rigged': the scene has no body 'ring_middle' .*; it has: ", hand="lost.xml")
    allowed = r"allowed with shape 'rigged': \[prefix\] and joint: forearm, hand, "
    refused(rest, f"key 'body': 'hand_target' does not end with the name of a joint; {allowed}", body="hand_target")
    prefixed = re.sub('(name|body|body1|body2)="', r'\1="left_', text)
    (rest / "left_hand.xml").write_text(prefixed)
    left = dict(hand="left_hand.xml", body="left_hand", patch_site="left_index_distal_pad")
    assert len(loaded(rest, "left", **(RIGGED | left)).runtime.parts[0]) == 17
    (rest / "left_hand.xml").write_text(prefixed.replace('"left_forearm"', '"forearm"'))
    refused(rest, "the scene has no body 'left_forearm'", **left)
    refused(rest, "shape 'rigged' needs mesh_unit for '.*hand.obj': only .glb, ", mesh="hand.obj", mesh_unit="")
    place = text.split('<body name="ring_middle" pos="')[1].split('"')[0]
    moved = " ".join(f"{float(x) + 0.001:.9g}" for x in place.split())
    (rest / "moved.xml").write_text(
        text.replace(f'name="ring_middle" pos="{place}"', f'name="ring_middle" pos="{moved}"')
    )
    refused(
        rest,
        "body 'ring_middle' is 1.73 mm and 0 degrees away from the joint of the mesh; write its MJCF",
        hand="moved.xml",
    )
    turned = text.replace('<body name="thumb_distal"', '<body name="thumb_distal" euler="0 0 2"')
    (rest / "turned.xml").write_text(turned)
    refused(rest, "body 'thumb_distal' is .* mm and 2 degrees away", hand="turned.xml")


def test_command_writes_the_bodies(rest, hand, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["palmfield", "hand", str(rest / "hand.glb"), "--mjcf", str(rest / "again.xml")])
    with pytest.raises(SystemExit) as stop:
        main()
    assert stop.value.code in (None, 0)
    assert (rest / "again.xml").read_text() == (rest / "hand.xml").read_text()
    assert f"wrote {rest / 'again.xml'}" in capsys.readouterr().out
