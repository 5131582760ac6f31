"""Linear blend skinning in NumPy for a few points; `palmfield.hand.skinning` moves a whole skin by a kernel."""

import numpy as np

from palmfield.types import Float, Int


def bone_shifts(origins: Float, positions: Float, turns: Float) -> Float:
    """Return the shift of each bone [m], shape (b, 3): a point x at rest moves to turns @ x + shift.

    origins, positions: origins of the bones' frames at rest and now [m], shape (b, 3); turns: rotations, (b, 3, 3)
    """
    return np.asarray(positions - np.matmul(turns, origins[:, :, None])[:, :, 0])


def blended(bones: Int, shares: Float, shifts: Float, turns: Float) -> tuple[Float, Float]:
    """Return the blended shift [m], shape (n, 3), and matrix, shape (n, 3, 3), of each point.

    bones, shares: bone numbers and weights, shape (n, k); shifts, turns: shift and rotation of each bone, see
    `bone_shifts`
    """
    return np.einsum("nk,nki->ni", shares, shifts[bones]), np.einsum("nk,nkij->nij", shares, turns[bones])
