"""Commanded and emitted drive for a moving focus, in float64: phases, level and the pole of each transducer."""

import warp as wp

from warp_kernels import EXACT

wp.set_module_options(EXACT)

LANES = 32
"""Number of partial sums over the transducers."""
NEAREST_M = 1.0e-9


@wp.struct
class Focusing:
    """Data to focus the sound of n transducers.

    places, facing: position [m] and unit direction of each; gains: complex strength at full drive [Pa m]
    parts: row of `shapes` of each, shape (n,); shapes: directivity as polynomials in sin^2 of the angle, lowest power
        first, shape (parts, c)
    wavenumber: [1/m]; absorption_Np_m: amplitude absorption [Np/m]
    """

    places: wp.array(dtype=wp.vec3d)
    facing: wp.array(dtype=wp.vec3d)
    gains: wp.array(dtype=wp.vec2d)
    parts: wp.array(dtype=wp.int32)
    shapes: wp.array2d(dtype=wp.float64)
    wavenumber: wp.float64
    absorption_Np_m: wp.float64


@wp.func
def times(a: wp.vec2d, b: wp.vec2d):
    return wp.vec2d(a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0])


@wp.kernel
def focus_waves(
    focusing: Focusing,
    counts: wp.array2d(dtype=wp.int32),
    foci: wp.array2d(dtype=wp.vec3d),
    waves: wp.array3d(dtype=wp.vec2d),
    strengths: wp.array3d(dtype=wp.vec2d),
):
    """Compute exp(-i k d) of each transducer that faces a focus, else 0, and its pressure there at full drive [Pa].

    foci: [m], shape (w, f); the first counts[w, 0] are used. waves, strengths: complex, shape (w, f, n); dim: (w, f, n)
    """
    w, m, e = wp.tid()
    if m < counts[w, 0]:
        way = foci[w, m] - focusing.places[e]
        distance = wp.length(way)
        height = wp.dot(way, focusing.facing[e])
        wave = wp.vec2d()
        strength = wp.vec2d()
        if height > wp.float64(0.0):
            turn = focusing.wavenumber * distance
            wave = wp.vec2d(wp.cos(turn), -wp.sin(turn))
            far = wp.max(distance, wp.float64(NEAREST_M))
            cosine = height / far
            square = wp.max(wp.float64(1.0) - cosine * cosine, wp.float64(0.0))
            shape = wp.float64(0.0)
            terms = focusing.shapes.shape[1]
            for k in range(terms):
                shape = shape * square + focusing.shapes[focusing.parts[e], terms - 1 - k]
            strength = focusing.gains[e] * (shape * wp.exp(-focusing.absorption_Np_m * distance) / far)
        waves[w, m, e] = wave
        strengths[w, m, e] = strength


@wp.kernel
def focus_sums(
    counts: wp.array2d(dtype=wp.int32),
    waves: wp.array3d(dtype=wp.vec2d),
    strengths: wp.array3d(dtype=wp.vec2d),
    sums: wp.array3d(dtype=wp.vec3d),
):
    """Compute partial sums of the pressure at each focus at full drive [Pa] and of the number of transducers that face
    it; dim: (w, f, LANES)."""
    w, m, lane = wp.tid()
    if m < counts[w, 0]:
        total = wp.vec3d()
        for e in range(lane, waves.shape[2], LANES):
            faces = wp.where(wp.length_sq(waves[w, m, e]) > wp.float64(0.0), wp.float64(1.0), wp.float64(0.0))
            total += wp.vec3d(strengths[w, m, e][0], strengths[w, m, e][1], faces)
        sums[w, m, lane] = total


@wp.kernel
def focus_levels(
    counts: wp.array2d(dtype=wp.int32),
    aims: wp.array(dtype=wp.vec2d),
    sums: wp.array3d(dtype=wp.vec3d),
    targets: wp.array2d(dtype=wp.float64),
    levels: wp.array2d(dtype=wp.float64),
    totals: wp.array2d(dtype=wp.vec3d),
):
    """Compute the level of the drive for each focus, times its target, 0 to 1; the last twice; dim: (w, f + 1).

    aims: by world, ARP at the focus times rho c^2 [Pa^2], or 0 and the amplitude of the drive
    totals: totals of the partial sums `sums` of each focus
    """
    w, m = wp.tid()
    if m <= counts[w, 0]:
        focus = wp.min(m, counts[w, 0] - 1)
        total = wp.vec3d()
        for lane in range(LANES):
            total += sums[w, focus, lane]
        level = aims[w][1]
        if aims[w][0] > wp.float64(0.0):
            full = total[0] * total[0] + total[1] * total[1]
            level = wp.float64(0.0)
            if full > wp.float64(0.0):
                level = wp.sqrt(aims[w][0] / full)
        levels[w, m] = targets[w, m] * level
        if m < counts[w, 0]:
            totals[w, m] = total


@wp.func
def single(value: wp.vec2d):
    return wp.vec2(wp.float32(value[0]), wp.float32(value[1]))


@wp.kernel
def ring_along(
    counts: wp.array2d(dtype=wp.int32),
    group: wp.array2d(dtype=wp.int32),
    rings: wp.int32,
    waves: wp.array3d(dtype=wp.vec2d),
    levels: wp.array2d(dtype=wp.float64),
    weights: wp.array2d(dtype=wp.vec2d),
    pushes: wp.array(dtype=wp.int32),
    scales: wp.array(dtype=wp.vec2d),
    order: wp.array(dtype=wp.int32),
    begun: wp.array2d(dtype=wp.vec2d),
    load: wp.array2d(dtype=wp.vec2),
    force: wp.array2d(dtype=wp.vec2),
    now: wp.array2d(dtype=wp.vec2),
    end: wp.array2d(dtype=wp.vec2d),
):
    """Compute the emission of a transducer at the moments of a step, as a pole driven by the drives; dim: (w, n).

    The last of counts[w, 0] foci is that at the start of the step. The others are those of the moments, counts[w, 1]
    for each, of which `group` selects the focus of a transducer. rings: 0 if the transducer has no ring-up
    weights: by moment, weights of the emission before, of the drives at the moment before and at this moment, and, for
        a held part, of emission and drive for half of it; complex, shape (m, 5)
    pushes: row of `force` for each moment, -1 for none, shape (m,)
    scales: strength at full drive [Pa m]; order: column of each transducer in the tables of drives
    begun, end: emission at start and end of the step, relative to full drive; zero at the end without foci
    load: table of the drives at the moments [Pa m]; force: the same for transducers with ring-up, else the focus at the
        start with the level of the loudest moment; now: emission at the start
    """
    w, e = wp.tid()
    if counts[w, 0] == 0:
        end[w, e] = wp.vec2d()
        return
    column = order[e]
    scale = scales[e]
    last = counts[w, 0] - 1
    groups = counts[w, 1]
    moments = last // groups
    own = group[w, e]
    emitted = begun[w, e]
    # Rows of the tables with the drives of this world
    loads = load.shape[0] // counts.shape[0]
    load_row = w * loads
    force_row = w * (force.shape[0] // counts.shape[0])
    now_row = w * (now.shape[0] // counts.shape[0])
    before = wp.vec2d()
    for j in range(moments):
        focus = j * groups + own
        drive = levels[w, focus] * waves[w, focus, e]
        if rings == 0:
            load[load_row + j, column] = single(times(scale, drive))
        else:
            emitted = times(weights[j, 0], emitted) + times(weights[j, 1], before) + times(weights[j, 2], drive)
            push = times(weights[j, 4], drive)
            emitted = times(weights[j, 3], emitted) + push
            load[load_row + j, column] = single(times(scale, emitted))
            if pushes[j] >= 0:
                force[force_row + pushes[j], column] = load[load_row + j, column]
            emitted = times(weights[j, 3], emitted) + push
        before = drive
    for j in range(moments, loads):
        load[load_row + j, column] = wp.vec2()
    if rings == 0:
        force[force_row, column] = single(times(scale, levels[w, last] * waves[w, last, e]))
        now[now_row, column] = single(times(scale, levels[w, last + 1] * waves[w, last, e]))
    else:
        now[now_row, column] = single(times(scale, begun[w, e]))
    end[w, e] = emitted
