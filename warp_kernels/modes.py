"""Substeps of independent modes. Each mode has a small state, which a substep multiplies by a small matrix.

On the CPU, WIDTH modes are adjacent in memory, so that one instruction computes several of them.
"""

import warp as wp

from warp_kernels import FUSED

wp.set_module_options(FUSED)

WIDTH = 8
lanes = wp.types.vector(length=WIDTH, dtype=wp.float64)


@wp.struct
class Modes:
    """Modes in groups of WIDTH. In a substep a state of r rows becomes advance @ state + input * force.

    advance: shape (g, r, r); inputs: shape (g, r)
    """

    advance: wp.array3d(dtype=lanes)
    inputs: wp.array2d(dtype=lanes)


@wp.kernel
def step_modes(
    modes: Modes,
    forces: wp.array3d(dtype=lanes),
    rows: wp.array3d(dtype=lanes),
    old: wp.array3d(dtype=lanes),
    seen: wp.array4d(dtype=lanes),
):
    """Compute all substeps of a group of modes.

    forces: of each substep, (w, s, g); rows: state, (w, r, g); old: work array for a state; seen: displacement and
    velocity after each substep, (w, s, 2, g)
    """
    world, group = wp.tid()
    count = rows.shape[1]
    for substep in range(forces.shape[1]):
        force = forces[world, substep, group]
        for i in range(count):
            old[world, i, group] = rows[world, i, group]
        for i in range(count):
            total = wp.cw_mul(modes.inputs[group, i], force)
            for j in range(count):
                total = total + wp.cw_mul(modes.advance[group, i, j], old[world, j, group])
            rows[world, i, group] = total
        for i in range(2):
            seen[world, substep, i, group] = rows[world, i, group]
