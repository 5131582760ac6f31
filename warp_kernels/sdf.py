"""Signed distance of tapered, flattened capsules under a tree of smooth unions."""

import warp as wp

from warp_kernels import EXACT

wp.set_module_options(EXACT)

FAR = wp.constant(1.0e3)


@wp.struct
class Segment:
    """A capsule whose cross-section is an ellipse with different heights on the two sides of the axis.

    start, end: axis [m]; semi_start, semi_end: half-widths at the ends: lateral, dorsal, palmar [m]
    dorsal: unit vector across the axis; group: 0 palm, 1 thumb, 2..5 fingers
    blend: radius of the smooth union with earlier segments of its group [m]
    """

    start: wp.vec3
    end: wp.vec3
    semi_start: wp.vec3
    semi_end: wp.vec3
    dorsal: wp.vec3
    group: wp.int32
    blend: wp.float32


@wp.func
def smooth_union(a: wp.float32, b: wp.float32, radius: wp.float32):
    h = wp.max(radius - wp.abs(a - b), 0.0) / radius
    return wp.min(a, b) - 0.25 * radius * h * h


@wp.func
def segment_distance(s: Segment, point: wp.vec3):
    axis = s.end - s.start
    length = wp.length(axis)
    along = axis / length
    t = wp.clamp(wp.dot(point - s.start, along) / length, 0.0, 1.0)
    semi = s.semi_start + t * (s.semi_end - s.semi_start)
    rest = point - s.start - t * axis
    lateral = wp.cross(along, s.dorsal)
    local = wp.vec3(wp.dot(rest, along), wp.dot(rest, lateral), wp.dot(rest, s.dorsal))
    height = wp.where(local[2] > 0.0, semi[1], semi[2])
    unit = wp.vec3(local[0] / semi[0], local[1] / semi[0], local[2] / height)
    slope = wp.vec3(unit[0] / semi[0], unit[1] / semi[0], unit[2] / height)
    # First-order distance to an ellipsoid: value over gradient length; exact on the surface and on the axes.
    k0 = wp.length(unit)
    k1 = wp.length(slope)
    if k1 < 1.0e-3:
        return -wp.min(semi[0], height)
    return k0 * (k0 - 1.0) / k1


@wp.func
def hand_distance(
    point: wp.vec3,
    segments: wp.array[Segment],
    thumb_blend: wp.float32,
    finger_blend: wp.float32,
    between_blend: wp.float32,
):
    palm = wp.float32(FAR)
    thumb = wp.float32(FAR)
    fingers = wp.float32(FAR)
    finger = wp.float32(FAR)
    group = wp.int32(0)
    for i in range(segments.shape[0]):
        s = segments[i]
        d = segment_distance(s, point)
        if s.group != group and s.group >= 2:
            fingers = smooth_union(fingers, finger, between_blend)
            finger = wp.float32(FAR)
        group = s.group
        if group == 0:
            palm = smooth_union(palm, d, s.blend)
        elif group == 1:
            thumb = smooth_union(thumb, d, s.blend)
        else:
            finger = smooth_union(finger, d, s.blend)
    fingers = smooth_union(fingers, finger, between_blend)
    return smooth_union(smooth_union(palm, thumb, thumb_blend), fingers, finger_blend)


@wp.kernel
def hand_distance_on_grid(
    segments: wp.array[Segment],
    thumb_blend: wp.float32,
    finger_blend: wp.float32,
    between_blend: wp.float32,
    lower: wp.vec3,
    step: wp.float32,
    out: wp.array3d[wp.float32],
):
    i, j, k = wp.tid()
    point = lower + step * wp.vec3(wp.float32(i), wp.float32(j), wp.float32(k))
    out[i, j, k] = hand_distance(point, segments, thumb_blend, finger_blend, between_blend)


@wp.kernel
def hand_distance_at_points(
    segments: wp.array[Segment],
    thumb_blend: wp.float32,
    finger_blend: wp.float32,
    between_blend: wp.float32,
    points: wp.array[wp.vec3],
    step: wp.float32,
    out: wp.array[wp.float32],
    gradient: wp.array[wp.vec3],
):
    """Compute the distance, and its gradient by central differences over `step`."""
    i = wp.tid()
    p = points[i]
    out[i] = hand_distance(p, segments, thumb_blend, finger_blend, between_blend)
    g = wp.vec3()
    for axis in range(3):
        shift = wp.vec3()
        shift[axis] = step
        above = hand_distance(p + shift, segments, thumb_blend, finger_blend, between_blend)
        below = hand_distance(p - shift, segments, thumb_blend, finger_blend, between_blend)
        g[axis] = (above - below) / (2.0 * step)
    gradient[i] = g
