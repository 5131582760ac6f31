"""Closest faces and exit distances on a triangle mesh (a bounding volume hierarchy)."""

import warp as wp

from warp_kernels import EXACT

wp.set_module_options(EXACT)


@wp.kernel
def closest_face(
    mesh: wp.uint64,
    points: wp.array[wp.vec3],
    reach: wp.float32,
    face: wp.array[wp.int32],
):
    """Find the face nearest to each point, -1 if none is within `reach`."""
    i = wp.tid()
    query = wp.mesh_query_point_no_sign(mesh, points[i], reach)
    face[i] = wp.where(query.result, query.face, -1)


@wp.kernel
def exit_face(
    mesh: wp.uint64,
    origins: wp.array[wp.vec3],
    directions: wp.array[wp.vec3],
    start: wp.float32,
    reach: wp.float32,
    least_cosine: wp.float32,
    face: wp.array[wp.int32],
):
    """Find the first face through which each ray leaves the body, -1 if there is none.

    Faces parallel to the ray and faces through which it enters are skipped.
    """
    i = wp.tid()
    hit = wp.int32(-1)
    done = wp.int32(0)
    t = wp.float32(start)
    for _step in range(16):
        if done == 0:
            query = wp.mesh_query_ray(mesh, origins[i] + t * directions[i], directions[i], reach)
            if query.result:
                if wp.dot(query.normal, directions[i]) > least_cosine:
                    hit = query.face
                    done = 1
                t += query.t + 1.0e-6
            else:
                done = 1
    face[i] = hit
