"""What the rest of the body does to the sound on a patch of it: shadows by rays, or the whole scattered field."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from trimesh.remesh import subdivide_to_size

from palmfield.acoustics.air import density, sound_speed
from palmfield.acoustics.scattering import Incident, Scattering, scatter
from palmfield.types import Air, Complex, Field, Float, Float32, Int

EDGES_PER_WAVELENGTH = 6.0
"""Longest edge of the boundary elements; they come out with about 8 edges a wavelength in the mean."""


BODY_SOUNDS = {
    "none": "faces turned away from the sound are unlit; one part does not shade another, nothing echoes",
    "shadows": "dark where the way back along the sound's energy flux is blocked, by another part or the body itself",
    "scattering": "boundary elements on the whole body: total sound on a rigid wall, with echoes between its parts",
}


def energy_flux(field: Field) -> Float:
    """Direction of the energy flux, Re(p u*) up to a factor, shape (n, 3); u = grad p/(i w rho)."""
    assert field.gradient is not None
    flux: Float = np.imag(np.conj(field.pressure)[:, None] * field.gradient).astype(np.float64)
    return flux


def boundary_mesh(vertices: Float, faces: Int, wavelength_m: float) -> tuple[Float, Int]:
    """The closed surface with edges short enough for boundary elements."""
    fine, triangles = subdivide_to_size(vertices, faces, wavelength_m / EDGES_PER_WAVELENGTH, max_iter=20)
    merged, inverse = np.unique(np.round(fine, 12), axis=0, return_inverse=True)
    return merged, inverse.reshape(-1)[triangles].astype(np.int32)


@dataclass(frozen=True)
class WallSound:
    """Total sound on a rigid body, to be read anywhere on it."""

    found: Scattering
    tree: cKDTree
    air: Air

    @staticmethod
    def of(mesh: tuple[Float, Int], incident: Incident, wavenumber: float, air: Air, device: str) -> "WallSound":
        """Solve for the sound on a body; see `palmfield.acoustics.scattering.scatter` for what it raises."""
        found = scatter(*mesh, incident, wavenumber, device=device)
        return WallSound(found, cKDTree(found.centroids), air)

    def at(self, points: Float) -> tuple[Float32, Float32]:
        """ARP [Pa] and peak pressure amplitude [Pa], shapes (n,), at surface points, from the nearest face.

        P = |p|^2/(4 rho c^2) - rho |u_t|^2/4 with the peak amplitudes of the total sound.
        """
        found = self.found
        _, face = self.tree.query(points)
        away = points - found.centroids[face]
        pressure: Complex = found.pressure[face] + np.einsum("ij,ij->i", away, found.gradient[face])
        slope: NDArray[np.float64] = (np.abs(found.gradient[face]) ** 2).sum(axis=1) / found.wavenumber**2
        arp = (np.abs(pressure) ** 2 - slope) / (4.0 * density(self.air) * sound_speed(self.air) ** 2)
        return arp.astype(np.float32), np.abs(pressure).astype(np.float32)
