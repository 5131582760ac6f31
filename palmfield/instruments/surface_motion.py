"""The moving surface measured by instruments: of a skin solver's Motion, or of a skin in a result file."""

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
"""Triangles whose centres are nearest to a place: the nearest triangle is searched among them."""
MILLIMETRES = 1e3
"""trimesh's tolerances are absolute and chosen for such numbers."""


class SurfaceMotion(NamedTuple):
    """Motion of points of a surface, in one frame.

    times_s: [s], rising, shape (t,); points: at rest [m], shape (n, 3); normals: outward unit normals, shape (n, 3)
    displacement_m: [m], velocity_m_s: [m/s], shape (t, n, 3)
    """

    times_s: Float
    points: Float
    normals: Float
    displacement_m: Float
    velocity_m_s: Float


class Places(NamedTuple):
    """Nearest places on a mesh.

    triangle: its number, shape (n,); shares: of its three corners, shape (n, 3); distance_m: to the mesh, shape (n,)
    nearest: the places on the mesh [m], shape (n, 3)
    """

    triangle: Int
    shares: Float
    distance_m: Float
    nearest: Float


def of_motion(motion: Motion, body: Body) -> SurfaceMotion:
    """Motion of a skin solver; its normals are those of the body's face."""
    return SurfaceMotion(
        np.asarray(motion.times_s, dtype=float), np.asarray(motion.points, dtype=float),
        normals_on_face(body, motion.points), motion.displacement_m, motion.velocity_m_s,
    )  # fmt: skip


def of_skin(skin: xr.Dataset, places_m: ArrayLike | None = None, off_m: float = 1e-3) -> SurfaceMotion:
    """Return motion of a skin of a result, in the resting body's frame: at its vertices, or interpolated to places.

    skin: one of `palmfield.outputs.instances(result, "skin")`
    places_m: [m], shape (n, 3); the motion there is linear between the corners of the nearest triangle. None: vertices
    off_m: a place farther off the skin than this is a MeasurementError [m]
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
    found = on_mesh(points, faces, places_m)
    worst = int(found.distance_m.argmax())
    if found.distance_m[worst] > off_m:
        place = ", ".join(f"{x:.4g}" for x in np.asarray(places_m, dtype=float)[worst])
        raise MeasurementError(
            f"point {worst} at ({place}) m lies {found.distance_m[worst]:.3g} m from the skin; allowed: {off_m:g} "
            "m; move it"
        )
    used, corners = np.unique(faces[found.triangle], return_inverse=True)
    corners = corners.reshape(-1, 3)
    motions = []
    for name in ("displacement", "velocity"):
        values = np.asarray(skin[name].isel(vertex=used).values, dtype=float)
        motions.append(np.einsum("tnci,nc->tni", values[:, corners], found.shares))
    between = np.einsum("nci,nc->ni", normals[faces[found.triangle]], found.shares)
    between /= np.linalg.norm(between, axis=1, keepdims=True)
    return SurfaceMotion(times, found.nearest, between, *motions)


def on_mesh(vertices: ArrayLike, faces: ArrayLike, places_m: ArrayLike) -> Places:
    """The nearest points of a mesh. vertices: [m], shape (v, 3); faces: shape (f, 3); places_m: [m], shape (n, 3)."""
    corners = np.asarray(vertices, dtype=float)[np.asarray(faces)]
    places = np.asarray(places_m, dtype=float)
    if places.ndim != 2 or places.shape[1] != 3 or len(places) == 0 or not np.isfinite(places).all():
        raise MeasurementError(f"places have shape {places.shape}; give finite numbers of shape (n, 3)")
    count = min(CANDIDATES, len(corners))
    near = cKDTree(corners.mean(axis=1)).query(places, k=count)[1].reshape(-1)
    asked = np.repeat(places, count, axis=0)
    closest = trimesh.triangles.closest_point(MILLIMETRES * corners[near], MILLIMETRES * asked) / MILLIMETRES
    gaps = np.linalg.norm(closest - asked, axis=1).reshape(len(places), count)
    row = np.arange(len(places)) * count + gaps.argmin(axis=1)
    chosen = near[row]
    shares = trimesh.triangles.points_to_barycentric(MILLIMETRES * corners[chosen], MILLIMETRES * closest[row])
    return Places(np.asarray(chosen), np.asarray(shares), gaps.min(axis=1), np.asarray(closest[row]))
