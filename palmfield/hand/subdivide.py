"""Halve long edges of a mesh for samples of the sound, from the cache."""

import numpy as np

from palmfield import cache
from palmfield.types import Float, Int

CUT = ("vertices", "faces", "parents")
"""Names of the arrays of `sampling_surface` in the cache."""
EDGE_m = 4.3e-3
"""Longest edge for one sound sample per face: half the wavelength of 40 kHz in air at 20 C. The ARP is quadratic in the
pressure; on longer edges its phase changes by more than pi."""


def with_short_edges(vertices: Float, faces: Int, longest_m: float) -> tuple[Float, Int, Int]:
    """Halve edges longer than longest_m; return vertices [m], faces, and the original face of each, shape (m,)."""
    from trimesh.remesh import subdivide_to_size

    points, corners, parents = subdivide_to_size(vertices, faces, longest_m, max_iter=20, return_index=True)
    return points, corners, np.asarray(parents, np.int32)


def sampling_surface(vertices: Float, faces: Int) -> tuple[Float, Int, Int]:
    """Return `with_short_edges` for one sound sample per face, from the cache."""

    def cut() -> cache.Arrays:
        return dict(zip(CUT, with_short_edges(vertices, faces, EDGE_m), strict=True))

    made = cache.kept("short-edges", (vertices, faces, EDGE_m), cut)
    return made["vertices"], made["faces"], made["parents"]
