"""Forms of the linear solid for warp.fem, in millimetres, in their own file because Warp reads their source."""

import warp as wp
from warp import fem


@fem.integrand
def deviatoric(s: fem.Sample, u: fem.Field, v: fem.Field):
    a = fem.D(u, s)
    b = fem.D(v, s)
    return 2.0 * wp.ddot(a, b) - 2.0 / 3.0 * wp.trace(a) * wp.trace(b)


@fem.integrand
def volumetric(s: fem.Sample, u: fem.Field, v: fem.Field):
    return fem.div(u, s) * fem.div(v, s)


@fem.integrand
def inertia(s: fem.Sample, u: fem.Field, v: fem.Field):
    return wp.dot(fem.inner(u, s), fem.inner(v, s))


@fem.integrand
def load(s: fem.Sample, domain: fem.Domain, v: fem.Field, width: float, slope: float):
    """Return the pressure of a Gaussian spot on the face z = 0."""
    x = fem.position(domain, s)
    p = wp.where(x[2] > -1.0e-4, wp.exp(-slope * (x[0] * x[0] + x[1] * x[1]) / (width * width)), 0.0)
    return -p * fem.inner(v, s)[2]
