"""Shadow of a body in the sound of an array by rays, a cheap approximation of scattering."""

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from palmfield.acoustics import check
from palmfield.device import resolve, run_kernel
from palmfield.errors import PalmfieldError
from palmfield.types import Float32, Surface
from warp_kernels import shadow as kernels

CLEARANCE_m = 2e-4
"""Height above the surface at which a ray starts: the distance between coarse and fine meshes of a hand."""

REACH_m = 10.0


def shadow_mesh(surface: Surface, device: str = "auto") -> wp.Mesh:
    """Return the bounding volume hierarchy of the obstacles, on `device`."""
    where = resolve(device)
    vertices: wp.array = wp.array(surface.vertices.astype(np.float32), dtype=wp.vec3, device=where)
    faces: wp.array = wp.array(surface.faces.astype(np.int32).ravel(), dtype=wp.int32, device=where)
    return wp.Mesh(vertices, faces)


def visibility(
    points: ArrayLike,
    normals: ArrayLike,
    surface_mesh: wp.Mesh,
    source_positions: ArrayLike,
    *,
    weights: ArrayLike | None = None,
    clearance_m: float = CLEARANCE_m,
) -> Float32:
    """Return the weighted share of sources visible from each point of a surface, shape (n,), 0 to 1.

    A source is visible if it is in front of the surface at the point and no obstacle is between.

    points: points on or near the surface [m], shape (n, 3); normals: unit outward normals there, shape (n, 3).
    surface_mesh: obstacles, from `shadow_mesh`, in the same frame.
    source_positions: [m], shape (s, 3); weights: 0 or more, for example |drive|^2, shape (s,); equal by default
    Raises PalmfieldError for other shapes, numbers that are not finite, and weights that are negative or sum to 0.
    """
    where, outward = points_and_normals(points, normals)
    sources = check.points(source_positions, np.float32)
    share = np.ones(len(sources)) if weights is None else np.asarray(weights, dtype=float)
    if share.shape != (len(sources),) or not np.all(share >= 0.0) or not 0.0 < share.sum() < np.inf:
        raise PalmfieldError(
            f"weights of shape {share.shape}, sum {share.sum():g}, for {len(sources)} sources: give shape "
            f"({len(sources)},), 0 or more, not all 0"
        )
    device = surface_mesh.device
    result = wp.empty(len(where), dtype=float, device=device)
    inputs = [
        surface_mesh.id,
        vectors(where, device),
        vectors(outward, device),
        vectors(sources, device),
        wp.array((share / share.sum()).astype(np.float32), dtype=float, device=device),
        clearance_m,
        result,
    ]
    run_kernel(kernels.visibility, dim=len(where), inputs=inputs, device=device)
    return np.clip(result.numpy(), 0.0, 1.0)


def points_and_normals(points: ArrayLike, normals: ArrayLike) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    where, outward = check.points(points, np.float32), check.points(normals, np.float32)
    if len(where) != len(outward):
        raise PalmfieldError(f"{len(where)} points but {len(outward)} normals: give one normal per point")
    return where, outward


def vectors(values: NDArray[np.floating], device: wp.Device | None) -> wp.array:
    return wp.array(np.ascontiguousarray(values, np.float32), dtype=wp.vec3, device=device)
