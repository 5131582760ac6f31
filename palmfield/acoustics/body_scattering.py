"""What bodies do to the sound on a surface: shadows by rays, or the whole scattered field. All in the array frame."""

from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from trimesh.remesh import subdivide_to_size

from palmfield.acoustics.arp import SurfaceSound, wall_pressure
from palmfield.acoustics.scattering import Incident, Scattering, scatter
from palmfield.acoustics.shadow import REACH_m, lit
from palmfield.device import resolve
from palmfield.types import Air, Complex, Float, Float32, Int

EDGES_PER_WAVELENGTH = 6.0
"""Longest edge of the boundary elements; they come out with about 8 edges a wavelength in the mean."""


BODY_SOUNDS = {
    "none": "faces turned away from the sound are unlit; one part does not shade another, nothing echoes",
    "shadows": "dark where the way back along the sound's energy flux is blocked, by another part or the body itself",
    "scattering": "boundary elements on the whole body: total sound on a rigid wall, with echoes between its parts",
}


def boundary_mesh(vertices: Float, faces: Int, wavelength_m: float) -> tuple[Float, Int]:
    """The closed surface with edges short enough for boundary elements: vertices [m] and faces.

    vertices: [m], shape (v, 3); faces: shape (m, 3)
    """
    fine, triangles = subdivide_to_size(vertices, faces, wavelength_m / EDGES_PER_WAVELENGTH, max_iter=20)
    merged, inverse = np.unique(np.round(fine, 12), axis=0, return_inverse=True)
    return merged, inverse.reshape(-1)[triangles].astype(np.int32)


@dataclass(frozen=True)
class RigidScatteredField:
    """Total sound on a rigid body for one drive and pose, to be read anywhere on the body.

    solution: by boundary elements; nearest: tree of its centroids
    """

    solution: Scattering
    nearest: cKDTree
    air: Air

    @staticmethod
    def of(
        mesh: tuple[Float, Int], incident: Incident, wavenumber: float, air: Air, device: str
    ) -> "RigidScatteredField":
        """Solve for the sound on a body; see `palmfield.acoustics.scattering.scatter` for what it raises.

        mesh: of `boundary_mesh`; incident: the sound without the body; wavenumber: [rad/m]
        """
        solution = scatter(*mesh, incident, wavenumber, device=device)
        return RigidScatteredField(solution, cKDTree(solution.centroids), air)

    def at(self, points: Float) -> SurfaceSound:
        """ARP and amplitude of the pressure at points on or near the surface [m], shape (n, 3), from the nearest face.

        The law is `palmfield.acoustics.arp.TOTAL_FIELD`.
        """
        solution = self.solution
        _, face = self.nearest.query(points)
        offset = points - solution.centroids[face]
        gradient = solution.gradient[face]
        pressure: Complex = solution.pressure[face] + np.einsum("ij,ij->i", offset, gradient)
        arp = wall_pressure(pressure, gradient, solution.wavenumber, self.air)
        return SurfaceSound(arp.astype(np.float32), np.abs(pressure).astype(np.float32))


class Occlusion:
    """What casts shadows, as a bounding volume hierarchy that follows its vertices.

    It belongs to one simulation's state and is used by one thread at a time.

    vertices: [m], shape (v, 3); faces: shape (m, 3), all that casts shadows in one mesh
    device: "auto", "cpu" or "cuda:N"
    """

    def __init__(self, vertices: Float, faces: Int, device: str = "auto"):
        """Raises PalmfieldError for a device that is not on this machine."""
        self.device = resolve(device)
        corners: wp.array = wp.array(np.asarray(faces, np.int32).ravel(), dtype=wp.int32, device=self.device)
        points: wp.array = wp.array(np.asarray(vertices, np.float32), dtype=wp.vec3, device=self.device)
        self.mesh = wp.Mesh(points, corners)

    def move(self, vertices: Float) -> None:
        """Take new positions of the same vertices [m], shape (v, 3)."""
        self.mesh.points.assign(np.asarray(vertices, np.float32))
        self.mesh.refit()

    def lit(
        self, points: Float, flux: Float | Float32, reach_m: Float | Float32 | float = REACH_m
    ) -> NDArray[np.bool_]:
        """Whether nothing blocks the way back along the sound, shape (n,): one ray a point.

        points: [m], shape (n, 3); flux: where the sound goes there, any length, shape (n, 3)
        reach_m: how far the ray goes [m], a number or shape (n,)
        Raises PalmfieldError as `palmfield.acoustics.shadow.lit`.
        """
        return lit(points, flux, self.mesh, reach_m=reach_m)
