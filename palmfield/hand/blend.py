"""Linear blending of bones in NumPy, for a few points; `palmfield.hand.skinning` does a whole skin by a kernel."""

import numpy as np

from palmfield.types import Float, Int


def bone_shifts(origins: Float, positions: Float, turns: Float) -> Float:
    """Return the shift of each bone [m], shape (b, 3): x at rest moves to turns @ x + shift.

    origins: of the bones' frames at rest [m], positions: now, shapes (b, 3); turns: rotations, shape (b, 3, 3)
    """
    return np.asarray(positions - np.matmul(turns, origins[:, :, None])[:, :, 0])


def blended(bones: Int, shares: Float, shifts: Float, turns: Float) -> tuple[Float, Float]:
    """Return shift [m], shape (n, 3), and matrix, shape (n, 3, 3), of each point from those of its bones.

    bones: numbers, shape (n, k); shares: of each, shape (n, k); shifts, turns: of all bones, see `bone_shifts`
    """
    return np.einsum("nk,nki->ni", shares, shifts[bones]), np.einsum("nk,nkij->nij", shares, turns[bones])
