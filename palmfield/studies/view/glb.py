"""Write a mesh with vertex colours as a GLB file. It is fast enough for many files per second."""

import json
import struct

import numpy as np
from numpy.typing import NDArray

from palmfield.outputs.style import linear_rgb
from palmfield.types import Float32, Int

JSON_CHUNK, BINARY_CHUNK = 0x4E4F534A, 0x004E4942
FLOAT, UINT8, UINT32 = 5126, 5121, 5125
VERTEX_BUFFER, INDEX_BUFFER = 34962, 34963
FAR_M = 10.0
"""Bounds of the vertices that the file head states [m]. The head is made once, before the vertices are computed."""


class GlbMesh:
    """Triangles whose vertices move and change colour. Its files differ only in these numbers."""

    def __init__(self, faces: Int, vertices: int) -> None:
        """faces: shape (m, 3); vertices: their number"""
        self._count = vertices
        self._indices = np.ascontiguousarray(faces, np.uint32).tobytes()
        places, colours = 12 * vertices, 4 * vertices
        views = [
            {"buffer": 0, "byteOffset": 0, "byteLength": places, "target": VERTEX_BUFFER},
            {"buffer": 0, "byteOffset": places, "byteLength": colours, "target": VERTEX_BUFFER},
            {"buffer": 0, "byteOffset": places + colours, "byteLength": len(self._indices), "target": INDEX_BUFFER},
        ]
        accessors = [
            {"bufferView": 0, "componentType": FLOAT, "count": vertices, "type": "VEC3",
             "min": [-FAR_M] * 3, "max": [FAR_M] * 3},
            {"bufferView": 1, "componentType": UINT8, "normalized": True, "count": vertices, "type": "VEC4"},
            {"bufferView": 2, "componentType": UINT32, "count": 3 * len(faces), "type": "SCALAR"},
        ]  # fmt: skip
        self._length = places + colours + len(self._indices)
        header = {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "COLOR_0": 1}, "indices": 2, "material": 0}]}],
            "materials": [
                {"pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.9}, "doubleSided": True}
            ],
            "accessors": accessors,
            "bufferViews": views,
            "buffers": [{"byteLength": self._length}],
        }
        text = json.dumps(header, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        total = 12 + 8 + len(text) + 8 + self._length
        self._head = (
            struct.pack("<4sII", b"glTF", 2, total) + struct.pack("<II", len(text), JSON_CHUNK) + text
            + struct.pack("<II", self._length, BINARY_CHUNK)
        )  # fmt: skip

    def file(self, positions: Float32, colours: NDArray[np.uint8]) -> bytes:
        """Return the file. positions: [m], (n, 3); colours: red, green, blue (sRGB), opacity, (n, 4)"""
        assert positions.shape == (self._count, 3) and colours.shape == (self._count, 4)
        places = np.ascontiguousarray(positions, np.float32).tobytes()
        return b"".join((self._head, places, linear(colours).tobytes(), self._indices))


_LINEAR = np.round(255.0 * linear_rgb(np.arange(256) / 255.0)).astype(np.uint8)


def linear(colours: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Convert sRGB colours to the linear scale of glTF vertices. The opacity is unchanged."""
    result = _LINEAR[colours]
    result[:, 3] = colours[:, 3]
    return np.ascontiguousarray(result)
