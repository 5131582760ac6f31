"""Quadratic wedges below a surface, the rows and patches that they are made from, and an order to eliminate them in."""

from typing import TYPE_CHECKING

from palmfield.lazy_names import lazy_names

if TYPE_CHECKING:
    from palmfield.skin.mesh.body_mesh import Sizes, box_patch, graded_fractions, quartered
    from palmfield.skin.mesh.cylinder import cylinder_patch, cylinder_surface
    from palmfield.skin.mesh.disc import disc_patch
    from palmfield.skin.mesh.ordering import dissection_order
    from palmfield.skin.mesh.rows import rows_of
    from palmfield.skin.mesh.surface import closed_boundary, output_triangles
    from palmfield.skin.mesh.wedges import WedgeMesh, extrude

_WHERE = {
    **dict.fromkeys(("Sizes", "box_patch", "graded_fractions", "quartered"), "body_mesh"),
    **dict.fromkeys(("cylinder_patch", "cylinder_surface"), "cylinder"),
    "disc_patch": "disc",
    "dissection_order": "ordering",
    "rows_of": "rows",
    **dict.fromkeys(("closed_boundary", "output_triangles"), "surface"),
    **dict.fromkeys(("WedgeMesh", "extrude"), "wedges"),
}
__all__ = [
    "Sizes",
    "WedgeMesh",
    "box_patch",
    "closed_boundary",
    "cylinder_patch",
    "cylinder_surface",
    "disc_patch",
    "dissection_order",
    "extrude",
    "graded_fractions",
    "output_triangles",
    "quartered",
    "rows_of",
]
__getattr__, __dir__ = lazy_names(__name__, _WHERE)
