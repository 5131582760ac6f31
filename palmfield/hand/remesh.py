"""Remesh a patch with coarser triangles, for solvers that allow them."""

from dataclasses import replace

import numpy as np

from palmfield.hand.grading import graded_size, triangulate
from palmfield.hand.meshquery import over_plane
from palmfield.hand.region import FACING_COSINE, facing_region, trace_shape
from palmfield.hand.triangles import face_normals, on_rim
from palmfield.types import Float, Patch, Surface


def is_height_field(patch: Patch) -> bool:
    """Return whether all vertices are visible along the mean outward direction, inclined by at most 75 degrees."""
    return bool((-patch.inward @ outward(patch)).min() > FACING_COSINE)


def outward(patch: Patch) -> Float:
    """Return the mean outward direction, a unit vector, shape (3,)."""
    mean = -patch.inward.mean(axis=0)
    return mean / np.linalg.norm(mean)


def remeshed(patch: Patch, centre: Float, fine_m: float, coarse_m: float, fine_radius_m: float) -> Patch:
    """Return the patch with edges of fine_m within fine_radius_m of `centre`, growing to coarse_m at the far end [m].

    centre: x and y in the frame of the patch [m], shape (2,)
    Vertices are on the triangles of the patch, with interpolated depth and inward direction. The outline is kept except
    for spikes narrower than coarse_m.
    Raises SceneError if the patch is narrower than about 1.5 coarse_m at `centre`, or steep there.
    """
    facing = outward(patch)
    middles = patch.vertices[patch.faces].mean(axis=1)
    seed = int(np.argmin(np.hypot(*(middles[:, :2] - centre).T)))
    origin = middles[seed]
    radius = 1.01 * float(np.linalg.norm(patch.vertices - origin, axis=1).max())
    region = facing_region(Surface(patch.vertices, patch.faces, -patch.inward), origin, seed, facing, radius)
    shape = trace_shape(region, step_m=max(0.5 * fine_m, radius / 80.0), spike_m=0.5 * coarse_m)
    plane, faces = triangulate(shape, graded_size(fine_m, coarse_m, fine_radius_m, radius), radius)

    corners, weights = over_plane(region.shadow, region.faces, plane)
    old = region.index[corners]
    vertices, inward = (np.einsum("ij,ijk->ik", weights, values[old]) for values in (patch.vertices, patch.inward))
    inward /= np.linalg.norm(inward, axis=1, keepdims=True)
    depth = np.einsum("ij,ij->i", weights, patch.depth[old])
    rim = on_rim(faces, len(vertices))
    area = float(face_normals(vertices, faces)[1].sum())
    report = patch.report | {"vertices": float(len(vertices)), "triangles": float(len(faces)), "area_m2": area}
    return replace(patch, vertices=vertices, faces=faces, inward=inward, depth=depth, rim=rim, report=report)
