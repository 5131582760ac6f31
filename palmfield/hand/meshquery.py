"""Point and ray queries on triangle meshes: Warp finds the face, the position on it is in double precision."""

import numpy as np
import warp as wp

import warp_kernels.mesh_query as kernels
from palmfield.device import resolve, run_kernel
from palmfield.types import Float, Int

GRAZING_COSINE = 0.05


def build_mesh(vertices: Float, faces: Int) -> wp.Mesh:
    """Build the bounding volume hierarchy of a mesh, on the CPU."""
    return wp.Mesh(
        wp.array(vertices.astype(np.float32), dtype=wp.vec3, device=resolve("cpu")),
        wp.array(faces.astype(np.int32).ravel(), dtype=wp.int32, device="cpu"),
    )


def closest_faces(mesh: wp.Mesh, points: Float, reach_m: float) -> Int:
    """Return the nearest face of each point, shape (n,); -1 if none is within `reach_m`."""
    out = wp.empty(len(points), dtype=wp.int32, device="cpu")
    at: wp.array = wp.array(points.astype(np.float32), dtype=wp.vec3, device="cpu")
    run_kernel(kernels.closest_face, dim=len(points), inputs=[mesh.id, at, reach_m], outputs=[out], device="cpu")
    return out.numpy()


def barycentric(corners: Float, points: Float) -> Float:
    """Return corner weights at the projection of each point, clipped to the triangle; corners (n, 3, d) -> (n, 3)."""
    a, u, v = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    w = points - a
    uu, uv, vv = (np.einsum("ij,ij->i", *pair) for pair in ((u, u), (u, v), (v, v)))
    wu, wv = np.einsum("ij,ij->i", w, u), np.einsum("ij,ij->i", w, v)
    determinant = uu * vv - uv * uv
    s, t = (vv * wu - uv * wv) / determinant, (uu * wv - uv * wu) / determinant
    weights = np.clip(np.stack([1.0 - s - t, s, t], axis=1), 0.0, 1.0)
    return weights / weights.sum(axis=1, keepdims=True)


def over_plane(plane: Float, faces: Int, places: Float) -> tuple[Int, Float]:
    """Return the corners of the triangle over each point of a plane and their weights, both of shape (n, 3).

    plane: positions of the vertices in the plane [m], shape (v, 2); places: points of the plane, shape (n, 2)
    A point outside all triangles gets the nearest triangle.
    """
    flat, queries = (np.column_stack([xy, np.zeros(len(xy))]) for xy in (plane, places))
    reach = 4.0 * float(np.abs(flat).max() + np.abs(queries).max()) + 1e-6
    corners = faces[closest_faces(build_mesh(flat, faces), queries, reach)]
    return corners, barycentric(plane[corners], places)


def exit_distances(vertices: Float, faces: Int, origins: Float, directions: Float, reach_m: float) -> Float:
    """Return the distance along unit `directions` at which each ray leaves a closed mesh [m], shape (n,), or inf."""
    mesh = build_mesh(vertices, faces)
    out = wp.empty(len(origins), dtype=wp.int32, device="cpu")
    at: wp.array = wp.array(origins.astype(np.float32), dtype=wp.vec3, device="cpu")
    along: wp.array = wp.array(directions.astype(np.float32), dtype=wp.vec3, device="cpu")
    run_kernel(
        kernels.exit_face,
        dim=len(origins),
        inputs=[mesh.id, at, along, 1e-5, reach_m, GRAZING_COSINE],
        outputs=[out],
        device="cpu",
    )
    face = out.numpy()
    hit = face >= 0
    corners = vertices[faces[face[hit]]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    height = np.einsum("ij,ij->i", corners[:, 0] - origins[hit], normal)
    distance = np.full(len(origins), np.inf)
    distance[hit] = height / np.einsum("ij,ij->i", directions[hit], normal)
    return distance
