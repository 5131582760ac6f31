"""Extent of a skin layer on the palmar side of a hand."""

from dataclasses import dataclass

import numpy as np
import scipy  # which loads its parts when they are used
from numpy.typing import ArrayLike

from palmfield import cache
from palmfield.errors import SceneError
from palmfield.hand.layer import depth_by_vertex
from palmfield.hand.meshquery import over_plane
from palmfield.hand.patch import Lengths, layer_in, nearest_face, patch_of
from palmfield.hand.region import FACING_COSINE, Region, facing_region, trace_shape
from palmfield.hand.triangles import face_normals
from palmfield.types import Float, Patch, Surface

LEAST_NECK_m = 2.5e-3
"""Half of the least width of a finger that a cover reaches; see `palmfield.hand.region.trace_shape`."""
OUTLINE_STEP_m, GAUGE_m = 1e-3, 2e-3
"""Steps of the outline of a cover, and edges on which its depth is fitted."""
ABOVE_m = 2e-3
"""Distance of two parts of the skin above each other, seen along `facing`, from which on a cover folds."""
TIP_REACH_m = 0.015
"""Largest distance from a fingertip to the cover; a finger that ends farther away is bent."""

MEND = (
    ", so the layer would fold; allowed: a hand whose palmar side is visible from one side in its reference pose. "
    "Open the hand, or set cover to patch"
)


@dataclass(frozen=True)
class Cover:
    """Extent of a layer on the palmar side of a hand.

    facing: unit direction out of the palm, shape (3,); inside: positive at vertices of the extent, shape (n,)
    reach_m: largest distance across `facing` from the centre of the layer
    area_m2: area of the projected extent [m2]; tips: fingertips that it must reach [m], shape (k, 3)
    """

    facing: Float
    inside: Float
    reach_m: float
    area_m2: float
    tips: Float


def covered_patch(
    surface: Surface, depth: ArrayLike | float, centre: Float, cover: Cover, sizes: Lengths, fine_at: Float | None
) -> Patch:
    """Return the layer in the extent of a cover.

    surface, depth, centre, fine_at: see `palmfield.hand.patch.surface_patch`
    sizes: radius_m (reach of the cover), fine_m, coarse_m, fine_radius_m, max_depth_m and max_fraction, see there
    Raises SceneError for a centre off the extent, a hand that is not flat, and a layer that folds.
    """
    of = surface, depth_by_vertex(depth, len(surface.vertices)), centre, cover, sizes, fine_at
    return patch_of(cache.kept("cover", of, lambda: _made(*of)))


def _made(
    surface: Surface, depth: Float, centre: Float, cover: Cover, sizes: Lengths, fine_at: Float | None
) -> cache.Arrays:
    origin, seed = nearest_face(surface, centre)
    # Region uses only the cosines of the normals to `facing`: it ends where they reach its limit, or `inside` reaches 0
    cosine = np.minimum(surface.normals @ cover.facing, cover.inside + FACING_COSINE)
    ended = Surface(surface.vertices, surface.faces, cosine[:, None] * cover.facing)
    region = facing_region(ended, origin, seed, cover.facing, sizes[0])
    check_flat(cover, region)
    shape = trace_shape(region, OUTLINE_STEP_m, LEAST_NECK_m, LEAST_NECK_m)
    return layer_in(surface, depth, region, shape, GAUGE_m, sizes, fine_at)


def check_flat(cover: Cover, region: Region) -> None:
    """Raise SceneError if the hand hides a part of its palmar side, as when its fingers are bent."""
    facing = face_normals(region.vertices, region.faces)[0] @ cover.facing > FACING_COSINE
    facing &= (cover.inside[region.index][region.faces] > 0.0).all(axis=1)
    middles, shadows = (of[region.faces[facing]].mean(axis=1) for of in (region.vertices, region.shadow))
    corners, weights = over_plane(region.shadow, region.faces, shadows)
    apart = np.linalg.norm(np.einsum("ij,ijk->ik", weights, region.vertices[corners]) - middles, axis=1)
    if apart.max() > ABOVE_m:
        raise SceneError(f"the skin at {place(middles[np.argmax(apart)])} lies above other palmar skin{MEND}")
    for tip in cover.tips:
        if scipy.spatial.cKDTree(region.vertices).query(tip)[0] > TIP_REACH_m:
            raise SceneError(f"the finger that ends at {place(tip)} is bent: its palmar side does not face out{MEND}")


def place(point: Float) -> str:
    """Return a point as text [mm]."""
    return "({:.1f}, {:.1f}, {:.1f}) mm".format(*(1e3 * point))
