"""Sound on and around a rigid body by boundary elements, and the radiation pressure of the total field on it."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse.linalg import LinearOperator, gmres

from palmfield.acoustics.arp import wall_pressure
from palmfield.acoustics.bem import DoubleLayer
from palmfield.acoustics.bem_mesh import checked, elements_per_wavelength, inner_points
from palmfield.acoustics.surface_gradient import surface_gradient
from palmfield.device import resolve
from palmfield.errors import PalmfieldError
from palmfield.hand.triangles import face_normals
from palmfield.types import Air, Complex, Float, Int

Incident = Callable[[Float], Complex]
"""Complex peak pressure [Pa], shape (n,), of the sound without the body at points [m], shape (n, 3)."""


RESTART = 60
LARGEST_ITERATIONS = 300


@dataclass(frozen=True)
class Scattering:
    """Total sound on a rigid body, one value per face, with e^{-i w t}.

    vertices: [m], shape (v, 3). faces: shape (m, 3). wavenumber: [rad/m].
    centroids: [m], shape (m, 3). normals: unit, outward, shape (m, 3). areas: [m2], shape (m,).
    pressure: complex peak pressure at the centroids [Pa], shape (m,).
    gradient: gradient along the surface [Pa/m], shape (m, 3); the normal component is 0.
    iterations: number of GMRES iterations. residual: relative residual of the linear system.
    elements_per_wavelength: wavelength over mean edge.
    """

    vertices: Float
    faces: Int
    wavenumber: float
    centroids: Float
    normals: Float
    areas: Float
    pressure: Complex
    gradient: Complex
    iterations: int
    residual: float
    elements_per_wavelength: float


def scatter(
    mesh_vertices: ArrayLike,
    faces: ArrayLike,
    incident: Incident,
    wavenumber: float,
    *,
    device: str = "auto",
    tolerance: float = 1e-4,
) -> Scattering:
    """Return the total sound on a closed rigid body, by matrix-free collocation with one value per face, and GMRES.

    The Helmholtz integral p_i + K p is p/2 on the surface and 0 inside. The equation of a face is the first condition
    at its centroid minus i times the second condition an eighth of a wavelength below. (Yaghjian and co-workers use
    this dual-surface equation for radio waves.) It is Burton & Miller's equation with the normal derivative as a
    difference over that depth, so it has no hypersingular kernel. On a sphere of inner radius b its eigenvalues are
    proportional to j_n(ka) - i j_n(kb). They never vanish, so there are no irregular frequencies. For other bodies this
    is not proved; check momentum and reciprocity. The equation is of the second kind and needs no preconditioner.

    mesh_vertices: [m], shape (v, 3). faces: shape (m, 3), counter-clockwise seen from outside.
    incident: pressure without the body, which must satisfy the wave equation inside the body too.
    wavenumber: [rad/m].
    device: "auto", "cpu" or "cuda:N". tolerance: relative residual at which GMRES stops, >= 1e-6 (float32 sums).
    Raises PalmfieldError for an open or inverted mesh, for a bad wavenumber or tolerance, for incident sound that is
    not finite, and if GMRES does not converge. Warns (UserWarning) below 6 elements per wavelength.
    """
    vertices, triangles = checked(mesh_vertices, faces)
    if not 0.0 < wavenumber < np.inf:
        raise PalmfieldError(f"wavenumber = {wavenumber} must be positive and finite: give 2 pi f/c [rad/m]")
    if not 1e-6 <= tolerance < 1.0:
        raise PalmfieldError(
            f"tolerance = {tolerance} must be between 1e-6 and 1, because sums are in float32: use for example 1e-4"
        )
    resolution = elements_per_wavelength(vertices, triangles, wavenumber)
    normals, areas = face_normals(vertices, triangles)
    centroids = vertices[triangles].mean(axis=1)
    count = len(triangles)
    points = np.concatenate([centroids, inner_points(vertices, triangles, wavenumber)])
    sound = np.asarray(incident(points), dtype=np.complex128)
    if sound.shape != (2 * count,) or not np.isfinite(sound).all():
        raise PalmfieldError(
            f"incident sound of shape {sound.shape} at {2 * count} points on and inside the body must be finite "
            f"and have shape ({2 * count},): correct the function, or move the body away from the sources"
        )
    own = np.concatenate([np.arange(count), np.full(count, -1)])
    layer = DoubleLayer(points, vertices, triangles, wavenumber, resolve(device), own)

    def equation(pressure: Complex) -> Complex:
        doubled = layer.apply(pressure)
        return 0.5 * pressure - doubled[:count] + 1j * doubled[count:]

    right_side = sound[:count] - 1j * sound[count:]
    steps: list[float] = []
    pressure, failed = gmres(
        LinearOperator((count, count), matvec=equation, dtype=np.complex128),
        right_side,
        rtol=tolerance,
        atol=0.0,
        restart=RESTART,
        maxiter=LARGEST_ITERATIONS // RESTART,
        callback=steps.append,
        callback_type="pr_norm",
    )
    scale = float(np.linalg.norm(right_side))
    residual = float(np.linalg.norm(right_side - equation(pressure))) / scale if scale > 0.0 else 0.0
    if failed:
        raise PalmfieldError(
            f"scattering did not converge: residual {residual:.2g} after {len(steps)} iterations, tolerance "
            f"{tolerance:g}; check the mesh for faces that intersect, or raise tolerance"
        )
    gradient = surface_gradient(vertices, triangles, pressure)
    return Scattering(
        vertices, triangles, wavenumber, centroids, normals, areas, pressure, gradient, len(steps), residual, resolution
    )


def wall_arp(scattering: Scattering, air: Air) -> Float:
    """Return the radiation pressure on the rigid wall [Pa], shape (m,), positive inwards.

    The law is `palmfield.acoustics.arp.TOTAL_FIELD`.
    """
    return wall_pressure(scattering.pressure, scattering.gradient, scattering.wavenumber, air)
