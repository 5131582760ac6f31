"""Move points of surfaces at rest with bodies and bones, in float64 because faces are small relative to the motion."""

import warp as wp

from warp_kernels import EXACT

wp.set_module_options(EXACT)


@wp.struct
class Motions:
    """Rigid motions: motion i of world w moves x at rest to turns[w, i] @ x + shifts[w, i] [m]."""

    turns: wp.array2d(dtype=wp.mat33d)
    shifts: wp.array2d(dtype=wp.vec3d)


@wp.struct
class Carriers:
    """Numbers of up to four motions of each point, and their weights, which add up to 1."""

    motions: wp.array(dtype=wp.vec4i)
    shares: wp.array(dtype=wp.vec4d)


@wp.func
def turn_of(carriers: Carriers, motions: Motions, world: wp.int32, i: wp.int32):
    turn = wp.mat33d()
    for k in range(4):
        turn += carriers.shares[i][k] * motions.turns[world, carriers.motions[i][k]]
    return turn


@wp.func
def place_of(carriers: Carriers, motions: Motions, rest: wp.vec3d, world: wp.int32, i: wp.int32):
    shift = wp.vec3d()
    for k in range(4):
        shift += carriers.shares[i][k] * motions.shifts[world, carriers.motions[i][k]]
    return turn_of(carriers, motions, world, i) * rest + shift


@wp.kernel
def carry_points(
    rest: wp.array(dtype=wp.vec3d),
    directions: wp.array(dtype=wp.vec3d),
    carriers: Carriers,
    motions: Motions,
    points: wp.array2d(dtype=wp.vec3),
    normals: wp.array2d(dtype=wp.vec3),
):
    """Compute points [m] and unit normals from `rest` and `directions` at rest, by the weighted mean of their motions.

    dim: (worlds, points), as for the other kernels here
    """
    w, i = wp.tid()
    points[w, i] = wp.vec3(place_of(carriers, motions, rest[i], w, i))
    normals[w, i] = wp.vec3(wp.normalize(turn_of(carriers, motions, w, i) * directions[i]))


@wp.kernel
def carry_vertices(
    rest: wp.array(dtype=wp.vec3d), carriers: Carriers, motions: Motions, vertices: wp.array2d(dtype=wp.vec3)
):
    """Compute points as `carry_points`, without normals."""
    w, i = wp.tid()
    vertices[w, i] = wp.vec3(place_of(carriers, motions, rest[i], w, i))


@wp.kernel
def carry_faces(
    rest: wp.array(dtype=wp.vec3d),
    faces: wp.array(dtype=wp.vec3i),
    carriers: Carriers,
    motions: Motions,
    points: wp.array2d(dtype=wp.vec3),
    normals: wp.array2d(dtype=wp.vec3),
    areas: wp.array2d(dtype=wp.float64),
):
    """Compute centroid [m], unit normal and area [m2] of moved faces; faces without area have the normal 0."""
    w, i = wp.tid()
    face = faces[i]
    a = place_of(carriers, motions, rest[face[0]], w, face[0])
    b = place_of(carriers, motions, rest[face[1]], w, face[1])
    c = place_of(carriers, motions, rest[face[2]], w, face[2])
    across = wp.cross(b - a, c - a)
    twice = wp.length(across)
    points[w, i] = wp.vec3((a + b + c) / wp.float64(3.0))
    areas[w, i] = wp.float64(0.5) * twice
    normals[w, i] = wp.vec3(across / wp.where(twice > wp.float64(0.0), twice, wp.float64(1.0)))
