"""Make a second mesh of a layer, and estimate the error of the first from their difference, by Richardson's rule."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from palmfield.estimate.cost import COARSER, FINER
from palmfield.estimate.numerics.point_response import Response, changes
from palmfield.skin.approximation.estimate import ORDER
from palmfield.skin.approximation.richardson import error_of_coarser, error_of_finer
from palmfield.skin.reduction.reducer import TOLERANCE
from palmfield.skin.scene_layer import SceneLayer
from palmfield.types import Float

ALIKE = 1.3
"""Ratio of the numbers of triangles of two meshes below which their difference does not measure the error."""
LEAST_RATIO = 1.1
"""Least ratio of edges for Richardson's rule."""
FEW, FEW_CHANGES, FEW_ORDER = 2000, 4, 1.0
"""Number of unknowns below which only a few triangles lie under the spot, so that the error decreases irregularly. Then
the other mesh is finer by this power of FINER, with this order, the least observed on discs of 13 and 15 mm. A third
mesh between them shows an accidentally accurate first mesh: on discs of 25 and 30 mm the next two were less
accurate."""
COURSE_ORDER = 1.5
"""Order of the error over time: the motions of two meshes drift out of phase with time. It is lower than ORDER, since a
small ratio of edges amplifies small differences: on discs of palm and gelatin 1.8 to 3.3 was observed."""
COARSE_ORDER = 2.0
"""Order for the error of the finer mesh from a coarser one, also over time. At five points of four palms (70 to 200 Hz)
the estimate was 1.5 to 6.6 times the error; at one point it was too small by up to a fifth."""
LEAST_ROWS = 2
"""Least number of rows of elements: one row has an error of 20 %."""
MOST_CHANGES = 6
"""Largest number of refinements or coarsenings until the other mesh differs."""


class Meshes(NamedTuple):
    """Meshes of a layer to compare with its own.

    other: finer or coarser; ratio: ratio of the edges of both, above 1; between: meshes between the two.
    other_rows: a coarser mesh with another number of rows in depth; None if `other` is finer.
    """

    other: SceneLayer
    ratio: float
    between: list[SceneLayer]
    other_rows: SceneLayer | None


def meshes_to_compare(layer: SceneLayer, finer: bool) -> Meshes:
    """Return the meshes for the error of a layer by a finer or a coarser mesh. Raises SceneError as SceneLayer does.

    A coarser mesh has as many rows in depth. The error of these rows is estimated from this mesh and another coarse
    mesh.
    """
    if finer and layer.system.ndof < FEW:
        other, ratio = _other_mesh(layer, 1 / FINER, FEW_CHANGES)
        return Meshes(other, ratio, [layer.resized(FINER ** (-FEW_CHANGES // 2))], None)
    rows = len(layer.sizes.depth_fractions) - 1
    other, ratio = _other_mesh(layer, 1 / COARSER if finer else COARSER, 1, rows)
    coarse = 1.0 if finer else other.resizing
    return Meshes(other, ratio, [], layer.resized(coarse, rows - 1 if rows > LEAST_ROWS else rows + 1))


def _other_mesh(layer: SceneLayer, factor: float, changes: int, rows: int | None = None) -> tuple[SceneLayer, float]:
    """Return a layer with elements resized by factor^changes or more, and the ratio of edges, above 1.

    Small discs have equal meshes for a range of sizes, so sizes change until the meshes differ. Raises SceneError
    as SceneLayer does.
    """
    own, change = len(layer.system.mesh.surface_triangles6), factor**changes
    for _ in range(MOST_CHANGES):
        other = layer.resized(change, rows)
        more = len(other.system.mesh.surface_triangles6) / own
        if not 1.0 / ALIKE < more < ALIKE:
            break
        change *= factor
    edges = math.sqrt(max(more, 1.0 / more))
    return other, float(np.clip(edges, LEAST_RATIO, max(change, 1.0 / change)))


def mesh_error(
    coarse: Response,
    fine: Response,
    between: Sequence[Response],
    other_rows: Response | None,
    moved: dict[Response, Float],
    ratio: float,
    *,
    of_coarse: bool,
) -> tuple[float, float]:
    """Return the relative errors of displacement and velocity of one of two meshes: the larger of steady and over time.

    between: responses of meshes between the two. other_rows: other rows of the coarser mesh with another number
        of rows; the error of the rows, which is the same in the finer mesh, is added.
    moved: displacement and velocity of each over time. ratio: ratio of edges, above 1.
    of_coarse: whether to return the error of the coarser mesh or of the finer one.
    """
    change = changes(coarse, fine, moved)
    order = FEW_ORDER if between else ORDER if of_coarse else COARSE_ORDER
    of_one = error_of_coarser if of_coarse else error_of_finer
    factor, over_time = (of_one(1.0, ratio, each) for each in (order, min(order, COURSE_ORDER) if of_coarse else order))
    velocity = velocity_error(moved[coarse][1], moved[fine][1], over_time)
    errors = [max(factor * change.steady, over_time * change.moved), max(factor * change.harmonic, velocity)]
    # If distant sound is too irregular for a reduced model, report at least the error of the model
    least = max((each.small.error for each in (coarse, fine) if each.small.error > TOLERANCE), default=0.0)
    errors = [max(each, least) for each in errors]
    if other_rows is not None:
        rows, others = (len(each.layer.sizes.depth_fractions) - 1 for each in (coarse, other_rows))
        of_rows = error_of_coarser if others > rows else error_of_finer
        factor, change = of_rows(1.0, max(others / rows, rows / others), ORDER), changes(coarse, other_rows, moved)
        errors[0] += factor * max(change.steady, change.moved)
        velocity = velocity_error(moved[coarse][1], moved[other_rows][1], factor)
        errors[1] += max(factor * change.harmonic, velocity)
    for response in between:
        more = len(fine.layer.system.mesh.surface_triangles6) / len(response.layer.system.mesh.surface_triangles6)
        left, factor = changes(response, fine, moved), error_of_finer(1.0, max(math.sqrt(more), LEAST_RATIO), order)
        errors[0] = max(errors[0], max(change.steady, change.moved) + factor * max(left.steady, left.moved))
        velocity = velocity_error(moved[response][1], moved[fine][1], factor)
        errors[1] = max(errors[1], max(change.harmonic, change.velocity) + max(factor * left.harmonic, velocity))
    return errors[0], errors[1]


def velocity_error(one: Float, other: Float, factor: float) -> float:
    """Return the error of a velocity over time, (t, p), from another one, relative to the other one; as `Changes`.

    factor: ratio of error and difference at frequencies that both meshes resolve. At a frequency where the two are out
    of phase, the true motion differs from each as much as they differ from each other, so that no factor applies.
    """
    mine, theirs = (np.abs(np.fft.rfft(each, axis=0)) for each in (one, other))
    difference = np.abs(np.fft.rfft(one - other, axis=0))
    errors = np.minimum(factor * difference, np.maximum(difference, np.hypot(mine, theirs)))
    parts = (
        (float(np.linalg.norm(each[:, points])) for each in (errors, theirs)) for points in (slice(None), slice(1))
    )
    return max(error / size if size > 0.0 else 0.0 for error, size in parts)
