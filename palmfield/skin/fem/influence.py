"""How much pressure at each place of a skin moves one point of it: what an answer at that point is for every load.

The matrices Z are symmetric, so that what a point of displacement Z^-1 f reads is read Z^-1 f = (Z^-1 read^T)^T f: one
solution for the point serves all pressures. It is kept on disk, where a factor would take a thousand times the room.
"""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from palmfield import cache
from palmfield.skin.fem.assembly import SkinSystem
from palmfield.skin.fem.load import SurfaceQuadrature
from palmfield.skin.fem.probe import SurfaceProbe
from palmfield.skin.fem.solver import harmonic, harmonic_both, static
from palmfield.types import Complex, Float

Answer = Literal["static", "harmonic", "discrete"]


class Influence(NamedTuple):
    """Normal displacement of a point of the skin for a pressure of 1 Pa at each point of the quadrature [m/Pa], (q,).

    static: at rest; harmonic: under e^{-i w t}; discrete: what the scheme of WedgeStepper makes of that; those that
    were not asked for are empty
    """

    static: Float
    harmonic: Complex
    discrete: Complex


def influence(
    system: SkinSystem,
    quadrature: SurfaceQuadrature,
    point: Float,
    f_Hz: float,
    step_s: float,
    answers: Sequence[Answer],
) -> Influence:
    """The influence on the place of the skin that is nearest to a point [m], shape (3,); see Influence.

    f_Hz: frequency [Hz]; step_s: substep of the scheme [s]; answers: those that are wanted
    Kept in the cache (`palmfield.cache`). Raises SceneError as `palmfield.skin.fem.solver.static`.
    """

    def make() -> cache.Arrays:
        read = SurfaceProbe(system.mesh, point[None], system).operator.toarray()[0]
        result: cache.Arrays = {}
        if "static" in answers:
            result["static"] = static(system, read)
        if "discrete" in answers:
            result["harmonic"], result["discrete"] = harmonic_both(system, read, f_Hz, step_s)
        elif "harmonic" in answers:
            result["harmonic"] = harmonic(system, read, f_Hz)
        return {name: quadrature.operator.T @ solution for name, solution in result.items()}

    depends_on = (system.made_of, point, f_Hz, step_s if "discrete" in answers else None, sorted(answers))
    known = cache.kept("influence", depends_on, make)
    none = np.zeros(0)
    return Influence(known.get("static", none), known.get("harmonic", none + 0j), known.get("discrete", none + 0j))
