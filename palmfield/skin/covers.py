"""Layers that cover a hand: their extent and number of triangles, by key `cover` of a skin."""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from palmfield.config.skin import OF_SHAPES, SkinConfig
from palmfield.errors import SceneError
from palmfield.hand.cover import Cover, covered_patch
from palmfield.hand.joint_tree import named_side
from palmfield.hand.palmar import labelled_cover, shaped_cover
from palmfield.hand.preset import load_preset
from palmfield.hand.skinning import rigged_file
from palmfield.hand.split_edges import split_long_edges
from palmfield.hand.surface import hand_surface
from palmfield.hand.triangles import face_normals
from palmfield.hand.wholelayer import whole_layer
from palmfield.types import Float, Patch, Surface

LONGER = 1.4
"""Longest edge of the triangles below a whole hand, over the edge that its sizes ask for: longer ones are halved."""
MOST_COUNTED = 1e5
"""Expected number of triangles below a whole hand from which on they are not counted."""


MOST_OF_WHOLE, MOST_OF_PALMAR = 100_000, 300_000
"""Largest number of unknowns of a layer that covers a hand."""
COARSEST_SURFACE_m = 4e-3
"""Edges of the surface of a preset whose whole skin has a layer: the longest that `hand_surface` makes."""
COARSEST_m = 8e-3
"""Longest edge of elements on a palmar side: half of the breadth of a finger [m]."""


class Sizes(Protocol):
    """Sizes of elements that a cover needs; see `palmfield.skin.scene_layer.LayerSizes`."""

    @property
    def edge_fine_m(self) -> float: ...
    @property
    def edge_coarse_m(self) -> float: ...
    @property
    def fine_radius_m(self) -> float: ...
    @property
    def depth_fractions(self) -> Float: ...


@dataclass(frozen=True, eq=False)
class Covering:
    """Extent of a layer that covers a hand.

    surface: closed mesh of the whole hand [m]; depth_m: depth at its vertices [m], shape (n,), or one number
    reach_m: largest distance from the centre of the layer [m]; palmar: palmar side, or None for all skin
    """

    surface: Surface
    depth_m: Float | float
    reach_m: float
    palmar: Cover | None

    def sizes(self, sizes: Sizes, resizing: float) -> dict[str, Any]:
        """Return sizes of a patch that change for this extent. Raises SceneError if they give too many unknowns.

        resizing: factor of all element sizes, see `palmfield.skin.scene_layer.SceneLayer`
        """
        coarse = min(sizes.edge_coarse_m, COARSEST_m * max(resizing, 1.0))
        fine = min(sizes.edge_fine_m, coarse)
        value, most, mend = "palmar", MOST_OF_PALMAR, "set accuracy or element_m larger, or cover to patch"
        if self.palmar is None:
            value, most, mend = "whole", MOST_OF_WHOLE, "set cover to palmar, or use a mesh with fewer faces"
        unknowns = 12.0 * self._triangles(fine, coarse, sizes.fine_radius_m) * (len(sizes.depth_fractions) - 1)
        if unknowns > most and resizing >= 1.0:
            raise SceneError(
                f"a layer of the {value} skin has about {unknowns:.2g} unknowns; allowed: at most {most:.2g}, because "
                f"a step would take a second or more; {mend}"
            )
        return {"edge_fine_m": fine, "edge_coarse_m": coarse, "radius_m": self.reach_m}

    def triangles(self, sizes: Sizes) -> float:
        """Return the expected number of triangles."""
        return self._triangles(sizes.edge_fine_m, sizes.edge_coarse_m, sizes.fine_radius_m)

    def _triangles(self, edge_m: float, coarse_m: float, fine_radius_m: float) -> float:
        vertices, faces = self.surface.vertices, self.surface.faces
        if self.palmar is not None:
            inside, middle_m = np.pi * fine_radius_m**2, 0.5 * (edge_m + coarse_m)
            return float(inside / edge_m**2 + max(self.palmar.area_m2 - inside, 0.0) / middle_m**2) / 0.43
        expected = float(face_normals(vertices, faces)[1].sum()) / 0.43 / edge_m**2
        return expected if expected > MOST_COUNTED else len(split_long_edges(vertices, faces, LONGER * edge_m)[1])

    def patch(
        self, config: SkinConfig, sizes: Sizes, fraction: float, centre_m: Float, fine_m: Float, resizing: float
    ) -> Patch:
        """Return the layer about a centre, with fine elements about `fine_m` [m], if it is graded.

        fraction: largest depth as a share of the distance through the body
        Raises SceneError if it folds, and for all skin with elements larger than the chosen ones.
        """
        if self.palmar is None:
            if resizing > 1.0:
                raise SceneError("a layer below a whole hand has its triangles, which cannot be coarser")
            return whole_layer(self.surface, self.depth_m, config.depth_m, LONGER * sizes.edge_fine_m)
        edges = sizes.edge_fine_m, sizes.edge_coarse_m, sizes.fine_radius_m
        lengths = (self.reach_m, *edges, config.depth_m, fraction)
        return covered_patch(self.surface, self.depth_m, centre_m, self.palmar, lengths, fine_m)


def covering(config: SkinConfig, surface: Surface | None, depth_m: Float | float, centre_m: Float) -> Covering:
    """Return the extent of a layer whose key `cover` is palmar or whole. Raises SceneError if that is impossible.

    surface, depth_m, centre_m: see `palmfield.skin.scene_layer.SceneLayer`
    """
    assert surface is not None
    if config.patch_radius_m is not None:
        raise SceneError(
            f"patch_radius_m {config.patch_radius_m:g} is the radius of a patch, but cover is '{config.cover}': remove "
            "patch_radius_m, or set cover to patch"
        )
    preset, palmar = config.shape in OF_SHAPES["hand"], None
    if config.cover == "palmar":
        if preset:
            palmar = labelled_cover(surface, config.hand, centre_m)
        else:
            joints = rigged_file(str(config.mesh), config.unit).joints.names if config.shape == "rigged" else ()
            palmar = shaped_cover(surface, centre_m, named_side(joints) if joints else "unknown")
    elif preset:
        hand = hand_surface(load_preset(config.hand), COARSEST_SURFACE_m)
        surface, depth_m = hand.surface, hand.depth_to_bone
    reach = float(np.linalg.norm(surface.vertices - centre_m, axis=1).max()) if palmar is None else palmar.reach_m
    return Covering(surface, depth_m, reach, palmar)
