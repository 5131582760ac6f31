"""Represent pistons by points on their faces: Rayleigh's integral, which is valid up to the baffle.

The field of arrays (`palmfield.acoustics.field`) uses the far field of a piston. The sum of many point sources on its
face, in the same baffle, is the exact sound of a rigid piston. Its closed form on the axis is in
`palmfield_papers.piston_axis`.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from palmfield.acoustics import check
from palmfield.acoustics.directivities import form_of
from palmfield.errors import SceneError
from palmfield.types import Array, Complex

RINGS, SPOKES = 4, 12
"""Number of points on a face: rings and points per ring.

The error is 2e-4 on the axis beyond a Rayleigh length, for radii up to 6 mm at 40 kHz.
"""


def as_faces(array: Array, drive: ArrayLike, *, rings: int = RINGS, spokes: int = SPOKES) -> tuple[Array, Complex]:
    """Return an array of rings * spokes point sources for each piston, and their drive, shape (rings * spokes * n,).

    drive: complex amplitudes of the pistons, shape (n,); rings: number of rings, at Gauss-Legendre points of the
        squared radius
    The gain of the array is included in the drive. Raises SceneError for an array without pistons or with a directivity
    table, PalmfieldError for a drive of a wrong shape.
    """
    check.array(array)
    emitted = check.drive(drive, array)
    form = form_of(array)
    if form.name != "piston" or array.piston_radius_m <= 0.0:
        raise SceneError(
            f"array '{array.name}' has no pistons (radius {array.piston_radius_m:g} m, directivity '{form.name}'): "
            "give one with a radius above 0"
        )
    if array.gain is not None:
        emitted = emitted * array.gain
    nodes, weights = np.polynomial.legendre.leggauss(rings)
    radii = array.piston_radius_m * np.sqrt(0.5 * (1.0 + nodes))
    angles = 2.0 * np.pi * np.arange(spokes) / spokes
    aside = np.cross(array.normals, [0.0, 0.0, 1.0])
    # For a piston along z this direction is undefined
    aside[np.linalg.norm(aside, axis=1) < 1e-9] = [1.0, 0.0, 0.0]
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    across = np.cross(array.normals, aside)
    ring = np.cos(angles)[:, None, None] * aside + np.sin(angles)[:, None, None] * across
    places = array.positions + radii[:, None, None, None] * ring
    share = np.repeat(0.5 * weights / spokes, spokes)[:, None] * emitted
    points = replace(
        array,
        positions=places.reshape(-1, 3),
        normals=np.tile(array.normals, (rings * spokes, 1)),
        piston_radius_m=0.0,
        address=None,
        gain=None,
    )
    return points, np.asarray(share.ravel(), dtype=np.complex128)
