"""Element matrices of the wedge: gradients, projected volume constraint, stiffness and mass, in float64."""

import warp as wp

from warp_kernels import EXACT

wp.set_module_options(EXACT)


@wp.kernel
def wedge_gradients(
    corners: wp.array2d(dtype=wp.vec3d),
    corner_slopes: wp.array2d(dtype=wp.vec3d),
    slopes: wp.array2d(dtype=wp.vec3d),
    rule: wp.array(dtype=wp.float64),
    gradients: wp.array3d(dtype=wp.vec3d),
    weights: wp.array2d(dtype=wp.float64),
):
    """Compute gradients of shape functions [1/m] and weight x det J [m^3], by element and quadrature point."""
    e, q = wp.tid()
    jacobian = wp.mat33d()
    for a in range(corners.shape[1]):
        jacobian += wp.outer(corners[e, a], corner_slopes[q, a])
    inverse_transposed = wp.transpose(wp.inverse(jacobian))
    weights[e, q] = wp.determinant(jacobian) * rule[q]
    for i in range(slopes.shape[1]):
        gradients[e, q, i] = inverse_transposed * slopes[q, i]


@wp.kernel
def wedge_constraint(
    gradients: wp.array3d(dtype=wp.vec3d),
    weights: wp.array2d(dtype=wp.float64),
    volume_basis: wp.array2d(dtype=wp.float64),
    constraint: wp.array3d(dtype=wp.vec3d),
    gram: wp.array3d(dtype=wp.float64),
):
    """Compute C[a, i] = integral of w_a grad N_i, and H[a, b] = integral of w_a w_b, over each element."""
    e, a = wp.tid()
    for q in range(weights.shape[1]):
        factor = weights[e, q] * volume_basis[q, a]
        for i in range(gradients.shape[2]):
            constraint[e, a, i] += factor * gradients[e, q, i]
        for b in range(volume_basis.shape[1]):
            gram[e, a, b] += factor * volume_basis[q, b]


@wp.kernel
def wedge_matrices(
    gradients: wp.array3d(dtype=wp.vec3d),
    weights: wp.array2d(dtype=wp.float64),
    shape: wp.array2d(dtype=wp.float64),
    constraint: wp.array3d(dtype=wp.vec3d),
    gram_inverse: wp.array3d(dtype=wp.float64),
    deviatoric: wp.array3d(dtype=wp.mat33d),
    volumetric: wp.array3d(dtype=wp.mat33d),
    mass: wp.array3d(dtype=wp.float64),
):
    """Compute blocks (i, j) of the element matrices for unit shear modulus, unit bulk modulus and unit density.

    Deviatoric: 2 dev(eps) : dev(eps) = grad u : grad u + grad u : grad u^T - 2/3 (div u)^2.
    Volumetric: C^T H^-1 C, the square of the volumetric strain projected on the volume basis.
    """
    e, i, j = wp.tid()
    two_thirds = wp.float64(2.0) / wp.float64(3.0)
    stiffness = wp.mat33d()
    inertia = wp.float64(0.0)
    for q in range(weights.shape[1]):
        w = weights[e, q]
        a = gradients[e, q, i]
        b = gradients[e, q, j]
        scaled = w * a
        stiffness += wp.outer(wp.cw_mul(b, wp.vec3d(w, w, w)), a) - two_thirds * wp.outer(scaled, b)
        inner = wp.dot(scaled, b)
        stiffness += wp.mat33d(
            inner, wp.float64(0.0), wp.float64(0.0),
            wp.float64(0.0), inner, wp.float64(0.0),
            wp.float64(0.0), wp.float64(0.0), inner,
        )  # fmt: skip
        inertia += w * shape[q, i] * shape[q, j]
    deviatoric[e, i, j] = stiffness
    mass[e, i, j] = inertia
    compression = wp.mat33d()
    for c in range(constraint.shape[1]):
        projected = wp.vec3d()
        for d in range(constraint.shape[1]):
            projected += gram_inverse[e, c, d] * constraint[e, d, j]
        compression += wp.outer(constraint[e, c, i], projected)
    volumetric[e, i, j] = compression
