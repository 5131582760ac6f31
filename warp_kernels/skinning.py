"""Linear blend skinning of a triangle mesh, with normals and faces."""

import warp as wp

from warp_kernels import EXACT

wp.set_module_options(EXACT)


@wp.kernel
def blend_bones(
    rest: wp.array[wp.vec3],
    bones: wp.array[wp.vec4i],
    weights: wp.array[wp.vec4],
    rotations: wp.array[wp.mat33],
    shifts: wp.array[wp.vec3],
    out: wp.array[wp.vec3],
):
    """Move vertices by the weighted mean of up to four bone motions; a bone moves x to rotation x + shift."""
    i = wp.tid()
    rotation = wp.mat33()
    shift = wp.vec3()
    for k in range(4):
        bone = bones[i][k]
        rotation += weights[i][k] * rotations[bone]
        shift += weights[i][k] * shifts[bone]
    out[i] = rotation * rest[i] + shift


@wp.kernel
def normals_by_angle(
    vertices: wp.array[wp.vec3],
    faces: wp.array2d[wp.int32],
    first: wp.array[wp.int32],
    corners: wp.array[wp.int32],
    out: wp.array[wp.vec3],
):
    """Compute vertex normals as means of the face normals, weighted by corner angle.

    The corners of vertex i are corners[first[i]:first[i + 1]], each three times the face number plus the corner number.
    """
    i = wp.tid()
    total = wp.vec3()
    here = vertices[i]
    for n in range(first[i], first[i + 1]):
        face = corners[n] / 3
        place = corners[n] % 3
        u = vertices[faces[face, (place + 1) % 3]] - here
        v = vertices[faces[face, (place + 2) % 3]] - here
        across = wp.cross(u, v)
        twice_area = wp.length(across)
        if twice_area > 0.0:
            total += wp.atan2(twice_area, wp.dot(u, v)) / twice_area * across
    out[i] = wp.normalize(total)


@wp.kernel
def face_samples(
    vertices: wp.array[wp.vec3d],
    faces: wp.array[wp.vec3i],
    centroids: wp.array[wp.vec3d],
    normals: wp.array[wp.vec3d],
    areas: wp.array[wp.float64],
):
    """Compute centroid, unit normal and area of each face; the normal of a face without area is zero."""
    i = wp.tid()
    face = faces[i]
    a = vertices[face[0]]
    b = vertices[face[1]]
    c = vertices[face[2]]
    across = wp.cross(b - a, c - a)
    twice = wp.length(across)
    centroids[i] = (a + b + c) / wp.float64(3.0)
    areas[i] = wp.float64(0.5) * twice
    normals[i] = across / wp.where(twice > wp.float64(0.0), twice, wp.float64(1.0))
