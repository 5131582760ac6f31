"""Find faces of a triangle mesh that intersect each other."""

import warp as wp

from warp_kernels import EXACT

wp.set_module_options(EXACT)


@wp.func
def pierces(p: wp.vec3d, q: wp.vec3d, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d) -> wp.bool:
    """Return whether a segment, with its ends, meets a triangle that is not parallel (Moller & Trumbore 1997)."""
    along = q - p
    e1 = b - a
    e2 = c - a
    h = wp.cross(along, e2)
    det = wp.dot(e1, h)
    scale = wp.length(along) * wp.length(e1) * wp.length(e2)
    hit = wp.bool(False)
    if wp.abs(det) > wp.float64(1.0e-12) * scale:
        s = (p - a) / det
        u = wp.dot(s, h)
        r = wp.cross(s, e1)
        v = wp.dot(along, r)
        t = wp.dot(e2, r)
        zero = wp.float64(0.0)
        one = wp.float64(1.0)
        hit = u >= zero and v >= zero and u + v <= one and t >= zero and t <= one
    return hit


@wp.kernel
def crossing_faces(
    mesh: wp.uint64,
    vertices: wp.array[wp.vec3d],
    faces: wp.array2d[wp.int32],
    margin: wp.float32,
    count: wp.array[wp.int32],
    pairs: wp.array2d[wp.int32],
):
    """Find pairs i < j of faces that intersect, without neighbours that share an edge.

    For faces with one common corner the edges opposite to it are tested, otherwise all edges of both.
    margin: widening of the boxes, since those of the mesh are rounded; count: number of all pairs, also unstored ones
    """
    i = wp.tid()
    low = wp.vec3(wp.inf, wp.inf, wp.inf)
    high = -low
    for n in range(3):
        x = vertices[faces[i, n]]
        here = wp.vec3(wp.float32(x[0]), wp.float32(x[1]), wp.float32(x[2]))
        low = wp.min(low, here)
        high = wp.max(high, here)
    rim = wp.vec3(margin, margin, margin)
    query = wp.mesh_query_aabb(mesh, low - rim, high + rim)
    j = wp.int32(0)
    while wp.mesh_query_aabb_next(query, j):
        if j > i:
            shared = wp.int32(0)
            mine = wp.int32(0)
            other = wp.int32(0)
            for n in range(3):
                for m in range(3):
                    if faces[i, n] == faces[j, m]:
                        shared += 1
                        mine = n
                        other = m
            hit = wp.bool(False)
            if shared < 2:
                a0 = vertices[faces[i, 0]]
                a1 = vertices[faces[i, 1]]
                a2 = vertices[faces[i, 2]]
                b0 = vertices[faces[j, 0]]
                b1 = vertices[faces[j, 1]]
                b2 = vertices[faces[j, 2]]
                for n in range(3):
                    # Edge opposite to corner n
                    if shared == 0 or n == mine:
                        p = vertices[faces[i, (n + 1) % 3]]
                        q = vertices[faces[i, (n + 2) % 3]]
                        hit = hit or pierces(p, q, b0, b1, b2)
                    if shared == 0 or n == other:
                        p = vertices[faces[j, (n + 1) % 3]]
                        q = vertices[faces[j, (n + 2) % 3]]
                        hit = hit or pierces(p, q, a0, a1, a2)
            if hit:
                place = wp.atomic_add(count, 0, 1)
                if place < pairs.shape[0]:
                    pairs[place, 0] = i
                    pairs[place, 1] = j
