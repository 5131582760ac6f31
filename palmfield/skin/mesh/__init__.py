"""Quadratic wedges below a surface, the rows and patches that they are made from, and an order to eliminate them in."""

from typing import TYPE_CHECKING

from palmfield.lazy_names import lazy_names

if TYPE_CHECKING:
    from palmfield.skin.mesh.body_mesh import Sizes, box_patch, graded_fractions, quartered
    from palmfield.skin.mesh.cylinder import cylinder_patch, cylinder_surface
    from palmfield.skin.mesh.disc import disc_patch
    from palmfield.skin.mesh.ordering import dissection_order
    from palmfield.skin.mesh.rows import element_rows
    from palmfield.skin.mesh.wedges import WedgeMesh, closed_boundary, extrude, output_triangles

_WHERE = {
    **dict.fromkeys(("Sizes", "box_patch", "graded_fractions", "quartered"), "body_mesh"),
    **dict.fromkeys(("cylinder_patch", "cylinder_surface"), "cylinder"),
    "disc_patch": "disc",
    "dissection_order": "ordering",
    "element_rows": "rows",
    **dict.fromkeys(("WedgeMesh", "closed_boundary", "extrude", "output_triangles"), "wedges"),
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
    "element_rows",
    "extrude",
    "graded_fractions",
    "output_triangles",
    "quartered",
]
__getattr__, __dir__ = lazy_names(__name__, _WHERE)
