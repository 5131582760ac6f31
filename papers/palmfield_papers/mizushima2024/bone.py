"""Compute the static displacement of a gel around a bone, relative to the flat layer of the configuration."""

from functools import cache

import numpy as np

from palmfield.skin import Layer, Sheet, Traction
from palmfield.skin.base import BaseKind
from palmfield.skin.fem import face_points
from palmfield.skin.mesh import Sizes, cylinder_patch
from palmfield.skin.solvers.wedges import static_wedges
from palmfield_papers.mizushima2024.gel import THICKNESS_M, Gel, compliance, material_of

BONE_M = 0.005
"""Assumed radius of the bone [m]. In the paper it is similar to that of an index finger."""
LENGTH_M = 0.05
EDGE_M = 1.6e-3, 2.6e-3


@cache
def over_flat(base: BaseKind, refinements: int = 0) -> float:
    """Return the static displacement at the centre of the ellipse, divided by that of the flat layer.

    The gel is C0; the long axis of the ellipse is along the bone. The pressure is proportional to the squared cosine to
    the face, and is 0 on the far side.
    refinements: number of subdivisions of triangles
    """
    gel, face = Gel("C0", base), BONE_M + THICKNESS_M
    patch = cylinder_patch(face, LENGTH_M, THICKNESS_M, EDGE_M)
    points, areas = face_points(patch, 1)
    wide, narrow = gel.half_widths_m
    cosine = np.maximum(points[:, 2], 0.0) / face
    push = cosine**2 * 2.0 ** -((points[:, 0] / wide) ** 2 + (points[:, 1] / narrow) ** 2)
    load = Traction(points, areas, np.zeros(1), push[None], "held")
    row = 0.5 * THICKNESS_M
    sizes = Sizes((0.0, 0.0), face, *EDGE_M, row, row, refinements, LENGTH_M, LENGTH_M, 100.0)
    body = Layer(patch, (Sheet(material_of(gel), 1.0),), base, "fixed")
    motion = static_wedges(body, load, np.array([[0.0, 0.0, face]]), sizes=sizes)
    return float(-motion.displacement_m[0, 0, 2] / compliance(gel, 0.0).real)
