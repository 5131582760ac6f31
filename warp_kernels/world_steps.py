"""Worlds of one scene on a device: conversion of MuJoCo's frames to motions of points, and readings of skins."""

import warp as wp

from warp_kernels import EXACT

wp.set_module_options(EXACT)


@wp.func
def seen_from_first(places: wp.array2d(dtype=wp.vec3d), world: wp.int32, row: wp.int32, turn: wp.mat33d):
    """Return the origin of a row relative to the first row, whose axes are the columns of `turn`."""
    return wp.transpose(turn) * (places[world, row] - places[world, 0])


@wp.kernel
def place_parts(
    places: wp.array2d(dtype=wp.vec3d),
    axes: wp.array2d(dtype=wp.mat33d),
    rows: wp.array(dtype=wp.int32),
    rest: wp.array(dtype=wp.vec3d),
    turns: wp.array2d(dtype=wp.mat33d),
    shifts: wp.array2d(dtype=wp.vec3d),
    origins: wp.array2d(dtype=wp.vec3d),
):
    """Compute the motions of bodies and bones relative to the frame of the first row; dim: (worlds, parts).

    places [m], axes: frames of MuJoCo, shape (worlds, rows), that of the first array first; rows: of each part, (p,)
    rest: origin of each part in the body at rest [m]; origins: present origin of each part
    """
    w, i = wp.tid()
    first = axes[w, 0]
    turn = wp.transpose(first) * axes[w, rows[i]]
    origin = seen_from_first(places, w, rows[i], first)
    turns[w, i] = turn
    shifts[w, i] = origin - turn * rest[i]
    origins[w, i] = origin


@wp.kernel
def place_foci(
    places: wp.array2d(dtype=wp.vec3d),
    axes: wp.array2d(dtype=wp.mat33d),
    row: wp.int32,
    own: wp.array2d(dtype=wp.vec3d),
    foci: wp.array2d(dtype=wp.vec3d),
):
    """Transform points of a stimulus [m], shape (worlds, f), from its frame to that of the first row; dim: the same."""
    w, i = wp.tid()
    first = axes[w, 0]
    foci[w, i] = wp.transpose(first) * (axes[w, row] * own[w, i]) + seen_from_first(places, w, row, first)


@wp.kernel
def heights(
    turns: wp.array2d(dtype=wp.mat33d),
    origins: wp.array2d(dtype=wp.vec3d),
    centres: wp.array(dtype=wp.vec3d),
    halves: wp.array(dtype=wp.vec3d),
    boards: wp.array(dtype=wp.vec4d),
    result: wp.array2d(dtype=wp.float64),
):
    """Compute the height of the lowest corner of each part's box over the highest board [m]; dim: (worlds, parts).

    centres, halves: of the boxes, in the axes of the parts [m]; boards: normal, and height of the board along it [m]
    """
    w, i = wp.tid()
    lowest = wp.float64(wp.inf)
    for b in range(boards.shape[0]):
        normal = wp.vec3d(boards[b][0], boards[b][1], boards[b][2])
        along = wp.transpose(turns[w, i]) * normal
        height = wp.dot(along, centres[i]) + wp.dot(normal, origins[w, i]) - boards[b][3]
        for axis in range(3):
            height -= wp.abs(along[axis]) * halves[i][axis]
        lowest = wp.min(lowest, height)
    result[w, i] = lowest


@wp.kernel
def sums_of_squares(parts: wp.array4d(dtype=wp.float64), result: wp.array2d(dtype=wp.float64)):
    """Sum the results of `skin_steps.squares` over substeps and lanes, shape (worlds, groups); dim: the same."""
    w, group = wp.tid()
    total = wp.float64(0.0)
    for substep in range(parts.shape[2]):
        for lane in range(parts.shape[3]):
            total += parts[w, group, substep, lane]
    result[w, group] = total


@wp.kernel
def read_modes(
    states: wp.array3d(dtype=wp.float64), matrix: wp.array2d(dtype=wp.float64), result: wp.array3d(dtype=wp.float64)
):
    """Multiply displacement and velocity of modes, the first two rows of states (w, rows, n), by a matrix (n, m).

    dim: that of the result, (w, 2, m)
    """
    w, row, column = wp.tid()
    total = wp.float64(0.0)
    for i in range(matrix.shape[0]):
        total += states[w, row, i] * matrix[i, column]
    result[w, row, column] = total


@wp.kernel
def take_over(
    active: wp.array2d(dtype=wp.int32), values: wp.array2d(dtype=wp.float64), result: wp.array2d(dtype=wp.float64)
):
    """Copy the rows of active worlds, whose first number is not 0; dim: that of the result, (worlds, n)."""
    w, i = wp.tid()
    if active[w, 0] != 0:
        result[w, i] = values[w, i]


@wp.kernel
def largest(values: wp.array2d(dtype=wp.vec2d), result: wp.array(dtype=wp.float64)):
    """Compute the largest magnitude of each row; dim: rows."""
    row = wp.tid()
    most = wp.float64(0.0)
    for i in range(values.shape[1]):
        most = wp.max(most, wp.length_sq(values[row, i]))
    result[row] = wp.sqrt(most)
