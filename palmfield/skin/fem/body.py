"""The mesh and the matrices of a slab or layer, for a given element size."""

import numpy as np

from palmfield.hand.remesh import remeshed
from palmfield.skin.fem.absorbing import match_speed, sponge
from palmfield.skin.fem.assembly import SkinSystem, assemble
from palmfield.skin.mesh.body_mesh import Sizes, graded_fractions, quartered, slab_patch
from palmfield.skin.mesh.wedges import element_rows, extrude
from palmfield.skin.problem import Body, Layer


def build(body: Body, sizes: Sizes) -> SkinSystem:
    """Return mesh and matrices. Raises SceneError if this is impossible, for example for an inverted element."""
    side = body.side or "absorbing"
    if isinstance(body, Layer):
        patch = body.patch
        if sizes.remesh:
            centre = np.asarray(sizes.centre_m, dtype=np.float64)
            patch = remeshed(patch, centre, sizes.fine_m, sizes.coarse_m, sizes.fine_radius_m)
        for _ in range(sizes.refinements):
            patch = quartered(patch)
        depth = float(np.median(patch.depth))
        in_ring = None
    else:
        patch, in_ring = slab_patch(body, sizes)
        depth = body.thickness_m
    fractions, materials = element_rows(body.sheets, graded_fractions(depth, sizes.row_m, sizes.deepest_row_m))
    mesh = extrude(patch, fractions)
    damping = None
    if side == "absorbing" and in_ring is not None:
        damping = sponge(mesh, in_ring, sizes.ring_m, match_speed(materials[0], sizes.match_Hz))
    return assemble(mesh, materials, base=body.base, side=side, absorbing_Hz=sizes.match_Hz, sponge_1_s=damping)
