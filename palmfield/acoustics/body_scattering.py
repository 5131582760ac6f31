"""Effect of bodies on the sound on a surface: the full scattered field by boundary elements."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from palmfield.acoustics.arp import SurfaceSound, wall_pressure
from palmfield.acoustics.scattering import Incident, Scattering, scatter
from palmfield.errors import PalmfieldError
from palmfield.hand.subdivide import with_short_edges
from palmfield.hand.triangles import checked_mesh, face_normals
from palmfield.types import Air, Complex, Float, Int

MOST_FACES = 1_000_000
EDGES_PER_WAVELENGTH = 6.0
"""Longest edge of the boundary elements in wavelengths; the mean is then about 8 edges per wavelength."""


def boundary_mesh(vertices: Float, faces: Int, wavelength_m: float) -> tuple[Float, Int]:
    """Return vertices [m] and faces of a closed surface, subdivided for boundary elements.

    vertices: [m], shape (v, 3); faces: shape (m, 3)
    Raises PalmfieldError for other shapes, NaN, invalid vertex numbers, and a wavelength that is not above 0 or needs
    more than MOST_FACES.
    """
    vertices, faces = checked_mesh(vertices, faces)
    edge = wavelength_m / EDGES_PER_WAVELENGTH
    # The least number of faces is that of equilateral triangles with this edge
    if not (edge > 0.0 and 2.31 * face_normals(vertices, faces)[1].sum() < MOST_FACES * edge**2):
        raise PalmfieldError(f"wavelength_m is {wavelength_m:g}; allowed: above 0, and at most {MOST_FACES:,} faces")
    fine, triangles, _ = with_short_edges(vertices, faces, edge)
    merged, inverse = np.unique(np.round(fine, 12), axis=0, return_inverse=True)
    return merged, inverse.reshape(-1)[triangles].astype(np.int32)


@dataclass(frozen=True)
class RigidScatteredField:
    """Total sound on a rigid body for one drive and pose, which can be evaluated anywhere on the body.

    solution: solution by boundary elements; nearest: tree of its centroids
    """

    solution: Scattering
    nearest: cKDTree
    air: Air

    @staticmethod
    def of(
        mesh: tuple[Float, Int], incident: Incident, wavenumber: float, air: Air, device: str
    ) -> "RigidScatteredField":
        """Solve for the sound on a body. Raises the errors of `palmfield.acoustics.scattering.scatter`.

        mesh: as returned by `boundary_mesh`; incident: sound without the body; wavenumber: [rad/m]
        """
        solution = scatter(*mesh, incident, wavenumber, device=device)
        return RigidScatteredField(solution, cKDTree(solution.centroids), air)

    def at(self, points: Float) -> SurfaceSound:
        """Return ARP and pressure amplitude of the nearest face at points on or near the surface [m], shape (n, 3).

        The law is `palmfield.acoustics.arp.TOTAL_FIELD`.
        """
        solution = self.solution
        _, face = self.nearest.query(points)
        offset = points - solution.centroids[face]
        gradient = solution.gradient[face]
        pressure: Complex = solution.pressure[face] + np.einsum("ij,ij->i", offset, gradient)
        arp = wall_pressure(pressure, gradient, solution.wavenumber, self.air)
        return SurfaceSound(arp.astype(np.float32), np.abs(pressure).astype(np.float32))
