"""Find self-intersections of a mesh."""

import numpy as np
import warp as wp

import warp_kernels.selfcross as kernels
from palmfield.device import resolve, run_kernel
from palmfield.types import Float, Int


def crossings(vertices: Float, faces: Int) -> Int:
    """Return the sorted pairs of faces that intersect each other, shape (k, 2).

    vertices: [m], shape (n, 3); faces: shape (m, 3)
    Faces with a common edge are not tested, so a strip folded flat onto itself along one edge is not detected.
    Overlapping faces in one plane are detected if an edge of one leaves the plane of the other.
    """
    if len(faces) == 0:
        return np.zeros((0, 2), dtype=np.int32)
    middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    moved = vertices - middle
    device = resolve("cpu")
    mesh = wp.Mesh(
        wp.array(moved.astype(np.float32), dtype=wp.vec3, device=device),
        wp.array(faces.astype(np.int32).ravel(), dtype=wp.int32, device=device),
    )
    at: wp.array = wp.array(moved, dtype=wp.vec3d, device=device)
    corners: wp.array = wp.array(faces.astype(np.int32), dtype=wp.int32, device=device)
    margin = 1e-6 * float(np.abs(moved).max())
    room = max(1024, len(faces))
    while True:
        count = wp.zeros(1, dtype=wp.int32, device=device)
        pairs = wp.zeros((room, 2), dtype=wp.int32, device=device)
        run_kernel(
            kernels.crossing_faces, dim=len(faces), inputs=[mesh.id, at, corners, margin, count, pairs], device=device
        )
        needed = int(count.numpy()[0])
        if needed <= room:
            found = pairs.numpy()[:needed]
            return found[np.lexsort((found[:, 1], found[:, 0]))].astype(np.int32)
        room = needed
