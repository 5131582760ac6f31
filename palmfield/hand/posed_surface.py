"""Temporary."""

from dataclasses import dataclass
import numpy as np
from scipy import sparse
from palmfield.hand.blend import blended, bone_shifts
from palmfield.hand.meshquery import barycentric, build_mesh, closest_faces
from palmfield.hand.rigged import strongest
from palmfield.hand.skinning import SkinnedSurface

REACH_M = 0.05


@dataclass(frozen=True)
class SkinBinding:
    bones: object
    shares: object

    @staticmethod
    def to(hand, points):
        surface = hand.surface
        face = closest_faces(build_mesh(surface.vertices, surface.faces), points, REACH_M)
        corners = surface.faces[face]
        weights = np.einsum("nk,nkb->nb", barycentric(surface.vertices[corners], points), hand.weights[corners])
        shares, bones = strongest(sparse.csr_array(weights))
        return SkinBinding(bones, shares)


def blend(binding, hand, positions, turns, points, normals):
    origins = np.array([bone.origin for bone in hand.bones])
    shifts = bone_shifts(origins, positions, turns)
    shift, turn = blended(binding.bones, binding.shares, shifts, turns)
    normal = np.einsum("nij,nj->ni", turn, normals)
    return np.einsum("nij,nj->ni", turn, points) + shift, normal / np.linalg.norm(normal, axis=1, keepdims=True)


def face_samples(vertices, faces):
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    cross = np.cross(b - a, c - a)
    areas = 0.5 * np.linalg.norm(cross, axis=1)
    return (a + b + c) / 3, cross / (2 * areas[:, None]), areas
