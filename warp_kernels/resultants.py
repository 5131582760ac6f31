"""Force and torque of a pressure on the parts of bodies, summed in float64 in a fixed order."""

import warp as wp

from warp_kernels import EXACT

wp.set_module_options(EXACT)

LANES = 16
"""Number of threads per part, among which its runs are divided."""


@wp.kernel
def mean_load(
    counts: wp.array2d(dtype=wp.int32),
    weights: wp.array2d(dtype=wp.float64),
    arp: wp.array2d(dtype=wp.float32),
    areas: wp.array2d(dtype=wp.float64),
    points: wp.array2d(dtype=wp.vec3),
    normals: wp.array2d(dtype=wp.vec3),
    corners: wp.array(dtype=wp.vec3),
    result: wp.array2d(dtype=wp.float64),
):
    """Compute weighted sums of ARPs, (w m, n) [Pa], times the area of each point [m2], (w, n); dim: (w, n).

    counts[w, 1]: number of used ARPs, of m; weights: shape (w, m)
    corners: of a convex hull of all transducers; the pressure is zero if the whole hull is behind the surface
    """
    w, i = wp.tid()
    nearest = wp.float32(-wp.inf)
    for j in range(corners.shape[0]):
        nearest = wp.max(nearest, wp.dot(corners[j] - points[w, i], normals[w, i]))
    total = wp.float64(0.0)
    if nearest > 0.0:
        for m in range(counts[w, 1]):
            total += weights[w, m] * wp.float64(arp[w * weights.shape[1] + m, i])
    result[w, i] = total * areas[w, i]


@wp.kernel
def sums_of_runs(
    load: wp.array2d(dtype=wp.float64),
    points: wp.array2d(dtype=wp.vec3),
    normals: wp.array2d(dtype=wp.vec3),
    order: wp.array(dtype=wp.int32),
    starts: wp.array(dtype=wp.int32),
    parts: wp.array(dtype=wp.int32),
    origins: wp.array2d(dtype=wp.vec3d),
    result: wp.array3d(dtype=wp.float64),
):
    """Compute force [N] and torque about the origin of the part [N m] of each run of points, shape (w, runs, 6).

    load: inward [N]; order: points of the runs; run i is order[starts[i]:starts[i + 1]]
    parts: part of each run; origins: of the parts [m]
    """
    w, run = wp.tid()
    origin = origins[w, parts[run]]
    force = wp.vec3d()
    torque = wp.vec3d()
    for j in range(starts[run], starts[run + 1]):
        i = order[j]
        push = -load[w, i] * wp.vec3d(normals[w, i])
        force += push
        torque += wp.cross(wp.vec3d(points[w, i]) - origin, push)
    for axis in range(3):
        result[w, run, axis] = force[axis]
        result[w, run, 3 + axis] = torque[axis]


@wp.kernel
def sums_of_parts(
    runs: wp.array3d(dtype=wp.float64), starts: wp.array(dtype=wp.int32), result: wp.array4d(dtype=wp.float64)
):
    """Sum the runs of each part, starts[i] to starts[i + 1], in LANES, (w, LANES, parts, 6); dim: (w, LANES, parts)."""
    w, lane, part, axis = wp.tid()
    total = wp.float64(0.0)
    for run in range(starts[part] + lane, starts[part + 1], LANES):
        total += runs[w, run, axis]
    result[w, lane, part, axis] = total


@wp.kernel
def sums_of_lanes(lanes: wp.array4d(dtype=wp.float64), result: wp.array3d(dtype=wp.float64)):
    """Sum the results of `sums_of_parts`, shape (w, parts, 6); dim: the same."""
    w, part, axis = wp.tid()
    total = wp.float64(0.0)
    for lane in range(LANES):
        total += lanes[w, lane, part, axis]
    result[w, part, axis] = total
