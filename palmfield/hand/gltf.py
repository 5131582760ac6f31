"""Read glTF and GLB with joints and weights, which trimesh ignores (Khronos glTF 2.0, sections 3.6 and 3.7)."""

import json
from collections.abc import Callable
from pathlib import Path
from urllib.parse import unquote

import numpy as np
from pygltflib import GLTF2, Primitive
from scipy import sparse
from scipy.spatial.transform import Rotation

from palmfield.errors import SceneError, reason_of
from palmfield.files import plain, read_bytes
from palmfield.hand.rigged import Joints, SkinRig
from palmfield.types import Float, Int

TYPES = {5120: np.int8, 5121: np.uint8, 5122: np.int16, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
COLUMNS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
TRIANGLES = 4
MOST_VALUES = 10_000_000
"""Largest number of values in an accessor: 3 corners for each face that `palmfield.hand.meshfile` allows."""


def read_gltf(file: Path, check: Callable[[int], None]) -> tuple[Float, Int, SkinRig | None]:
    """Read vertices in the frame of the scene [m], shape (n, 3), faces, and the rig if the file has a skin.

    check: called with the number of faces before they are read; it may raise an error
    All meshes of the scene are joined. Skinned vertices are in the pose of the joints in the file (section 3.7.3.3).
    Raises SceneError for a file that is damaged, empty or compressed (Draco, meshopt), has lines or strips, or has
    several skins.
    """
    try:
        data = read_bytes(file)
        packed = file.suffix.lower() == ".glb"
        text = data[20 : 20 + int.from_bytes(data[12:16], "little")] if packed else data
        nodes = plain(json.loads, text).get("nodes", [])
        scene = GLTF2.load_from_bytes(data) if packed else GLTF2.gltf_from_json(data.decode())
        # pygltflib does not read the weights of nodes
        reader = _Reader(scene, file, [node.get("weights") for node in nodes])
        check(reader.triangles())
        return reader.read()
    except SceneError:
        raise
    # pygltflib and NumPy raise many kinds of exceptions for damaged files.
    except Exception as error:
        reason = reason_of(error, 120)
        raise SceneError(f"mesh {file} cannot be read as glTF ({reason}); export it again") from error


class _Reader:
    def __init__(self, scene: GLTF2, file: Path, weights: list[list[float] | None]) -> None:
        self.scene, self.file, self.weights = scene, file, weights
        packed = [name for name in scene.extensionsRequired or [] if "compression" in name or "quantization" in name]
        if packed:
            raise SceneError(
                f"mesh {file} needs the extension {packed[0]}, which is not supported; export it uncompressed"
            )
        self.buffers = [self._buffer(buffer.uri) for buffer in scene.buffers]
        self.parent: dict[int, int] = {
            child: index for index, node in enumerate(scene.nodes) for child in node.children or []
        }
        self.world: dict[int, Float] = {}

    def _buffer(self, uri: str | None) -> bytes:
        """Return the bytes of a buffer: from the file, an embedded text, or a file in the same folder or below."""
        if uri is None or uri.startswith("data:"):
            data: bytes | None = self.scene.get_data_from_buffer_uri(uri)
            return data or b""
        home = self.file.resolve().parent
        place = (home / unquote(uri)).resolve()
        if not place.is_relative_to(home):
            raise SceneError(
                f"mesh {self.file}: buffer '{uri}' is outside the folder of the mesh; allowed: files in that "
                "folder; or export a .glb"
            )
        return read_bytes(place)

    def triangles(self) -> int:
        """Return the number of faces of the meshes of the scene, from the counts of the accessors."""
        number = 0
        for i in self._in_scene():
            if self.scene.nodes[i].mesh is not None:
                for primitive in self.scene.meshes[self.scene.nodes[i].mesh].primitives:
                    position = getattr(primitive.attributes, "POSITION", None)
                    corners = position if primitive.indices is None else primitive.indices
                    number += 0 if corners is None else self.scene.accessors[corners].count // 3
        return number

    def read(self) -> tuple[Float, Int, SkinRig | None]:
        nodes = [i for i in self._in_scene() if self.scene.nodes[i].mesh is not None]
        skins = sorted({skin for i in nodes if (skin := self.scene.nodes[i].skin) is not None})
        if len(skins) > 1:
            raise SceneError(f"mesh {self.file} has {len(skins)} skins; export one hand with one armature")
        inverse = None
        if skins:
            skin = self.scene.skins[skins[0]]
            number = len(skin.joints)
            inverse = np.tile(np.eye(4), (number, 1, 1))
            if skin.inverseBindMatrices is not None:
                # Column-major in the file.
                inverse = self._accessor(skin.inverseBindMatrices).reshape(number, 4, 4).transpose(0, 2, 1)
        parts, faces, weights, start = [], [], [], 0
        for i in nodes:
            for primitive in self.scene.meshes[self.scene.nodes[i].mesh].primitives:
                points, corners, weight = self._primitive(primitive, i, inverse, skins)
                parts.append(points)
                faces.append(corners + start)
                weights.append(weight)
                start += len(points)
        if not parts:
            raise SceneError(f"mesh {self.file} is empty (its scene has no mesh); export it with its faces")
        rig = None
        if skins:
            rig = SkinRig(self._joints(self.scene.skins[skins[0]].joints), sparse.csr_array(np.concatenate(weights)))
        return np.concatenate(parts), np.concatenate(faces).astype(np.int32), rig

    def _primitive(
        self, primitive: Primitive, node: int, inverse: Float | None, skins: list[int]
    ) -> tuple[Float, Int, Float]:
        if primitive.mode not in (None, TRIANGLES):
            raise SceneError(
                f"mesh {self.file}: primitive mode {primitive.mode} is not supported; export triangles (mode 4)"
            )
        position = getattr(primitive.attributes, "POSITION", None)
        if position is None:
            raise SceneError(f"mesh {self.file}: a primitive has no POSITION; export it with its vertices")
        points = self._morphed(primitive, node, self._accessor(position).astype(np.float64))
        if primitive.indices is None:
            corners = np.arange(len(points))
        else:
            corners = self._accessor(primitive.indices)[:, 0].astype(np.int64)
        if self.scene.nodes[node].skin is None or inverse is None:
            matrix = self._world(node)
            if np.linalg.det(matrix[:3, :3]) < 0.0:
                corners = corners.reshape(-1, 3)[:, ::-1]
            width = 0 if inverse is None else len(inverse)
            weight = np.zeros((len(points), width))
            # A part without a skin is attached to the first joint.
            weight[:, :1] = 1.0
            return points @ matrix[:3, :3].T + matrix[:3, 3], corners.reshape(-1, 3).astype(np.int32), weight
        weight = self._weights(primitive, len(points), len(inverse))
        joints = self.scene.skins[skins[0]].joints
        matrices = np.stack([self._world(joint) for joint in joints]) @ inverse
        placed = np.einsum("nj,jab,nb->na", weight, matrices[:, :3], np.column_stack([points, np.ones(len(points))]))
        return placed, corners.reshape(-1, 3).astype(np.int32), weight

    def _morphed(self, primitive: Primitive, node: int, points: Float) -> Float:
        """Return vertices after morphing with the weights of the node, or else of the mesh (section 3.7.2.2)."""
        targets = primitive.targets or []
        mesh = self.scene.meshes[self.scene.nodes[node].mesh]
        weights = self.weights[node] or mesh.weights or [0.0] * len(targets)
        if len(weights) != len(targets):
            raise SceneError(
                f"mesh {self.file}: {len(weights)} weights for {len(targets)} morph targets; give one weight per "
                "target, or apply the targets in the modelling program"
            )
        for target, weight in zip(targets, weights, strict=True):
            moved = target.get("POSITION") if isinstance(target, dict) else getattr(target, "POSITION", None)
            if weight and moved is not None:
                points = points + float(weight) * self._accessor(moved)
        return points

    def _weights(self, primitive: Primitive, number: int, joints: int) -> Float:
        """Return the weight of each joint at each vertex, shape (number, joints); rows add up to 1."""
        out = np.zeros((number, joints))
        names = vars(primitive.attributes)
        for i in range(8):
            index, weight = names.get(f"JOINTS_{i}"), names.get(f"WEIGHTS_{i}")
            if index is None or weight is None:
                break
            at = self._accessor(index).astype(np.int64)
            if at.max() >= joints:
                raise SceneError(f"mesh {self.file}: a vertex names joint {at.max()} of {joints}; export it again")
            np.add.at(out, (np.arange(number)[:, None], at), self._accessor(weight).astype(np.float64))
        total = out.sum(axis=1)
        if (total <= 0.0).any():
            raise SceneError(
                f"mesh {self.file}: {int((total <= 0.0).sum())} of {number} vertices have no weights; bind them to "
                "joints"
            )
        return out / total[:, None]

    def _joints(self, nodes: list[int]) -> Joints:
        number = {node: i for i, node in enumerate(nodes)}
        parents = []
        for node in nodes:
            above = self.parent.get(node)
            while above is not None and above not in number:
                above = self.parent.get(above)
            parents.append(-1 if above is None else number[above])
        names = tuple(self.scene.nodes[node].name or f"joint_{i}" for i, node in enumerate(nodes))
        return Joints(names, np.array(parents, dtype=np.int32), np.stack([self._world(node) for node in nodes]))

    def _in_scene(self) -> list[int]:
        """Return the nodes of the default scene, parents first."""
        if not self.scene.scenes:
            return list(range(len(self.scene.nodes)))
        todo = list(self.scene.scenes[self.scene.scene or 0].nodes or [])
        out: list[int] = []
        while todo:
            node = todo.pop(0)
            out.append(node)
            todo += self.scene.nodes[node].children or []
            if len(out) > len(self.scene.nodes):
                raise SceneError(f"mesh {self.file}: its nodes form a cycle; export it again")
        return out

    def _world(self, index: int) -> Float:
        if index not in self.world:
            # A temporary value, so that the recursion ends in a cycle of nodes
            self.world[index] = np.eye(4)
            node = self.scene.nodes[index]
            if node.matrix:
                local = np.array(node.matrix, dtype=np.float64).reshape(4, 4).T
            else:
                local = np.eye(4)
                turn = Rotation.from_quat(node.rotation or [0.0, 0.0, 0.0, 1.0]).as_matrix()
                local[:3, :3] = turn * np.array(node.scale or [1.0, 1.0, 1.0])
                local[:3, 3] = node.translation or [0.0, 0.0, 0.0]
            above = self.parent.get(index)
            self.world[index] = local if above is None else self._world(above) @ local
        return self.world[index]

    def _accessor(self, index: int) -> np.ndarray:
        """Return the values of an accessor, shape (count, columns); normalised integers become floats."""
        accessor = self.scene.accessors[index]
        kind, columns = np.dtype(TYPES[accessor.componentType]).newbyteorder("<"), COLUMNS[accessor.type]
        if not 0 < accessor.count <= MOST_VALUES:
            raise SceneError(f"mesh {self.file}: an accessor has count {accessor.count}; allowed: 1 to {MOST_VALUES}")
        out = np.zeros((accessor.count, columns), dtype=kind)
        if accessor.bufferView is not None:
            out = self._view(accessor.bufferView, accessor.byteOffset or 0, accessor.count, columns, kind)
        # An accessor without sparse values has None or an empty record
        if accessor.sparse is not None and accessor.sparse.count:
            few = accessor.sparse
            at_kind = np.dtype(TYPES[few.indices.componentType]).newbyteorder("<")
            at = self._view(few.indices.bufferView, few.indices.byteOffset or 0, few.count, 1, at_kind)[:, 0]
            out = out.copy()
            out[at] = self._view(few.values.bufferView, few.values.byteOffset or 0, few.count, columns, kind)
        if accessor.normalized and kind.kind in "iu":
            return np.maximum(out.astype(np.float64) / float(2 ** (8 * kind.itemsize - (kind.kind == "i")) - 1), -1.0)
        return out

    def _view(self, index: int, offset: int, count: int, columns: int, kind: np.dtype) -> np.ndarray:
        view = self.scene.bufferViews[index]
        width = columns * kind.itemsize
        stride = view.byteStride or width
        first = (view.byteOffset or 0) + offset
        last = first + stride * (count - 1) + width
        data = self.buffers[view.buffer]
        if first < 0 or stride < width or count < 1:
            raise SceneError(
                f"mesh {self.file}: a view has offset {first}, stride {stride} and count {count}; allowed: 0 or more, "
                f"{width} or more, and 1 or more; export it again"
            )
        if last > len(data):
            raise SceneError(f"mesh {self.file} ends early: byte {last} of {len(data)} is needed; copy it again")
        raw = np.frombuffer(data, dtype=np.uint8)
        rows = np.lib.stride_tricks.as_strided(raw[first:], shape=(count, width), strides=(stride, 1))
        return np.ascontiguousarray(rows).view(kind).reshape(count, columns)
