"""A second mesh of a layer, and the error of the first mesh from their difference, by Richardson's rule."""

import math
from collections.abc import Sequence

import numpy as np

from palmfield.estimate.cost import RATIO
from palmfield.estimate.numerics.point_response import Response, changes
from palmfield.skin.approximation.estimate import ORDER
from palmfield.skin.approximation.richardson import error_of_coarser, error_of_finer
from palmfield.skin.reduction.point_model import TOLERANCE
from palmfield.skin.scene_layer import SceneLayer
from palmfield.types import Float

ALIKE = 1.3
"""Triangles of one mesh over those of another, below which their difference is no measure of the error."""
LEAST_RATIO = 1.1
"""Least ratio of edges for Richardson's rule."""
FEW, FEW_CHANGES, FEW_ORDER = 2000, 4, 1.0
"""Unknowns below which a mesh has a handful of triangles under the spot, whose error falls unevenly. Then the other
mesh is finer by this power of RATIO, and the order is this, the least observed on discs of 13 and 15 mm. A third mesh
between shows where the first is right by chance: on discs of 25 and 30 mm the next two were farther off."""
COURSE_ORDER = 1.5
"""Order of the error over a course of time: two meshes ring out of step, the more the longer it rings. Lower than
ORDER, as a small ratio of edges makes much of a little: on discs of palm and gelatin 1.8 to 3.3 was seen."""
MOST_CHANGES = 6
"""How often the elements of the other mesh are refined or coarsened by RATIO at most, until the two differ."""


def meshes_to_compare(layer: SceneLayer, finer: bool) -> tuple[SceneLayer, float, list[SceneLayer]]:
    """Another mesh of a layer, finer or coarser, the ratio of the edges of both, above 1, and meshes between the two.

    Raises SceneError as SceneLayer.
    """
    few = finer and layer.system.ndof < FEW
    other, ratio = _other_mesh(layer, 1 / RATIO if finer else RATIO, FEW_CHANGES if few else 1)
    return other, ratio, [layer.resized(RATIO ** (-FEW_CHANGES // 2))] if few else []


def _other_mesh(layer: SceneLayer, factor: float, changes: int) -> tuple[SceneLayer, float]:
    """A layer on elements of factor^changes times the size, or more, and the ratio of the edges of both, above 1.

    Small discs have the same rings of triangles for many sizes: sizes go on until the meshes differ. Raises SceneError
    as SceneLayer.
    """
    own, change = len(layer.system.mesh.surface_triangles6), factor**changes
    for _ in range(MOST_CHANGES):
        other = layer.resized(change)
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
    moved: dict[Response, Float],
    ratio: float,
    *,
    of_coarse: bool,
) -> float:
    """Return the relative error of one of two meshes, at rest, at the main frequency and over time, the largest.

    between: responses of meshes between the two. moved: the motion of each over time. ratio: of edges, above 1.
    of_coarse: whether to return the error of the coarser mesh or of the finer one.
    """
    mesh, ringing = changes(coarse, fine, moved)
    order = FEW_ORDER if between else ORDER
    course_order = min(order, COURSE_ORDER)
    of_one = error_of_coarser if of_coarse else error_of_finer
    error = max(of_one(mesh, ratio, order), of_one(ringing, ratio, course_order))
    # Where distant sound is too rough for a small model, the stated error is at least that of the model
    error = max(error, *(each.small.error for each in (coarse, fine) if each.small.error > TOLERANCE), 0.0)
    for response in between:
        more = len(fine.layer.system.mesh.surface_triangles6) / len(response.layer.system.mesh.surface_triangles6)
        left = error_of_finer(max(changes(response, fine, moved)), max(math.sqrt(more), LEAST_RATIO), order)
        error = max(error, max(mesh, ringing) + left)
    return error
