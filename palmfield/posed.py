"""The scene's surface where bones have taken it, and what else stands in the sound's way."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import warp as wp
from scipy import sparse
from trimesh.remesh import subdivide_to_size

from palmfield.acoustics.air import sound_speed
from palmfield.acoustics.shadow import shadow_mesh
from palmfield.hand.blend import blended, bone_shifts
from palmfield.hand.meshquery import barycentric, build_mesh, closest_faces
from palmfield.hand.rigged import strongest
from palmfield.hand.skinning import SkinnedSurface
from palmfield.hand.subdivide import EDGE_m
from palmfield.obstacle import boundary_mesh
from palmfield.types import Float, Int, Surface

if TYPE_CHECKING:
    from palmfield.rig import Rig

REACH_M = 0.05
"""Farther from the skin than this is no point of it."""


@dataclass(frozen=True)
class Bound:
    """Points with the bones that carry them. bones: numbers, shape (n, 4); shares: of each, shape (n, 4)"""

    bones: Int
    shares: Float

    @staticmethod
    def to(hand: SkinnedSurface, points: Float) -> "Bound":
        """Points on or near the resting hand's skin [m], shape (n, 3), go with the face that is nearest to each."""
        surface = hand.surface
        face = closest_faces(build_mesh(surface.vertices, surface.faces), points, REACH_M)
        corners = surface.faces[face]
        weights = np.einsum("nk,nkb->nb", barycentric(surface.vertices[corners], points), hand.weights[corners])
        shares, bones = strongest(sparse.csr_array(weights))
        return Bound(bones, shares)


class PosedBody:
    """One state of a scene's body, all in its frame. What is not asked for is not computed.

    bones: as in `palmfield.engine.pose.Pose`; a body without bones or obstacles has one state only
    """

    def __init__(self, rig: "Rig", bones: tuple[Float, Float]):
        self.rig = rig
        count = 0 if rig.hand is None else len(rig.hand.bones)
        self._positions, self._turns = bones[0][:count], bones[1][:count]
        self._others = list(zip(bones[0][count:], bones[1][count:], strict=True))

    @cached_property
    def vertices(self) -> Float:
        """Of the closed surface [m], shape (v, 3)."""
        hand = self.rig.hand
        return self.rig.closed_surface[0] if hand is None else hand.posed(self._positions, self._turns)

    @cached_property
    def nodes(self) -> tuple[Float, Float]:
        """Surface nodes of the skin layer [m] and their outward normals, shapes (S, 3)."""
        mesh = self.rig.mesh
        return self.moved(mesh.nodes[: mesh.surface_nodes], mesh.surface_normals(), self.rig.nodes_bound)

    @cached_property
    def quadrature(self) -> tuple[Float, Float]:
        """Points at which the ARP on the skin is integrated [m] and their outward normals, shapes (q, 3)."""
        return self.moved(self.rig.quadrature.points, self.rig.quadrature.normals, self.rig.points_bound)

    def moved(self, points: Float, normals: Float, bound: Bound | None) -> tuple[Float, Float]:
        """Points of the resting surface [m] and their unit normals, shapes (n, 3), where they are now.

        bound: to the bones (`Rig.bound`), None for a body in one piece
        """
        if bound is None:
            return points, normals
        assert self.rig.hand is not None
        origins = np.array([bone.origin for bone in self.rig.hand.bones])
        shifts = bone_shifts(origins, self._positions, self._turns)
        shift, turn = blended(bound.bones, bound.shares, shifts, self._turns)
        normal = np.einsum("nij,nj->ni", turn, normals)
        return np.einsum("nij,nj->ni", turn, points) + shift, normal / np.linalg.norm(normal, axis=1, keepdims=True)

    @cached_property
    def samples(self) -> tuple[Float, Float, Float]:
        """Points of the surface for the force on the body [m], outward normals, (n, 3), and areas [m^2], (n,)."""
        rig = self.rig
        if rig.surface is None:
            return rig.quadrature.points, rig.quadrature.normals, rig.quadrature.weights
        vertices, faces = self.vertices, rig.surface.faces
        if rig.hand is None:
            vertices, faces = subdivide_to_size(vertices, faces, EDGE_m, max_iter=20)
        a, b, c = (vertices[faces[:, i]] for i in range(3))
        cross = np.cross(b - a, c - a)
        areas = 0.5 * np.linalg.norm(cross, axis=1)
        return (a + b + c) / 3, cross / (2 * areas[:, None]), areas

    @cached_property
    def owners(self) -> Int:
        """Which of the bodies at `origins` each sample pushes, shape (n,)."""
        return np.zeros(len(self.samples[2]), np.int32) if self.rig.hand is None else self.rig.owners

    @property
    def origins(self) -> Float:
        """Of the frames of the bodies that the sound pushes: bones, or the body itself [m], shape (b, 3)."""
        return np.zeros((1, 3)) if self.rig.hand is None else self._positions

    @cached_property
    def beside(self) -> tuple[Float, Int] | None:
        """Vertices [m] and faces of the obstacles, None without any."""
        if not self._others:
            return None
        vertices: list[Float] = []
        faces: list[Int] = []
        for (points, corners), (position, turn) in zip(self.rig.obstacles, self._others, strict=True):
            faces.append((corners + sum(len(part) for part in vertices)).astype(np.int32))
            vertices.append(points @ turn.T + position)
        return np.concatenate(vertices), np.concatenate(faces)

    @cached_property
    def shadows(self) -> wp.Mesh:
        """What casts shadows."""
        vertices, faces = self.vertices, self.rig.closed_surface[1]
        if self.beside is not None:
            points, corners = self.beside
            faces = np.concatenate([faces, corners + len(vertices)]).astype(np.int32)
            vertices = np.concatenate([vertices, points])
        surface = Surface(vertices, faces, np.zeros_like(vertices))
        return shadow_mesh(surface, self.rig.reference_emitter.evaluator.device)

    @cached_property
    def boundary_mesh(self) -> tuple[Float, Int]:
        """Boundary elements of the body."""
        wavelength = sound_speed(self.rig.air) / self.rig.array.frequency_Hz
        return boundary_mesh(self.vertices, self.rig.closed_surface[1], wavelength)
