import base64
import json
import os

import numpy as np
import pygltflib as g
import pytest
import trimesh
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from palmfield.errors import SceneError
from palmfield.hand.meshfile import load_mesh, load_rigged
from palmfield.hand.preset import load_preset
from palmfield.hand.surface import hand_surface

KINDS = {"f4": g.FLOAT, "u2": g.UNSIGNED_SHORT, "u1": g.UNSIGNED_BYTE, "u4": g.UNSIGNED_INT}
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class Builder:
    """A glTF file put together accessor by accessor."""

    def __init__(self):
        self.blob, self.views, self.accessors = b"", [], []

    def add(self, values, kind, normalized=False):
        values = np.asarray(values, dtype="<" + kind)
        values = values.reshape(len(values), -1)
        raw = values.tobytes()
        self.views.append(g.BufferView(buffer=0, byteOffset=len(self.blob), byteLength=len(raw)))
        self.blob += raw + b"\0" * (-len(raw) % 4)
        self.accessors.append(
            g.Accessor(
                bufferView=len(self.views) - 1,
                componentType=KINDS[kind],
                count=len(values),
                type=TYPES[values.shape[1]],
                normalized=normalized,
            )
        )
        return len(self.accessors) - 1

    def write(self, path, meshes, nodes, roots, skins=(), **more):
        scene = g.GLTF2(
            scene=0,
            scenes=[g.Scene(nodes=roots)],
            nodes=nodes,
            meshes=meshes,
            skins=list(skins),
            accessors=self.accessors,
            bufferViews=self.views,
            buffers=[g.Buffer(byteLength=len(self.blob))],
            **more,
        )
        scene.set_binary_blob(self.blob)
        if path.suffix == ".gltf":
            scene.convert_buffers(g.BufferFormat.DATAURI)
        scene.save(str(path))
        return path


def hand():
    surface = hand_surface(load_preset("open_men_p50"), 0.004).surface
    return surface.vertices, surface.faces


def rigged(path, weights_kind="f4", posed=0.0):
    """A hand in centimetres under an armature that is turned and scaled, split along its faces, with three joints.

    Returns the file and what it must give: vertices [m], weight of each joint, joint frames.
    """
    vertices, faces = hand()
    turn = Rotation.from_euler("x", -90.0, degrees=True)
    armature = np.eye(4)
    armature[:3, :3] = 0.01 * turn.as_matrix()
    local = 100.0 * vertices
    # wrist, knuckle, tip along y, in the armature's centimetres
    heights = np.array([-8.0, 2.0, 8.0])
    frames = np.tile(np.eye(4), (3, 1, 1))
    frames[:, 1, 3] = heights
    reach = np.abs(local[:, 1, None] - heights)
    weight = np.where(reach < 10.0, 10.0 - reach, 0.0) + 1e-3
    weight /= weight.sum(axis=1, keepdims=True)
    builder = Builder()
    soup = local[faces].reshape(-1, 3)
    of_soup = np.pad(weight[faces].reshape(-1, 3), ((0, 0), (0, 1)))
    if weights_kind == "u1":
        of_soup = np.round(255 * of_soup)
    attributes = g.Attributes(
        POSITION=builder.add(soup, "f4"),
        JOINTS_0=builder.add(np.tile([0, 1, 2, 0], (len(soup), 1)), "u1"),
        WEIGHTS_0=builder.add(of_soup, weights_kind, normalized=weights_kind == "u1"),
    )
    inverse = builder.add(np.linalg.inv(frames).transpose(0, 2, 1).reshape(3, 16), "f4")
    primitive = g.Primitive(attributes=attributes, indices=builder.add(np.arange(len(soup)), "u4"), mode=4)
    nodes = [
        g.Node(name="armature", rotation=turn.as_quat().tolist(), scale=[0.01] * 3, children=[1, 5]),
        g.Node(name="wrist", translation=[0.0, -8.0, 0.0], children=[2]),
        g.Node(name="helper", children=[3]),
        g.Node(name="knuckle", translation=[0.0, 10.0, 0.0], children=[4]),
        g.Node(name="tip", translation=[posed, 6.0, 0.0]),
        # A skinned mesh's own place does not count.
        g.Node(name="skin", mesh=0, skin=0, translation=[50.0, 0.0, 0.0]),
    ]
    skin = g.Skin(joints=[1, 3, 4], inverseBindMatrices=inverse)
    builder.write(path, [g.Mesh(primitives=[primitive])], nodes, [0], [skin])
    return vertices @ turn.as_matrix().T, weight, armature @ frames, turn.as_matrix()


def match(surface, expected):
    gap, index = cKDTree(expected).query(surface.vertices)
    assert gap.max() < 2e-7
    assert len(np.unique(index)) == len(expected) == len(surface.vertices)
    return index


@pytest.mark.smoke
@pytest.mark.parametrize("suffix, kind", [("glb", "f4"), ("gltf", "f4"), ("glb", "u1")])
def test_joints_and_weights_are_read_and_survive_the_merge(tmp_path, suffix, kind):
    path = tmp_path / f"hand.{suffix}"
    expected, weight, frames, _ = rigged(path, kind)
    got = load_rigged(path)
    index = match(got.surface, expected)
    assert got.joints.names == ("wrist", "knuckle", "tip")
    assert got.joints.parents.tolist() == [-1, 0, 1]
    np.testing.assert_allclose(got.joints.rest[:, :3, 3], frames[:, :3, 3], atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(got.joints.rest[:, :3, :3]), 1.0)
    dense = np.zeros((len(index), 3))
    np.add.at(dense, (np.arange(len(index))[:, None], got.indices), got.weights)
    np.testing.assert_allclose(dense, weight[index], atol=1e-6 if kind == "f4" else 1 / 255)
    assert trimesh.Trimesh(got.surface.vertices, got.surface.faces, process=False).is_watertight
    np.testing.assert_allclose(load_mesh(path, "auto").vertices, got.surface.vertices)


def test_the_pose_of_the_nodes_places_the_skin(tmp_path):
    path = tmp_path / "posed.glb"
    expected, weight, _, turn = rigged(path, posed=1.0)
    # The tip's joint stands 1 cm aside: each vertex follows by its weight.
    moved = expected + weight[:, 2:] * (turn @ [0.01, 0.0, 0.0])
    match(load_mesh(path, "auto"), moved)


def test_a_mesh_without_skin_is_placed_by_its_nodes_as_trimesh_does(tmp_path):
    vertices, faces = hand()
    path = tmp_path / "plain.glb"
    turn = trimesh.transformations.rotation_matrix(0.7, [1.0, 2.0, 3.0], [0.1, 0.0, 0.0])
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.Trimesh(vertices, faces, process=False), transform=turn)
    scene.export(path)
    match(load_mesh(path, "auto"), trimesh.transform_points(vertices, turn))
    with pytest.raises(SceneError, match="has no joints and weights"):
        load_rigged(path)


def test_glb_is_in_metres_unless_said(tmp_path):
    vertices, faces = hand()
    path = tmp_path / "mm.glb"
    trimesh.Trimesh(1e3 * vertices, faces, process=False).export(path)
    with pytest.raises(SceneError, match=r"long in unit m; .* in unit mm"):
        load_mesh(path, "auto")
    assert np.ptp(load_mesh(path, "mm").vertices[:, 1]) == pytest.approx(np.ptp(vertices[:, 1]), rel=1e-5)


def test_damaged_and_compressed_files(tmp_path):
    path = tmp_path / "hand.glb"
    rigged(path)
    whole = path.read_bytes()
    for cut in (0, 7, 30, 3000, len(whole) - 5000):
        path.write_bytes(whole[:cut])
        with pytest.raises(SceneError, match=r"cannot be read as glTF|ends early") as caught:
            load_mesh(path, "auto")
        assert "\n" not in str(caught.value)
    builder = Builder()
    points = builder.add(np.eye(3), "f4")
    node = [g.Node(mesh=0)]

    def mesh(mode=4, **names):
        return [g.Mesh(primitives=[g.Primitive(attributes=g.Attributes(**names), mode=mode)])]

    builder.write(path, mesh(1, POSITION=points), node, [0])
    with pytest.raises(SceneError, match="mode 1 is not supported"):
        load_mesh(path, "auto")
    builder.write(path, mesh(), node, [0])
    with pytest.raises(SceneError, match="no POSITION"):
        load_mesh(path, "auto")
    builder.write(path, mesh(POSITION=points), [g.Node(name="empty")], [0])
    with pytest.raises(SceneError, match="its scene has no mesh"):
        load_mesh(path, "auto")
    packed = ["KHR_draco_mesh_compression"]
    builder.write(path, mesh(POSITION=points), node, [0], extensionsRequired=packed, extensionsUsed=packed)
    with pytest.raises(SceneError, match="KHR_draco_mesh_compression, which is not supported"):
        load_mesh(path, "auto")


def box_of(path, weights=(), node_weights=(), targets=2, **accessor):
    """A box of 60 x 180 x 30 mm whose morph targets make it 40 mm longer and 20 mm wider; accessor: of its vertices."""
    box = trimesh.creation.box((0.06, 0.18, 0.03))
    longer, wider = np.zeros((8, 3)), np.zeros((8, 3))
    longer[box.vertices[:, 1] > 0, 1], wider[box.vertices[:, 0] > 0, 0] = 0.04, 0.02
    builder = Builder()
    place = builder.add(box.vertices, "f4")
    moves = [g.Attributes(POSITION=builder.add(move, "f4")) for move in (longer, wider)][:targets]
    for name, value in accessor.items():
        setattr(builder.views[0] if name == "byteStride" else builder.accessors[0], name, value)
    primitive = g.Primitive(attributes=g.Attributes(POSITION=place), indices=builder.add(box.faces.ravel(), "u2"),
                            targets=moves, mode=4)  # fmt: skip
    builder.write(path, [g.Mesh(primitives=[primitive], weights=list(weights))], [g.Node(mesh=0)], [0])
    if node_weights:
        content = json.loads(path.read_text())
        content["nodes"][0]["weights"] = list(node_weights)
        path.write_text(json.dumps(content))
    return path


@pytest.mark.parametrize(
    "weights, of_node, length_mm, width_mm",
    [((), (), 180, 60), ((0, 0), (), 180, 60), ((1, 0), (), 220, 60), ((0.5, 1), (), 200, 80), ((-0.5, 0), (), 160, 60),
     ((1, 0), (0, 1), 180, 80), ((), (1, 1), 220, 80)],
)  # fmt: skip
def test_default_weights_of_morph_targets_are_applied(tmp_path, weights, of_node, length_mm, width_mm):
    """Khronos glTF 2.0, 3.7.2.2: the node's weights before the mesh's, zeros without both."""
    mesh = load_mesh(box_of(tmp_path / "box.gltf", weights, of_node), "m")
    np.testing.assert_allclose(1e3 * np.ptp(mesh.vertices, axis=0), (width_mm, length_mm, 30), rtol=1e-5)


def test_weights_that_are_not_one_for_each_target_are_refused(tmp_path):
    with pytest.raises(SceneError, match="3 weights for 2 morph targets; give one weight per target"):
        load_mesh(box_of(tmp_path / "box.glb", (1, 0, 0)), "m")


@pytest.mark.parametrize("name", ["../secret.bin", "/etc/passwd", "%2e%2e/secret.bin", "link/../../secret.bin", "out"])
def test_buffers_outside_the_meshs_folder_are_not_opened(tmp_path, name):
    (tmp_path / "secret.bin").write_bytes(bytes(10_000))
    (tmp_path / "mesh").mkdir()
    (tmp_path / "mesh" / "out").symlink_to(tmp_path / "secret.bin")
    path = box_of(tmp_path / "mesh" / "box.gltf")
    content = json.loads(path.read_text())
    content["buffers"][0]["uri"] = name
    path.write_text(json.dumps(content))
    with pytest.raises(SceneError, match="outside the folder of the mesh; allowed: files in that"):
        load_mesh(path, "m")


def test_a_buffer_beside_the_mesh_is_read(tmp_path):
    path = box_of(tmp_path / "box.gltf")
    content = json.loads(path.read_text())
    data = base64.b64decode(content["buffers"][0]["uri"].partition(",")[2])
    (tmp_path / "parts of it.bin").write_bytes(data)
    content["buffers"][0]["uri"] = "parts%20of%20it.bin"
    path.write_text(json.dumps(content))
    assert np.ptp(load_mesh(path, "m").vertices[:, 1]) == pytest.approx(0.18)


@pytest.mark.parametrize(
    "fault",
    [{"count": -1}, {"count": 0}, {"count": 10**9}, {"byteOffset": -4000}, {"byteStride": 4}, {"byteStride": -12}],
)
def test_views_that_lead_out_of_a_buffer_are_refused(tmp_path, fault):
    with pytest.raises(SceneError, match=r"box\.glb"):
        load_mesh(box_of(tmp_path / "box.glb", **fault), "m")


def test_an_obj_opens_no_other_file(tmp_path):
    os.mkfifo(tmp_path / "pipe.mtl")  # opening it would never end
    text = trimesh.creation.box((0.06, 0.18, 0.03)).export(file_type="obj")
    (tmp_path / "box.obj").write_text("mtllib pipe.mtl\nusemtl skin\n" + text)
    assert len(load_mesh(tmp_path / "box.obj", "m").vertices) == 8
