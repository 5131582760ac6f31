"""Moving surface for instruments, from the Motion of a skin solver or from a skin in a result file."""

from typing import NamedTuple

import numpy as np
import trimesh
import xarray as xr
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from palmfield.errors import MeasurementError
from palmfield.skin.problem import Body, Motion, normals_on_face
from palmfield.types import Float, Int

CANDIDATES = 24
"""Number of triangles with the nearest centres among which the triangle nearest to a point is searched."""
MILLIMETRES = 1e3
"""Factor from metres to the unit for trimesh, which has absolute tolerances for such numbers."""


class SurfaceMotion(NamedTuple):
    """Motion of points of a surface, in one frame.

    times_s: ascending [s], shape (t,); points: points at rest [m], normals: outward unit normals, both (n, 3)
    displacement_m: [m], velocity_m_s: [m/s], shape (t, n, 3)
    """

    times_s: Float
    points: Float
    normals: Float
    displacement_m: Float
    velocity_m_s: Float


class Places(NamedTuple):
    """Nearest points on a mesh.

    triangle: triangle numbers, shape (n,); shares: weights of their corners, shape (n, 3); distance_m: distances to the
    mesh, shape (n,); nearest: points on the mesh [m], shape (n, 3)
    """

    triangle: Int
    shares: Float
    distance_m: Float
    nearest: Float


def of_motion(motion: Motion, body: Body) -> SurfaceMotion:
    """Return the motion of a skin solver, with the normals of the face of the body."""
    return SurfaceMotion(
        np.asarray(motion.times_s, dtype=float), np.asarray(motion.points, dtype=float),
        normals_on_face(body, motion.points), motion.displacement_m, motion.velocity_m_s,
    )  # fmt: skip


def of_skin(skin: xr.Dataset, places_m: ArrayLike | None = None, off_m: float = 1e-3) -> SurfaceMotion:
    """Return the motion of a skin of a result at its vertices or at points, in the frame of the body at rest.

    skin: one of `palmfield.outputs.instances(result, "skin")`
    places_m: points [m], shape (n, 3), at which the motion is interpolated in the nearest triangle; None: vertices
    off_m: largest distance of a point from the skin [m]; larger distances raise MeasurementError
    """
    points, normals = skin["rest_position"].values, skin["rest_normal"].values
    if skin.sizes["time"] < 4:
        raise MeasurementError(
            f"the result holds {skin.sizes['time']} times of the skin motion; needed: four or more; run for longer"
        )
    times = np.asarray(skin["time"].values, dtype=float)
    if places_m is None:
        motions = [np.asarray(skin[name].values, dtype=float) for name in ("displacement", "velocity")]
        return SurfaceMotion(times, points, normals, *motions)
    faces = skin["face"].values
    feet = on_mesh(points, faces, places_m)
    worst = int(feet.distance_m.argmax())
    if feet.distance_m[worst] > off_m:
        place = ", ".join(f"{x:.4g}" for x in np.asarray(places_m, dtype=float)[worst])
        raise MeasurementError(
            f"point {worst} at ({place}) m is {feet.distance_m[worst]:.3g} m from the skin; allowed: {off_m:g} "
            "m; move it"
        )
    used, corners = np.unique(faces[feet.triangle], return_inverse=True)
    corners = corners.reshape(-1, 3)
    motions = []
    for name in ("displacement", "velocity"):
        values = np.asarray(skin[name].isel(vertex=used).values, dtype=float)
        motions.append(np.einsum("tnci,nc->tni", values[:, corners], feet.shares))
    between = np.einsum("nci,nc->ni", normals[faces[feet.triangle]], feet.shares)
    between /= np.linalg.norm(between, axis=1, keepdims=True)
    return SurfaceMotion(times, feet.nearest, between, *motions)


def on_mesh(vertices: ArrayLike, faces: ArrayLike, places_m: ArrayLike) -> Places:
    """Return the nearest points on a mesh to places_m [m], (n, 3). vertices: [m], shape (v, 3); faces: shape (f, 3)."""
    corners = np.asarray(vertices, dtype=float)[np.asarray(faces)]
    places = np.asarray(places_m, dtype=float)
    if places.ndim != 2 or places.shape[1] != 3 or len(places) == 0 or not np.isfinite(places).all():
        raise MeasurementError(f"places have shape {places.shape}; give finite numbers of shape (n, 3)")
    count = min(CANDIDATES, len(corners))
    near = cKDTree(corners.mean(axis=1)).query(places, k=count)[1].reshape(-1)
    targets = np.repeat(places, count, axis=0)
    closest = trimesh.triangles.closest_point(MILLIMETRES * corners[near], MILLIMETRES * targets) / MILLIMETRES
    gaps = np.linalg.norm(closest - targets, axis=1).reshape(len(places), count)
    row = np.arange(len(places)) * count + gaps.argmin(axis=1)
    chosen = near[row]
    shares = trimesh.triangles.points_to_barycentric(MILLIMETRES * corners[chosen], MILLIMETRES * closest[row])
    return Places(np.asarray(chosen), np.asarray(shares), gaps.min(axis=1), np.asarray(closest[row]))
