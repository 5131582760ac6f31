"""Points and faces of a skin that is moved by bones, for each step of a simulation."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import warp as wp
from scipy import sparse

import warp_kernels.skinning as kernels
from palmfield.device import recorded
from palmfield.errors import SceneError
from palmfield.hand.blend import bone_shifts
from palmfield.hand.meshquery import barycentric, build_mesh, closest_faces
from palmfield.hand.rigged import strongest
from palmfield.hand.skinning import SkinnedSurface
from palmfield.hand.triangles import FaceSamples
from palmfield.types import Float, Int

REACH_M = 0.05
"""Largest distance of a bound point from the skin at rest."""


@dataclass(frozen=True)
class SkinBinding:
    """Points of a skin at rest with the bones that carry them.

    bones: bone numbers, shape (n, 4); shares: their weights, shape (n, 4), rows of sum 1; count: bones of the skin
    """

    bones: Int
    shares: Float
    count: int

    @staticmethod
    def to(hand: SkinnedSurface, points: Float) -> "SkinBinding":
        """Bind points on or near the skin at rest [m], shape (n, 3), each to the nearest face.

        Raises SceneError for a point farther than REACH_M from the skin.
        """
        surface = hand.surface
        face = closest_faces(build_mesh(surface.vertices, surface.faces), points, REACH_M)
        if (face < 0).any():
            i = int(np.argmin(face))
            raise SceneError(
                f"point {i} at {points[i].tolist()} m is more than {1e3 * REACH_M:g} mm from the skin at rest: "
                "give points on the skin at rest"
            )
        corners = surface.faces[face]
        weights = np.einsum("nk,nkb->nb", barycentric(surface.vertices[corners], points), hand.weights[corners])
        shares, bones = strongest(sparse.csr_array(weights))
        return SkinBinding(bones, shares, len(hand.bones))

    @cached_property
    def weights(self) -> Float:
        """Return the weight of each bone at each point, shape (count, n)."""
        result = np.zeros((self.count, len(self.bones)))
        np.add.at(result, (self.bones, np.arange(len(self.bones))[:, None]), self.shares)
        return result

    def blend(
        self, hand: SkinnedSurface, bone_positions: Float, bone_rotations: Float, points: Float, normals: Float
    ) -> tuple[Float, Float]:
        """Return the posed points of the skin [m] and their unit normals, both of shape (n, 3).

        Linear blend skinning in float64 for the bound points; `SkinnedSurface.posed` computes the whole skin.

        bone_positions: origins of the bones' frames [m], shape (b, 3); bone_rotations: shape (b, 3, 3), in any frame
        points, normals: points and normals at rest, in the order of the binding, both of shape (n, 3)
        """
        count = len(hand.origins)
        motions = np.empty((12, count))
        motions[:9] = bone_rotations.reshape(count, 9).T
        motions[9:] = bone_shifts(hand.origins, bone_positions, bone_rotations).T
        # Points are along the rows: one matrix product blends all bones, and later operations use long rows
        of_points = motions @ self.weights
        turns = of_points[:9].reshape(3, 3, -1)
        moved, turned = np.empty(points.shape), np.empty(normals.shape)
        np.add(np.add.reduce(turns * points.T, axis=1), of_points[9:], out=moved.T)
        direction = np.add.reduce(turns * normals.T, axis=1)
        np.divide(direction, np.sqrt(np.add.reduce(direction * direction, axis=0)), out=turned.T)
        return moved, turned


class FaceSampler:
    """Computes `face_samples` of a mesh with moving vertices in fixed buffers, in float64; not thread-safe.

    faces: shape (m, 3); count: number of vertices
    """

    def __init__(self, faces: Int, count: int) -> None:
        vertices: Any = wp.zeros(count, dtype=wp.vec3d, device="cpu")
        corners: Any = wp.array(np.ascontiguousarray(faces, np.int32), dtype=wp.vec3i, device="cpu")
        results = [wp.zeros(len(faces), dtype=dtype, device="cpu") for dtype in (wp.vec3d, wp.vec3d, wp.float64)]
        self._sample = recorded(kernels.face_samples, len(faces), [vertices, corners, *results], "cpu")
        self._vertices: Float = vertices.numpy()
        self._samples = FaceSamples(*(result.numpy() for result in results))

    def at(self, vertices: Float) -> FaceSamples:
        """Return the samples for vertices [m], shape (count, 3), as views of buffers that the next call overwrites."""
        self._vertices[...] = vertices
        self._sample()
        return self._samples
