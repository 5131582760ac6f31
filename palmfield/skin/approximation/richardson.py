"""Error of a solution from the difference of two solutions (Richardson's rule)."""

from typing import Any

import numpy as np

from palmfield.types import Float

FAINT = 1e-3
"""Share of the largest motion that is the least reference for the errors of a point at a single time."""
STILL = 1e-9
"""Share of the largest motion below which a point counts as not moving."""


def error_of_finer(difference: Any, ratio: float, order: Any) -> Any:
    """Return the error of the finer of two solutions with an error proportional to size**order of elements or steps.

    ratio: size of elements or steps of the coarser solution over that of the finer, > 1
    """
    return difference / (ratio**order - 1.0)


def error_of_coarser(difference: Any, ratio: float, order: Any) -> Any:
    """Return the error of the coarser solution; arguments as for `error_of_finer`."""
    return difference / (1.0 - ratio**-order)


def relative_difference(solution: Float, reference: Float) -> float:
    """Return the relative difference of displacements, (t, n, 3), L2 over times, at the worst moving point."""
    size, difference = (np.linalg.norm(values, axis=(0, 2)) for values in (reference, reference - solution))
    return largest_share(difference, size)


def differences(solution: tuple[Float, Float], reference: tuple[Float, Float], normals: Float) -> Float:
    """Return the relative differences of the QUANTITIES: displacement, velocity and normal displacement, (3,).

    solution, reference: displacements and velocities, (t, n, 3) each; normals: of the face at the points, (n, 3)
    At a single time the result is that of difference_at_rest.
    """
    along = tuple(np.einsum("tnc,nc->tn", u[0], normals)[..., None] for u in (solution, reference))
    measure = difference_at_rest if len(reference[0]) == 1 else relative_difference
    pairs = ((solution[0], reference[0]), (solution[1], reference[1]), along)
    return np.array([measure(one, other) for one, other in pairs])


def difference_at_rest(solution: Float, reference: Float) -> float:
    """Return relative_difference at a single time, (1, n, 3), where FAINT of the largest motion is the least reference.

    Two solutions may agree at a point by chance. So the result is at least half of the largest difference over the
    largest motion, each over all points.
    """
    size, difference = (np.linalg.norm(values, axis=(0, 2)) for values in (reference, reference - solution))
    most = float(size.max(initial=0.0))
    if most == 0.0:
        return 0.0
    return max(
        largest_share(difference, np.maximum(size, FAINT * most)), 0.5 * float(difference.max(initial=0.0)) / most
    )


def largest_share(difference: Float, size: Float) -> float:
    """Return the largest difference / size over the moving points, all (n,); 0 if no point moves."""
    moving = size > STILL * size.max(initial=0.0)
    return float((difference[moving] / size[moving]).max(initial=0.0))
