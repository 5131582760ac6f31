"""Influence of pressure at each place of a skin on one point: gives the response of that point to every load.

The matrices Z are symmetric, so that a reading of displacement Z^-1 f is read Z^-1 f = (Z^-1 read^T)^T f: one
solution for the point serves all pressures. It is stored on disk; a factor would take a thousand times the space.
"""

from palmfield import cache
from palmfield.skin.fem.assembly import SkinSystem
from palmfield.skin.fem.load import SurfaceQuadrature
from palmfield.skin.fem.probe import SurfaceProbe
from palmfield.skin.fem.solver import harmonic, harmonic_both, static
from palmfield.types import Complex, Float


def static_influence(system: SkinSystem, quadrature: SurfaceQuadrature, point: Float) -> Float:
    """Normal displacement at rest for a pressure of 1 Pa at each point of the quadrature [m/Pa], (q,).

    point: it is read where the skin is nearest to it [m], shape (3,)
    Kept in the cache (`palmfield.cache`). Raises SceneError as `palmfield.skin.fem.solver.static`.
    """

    def make() -> cache.Arrays:
        return {"static": quadrature.operator.T @ static(system, _reading(system, point))}

    return cache.kept("influence", (system.made_of, point), make)["static"]


def harmonic_influence(
    system: SkinSystem, quadrature: SurfaceQuadrature, point: Float, f_Hz: float, step_s: float | None = None
) -> tuple[Complex, Complex]:
    """The same under e^{-i w t}: exact in time, and by the scheme of WedgeStepper, shapes (q,) [m/Pa].

    f_Hz: frequency [Hz]; step_s: substep of the scheme [s]; None leaves the second as the first
    """

    def make() -> cache.Arrays:
        read = _reading(system, point)
        if step_s is None:
            exact = scheme = harmonic(system, read, f_Hz)
        else:
            exact, scheme = harmonic_both(system, read, f_Hz, step_s)
        return {"exact": quadrature.operator.T @ exact, "scheme": quadrature.operator.T @ scheme}

    known = cache.kept("influence", (system.made_of, point, f_Hz, step_s), make)
    return known["exact"], known["scheme"]


def _reading(system: SkinSystem, point: Float) -> Float:
    read: Float = SurfaceProbe(system.mesh, point[None], system).operator.toarray()[0]
    return read
