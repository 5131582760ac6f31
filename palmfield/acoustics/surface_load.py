"""Forces and torques of the sound on a surface."""

import numpy as np
from numpy.typing import NDArray

from palmfield.types import Float, Float32, Int

CLEARANCE_M = 2e-3
"""Smallest allowed distance of a body from the board of an array [m]."""


class Parts:
    """Parts of a body, for sums over the faces of each part in a fixed order.

    owners: part of each face, shape (n,). count: number of parts.
    starts: first face of each run, shape (k,). rows: target of the six sums of each run, by part, shape (6 k,).
    """

    def __init__(self, owners: Int, count: int):
        self.count = count
        # Consecutive faces mostly belong to one part, so runs of faces are summed first, and then the runs
        changes: NDArray[np.bool_] = np.empty(len(owners), np.bool_)
        changes[:1] = True
        np.not_equal(owners[1:], owners[:-1], out=changes[1:])
        self.starts = changes.nonzero()[0]
        # One list for the six rows of a force and a torque
        self.rows = (owners[self.starts].astype(np.intp) + count * np.arange(6)[:, None]).ravel()


def pushes(areas: Float, normals: Float, points: Float) -> Float:
    """Return force [m2] and moment about the origin [m3] of a unit pressure on each face, as six rows, shape (6, n).

    areas: [m2], shape (n,); normals: unit, outward; points: centres of the faces [m]; both (n, 3) in one frame
    """
    rows = np.empty((6, len(areas)))
    force, moment = rows[:3], rows[3:]
    np.multiply(normals.T, -areas, out=force)
    x, y, z = np.array(points.T, order="C", dtype=np.float64)
    np.subtract(y * force[2], z * force[1], out=moment[0])
    np.subtract(z * force[0], x * force[2], out=moment[1])
    np.subtract(x * force[1], y * force[0], out=moment[2])
    return rows


def resultants(arp: Float | Float32, of_unit: Float, origins: Float, parts: Parts) -> tuple[Float, Float]:
    """Return forces [N] on the parts of a body and torques about their origins [N m], shapes (b, 3).

    arp: ARP on the faces [Pa], positive inwards, shape (n,); of_unit: as returned by `pushes`, shape (6, n).
    origins: origins of the parts [m], in the frame of the faces, shape (b, 3)
    Faces are summed in a fixed order, so that equal input gives equal bits.
    """
    if len(arp) == 0:
        return np.zeros((parts.count, 3)), np.zeros((parts.count, 3))
    runs = np.add.reduceat(of_unit * arp, parts.starts, axis=1)
    sums: Float = np.bincount(parts.rows, runs.ravel(), 6 * parts.count).astype(np.float64, copy=False)
    sums = sums.reshape(6, parts.count).T
    forces, torques = np.ascontiguousarray(sums[:, :3]), sums[:, 3:]
    fx, fy, fz = forces.T
    ox, oy, oz = origins.T
    turned = np.array([oy * fz - oz * fy, oz * fx - ox * fz, ox * fy - oy * fx]).T
    return forces, np.subtract(torques, turned, order="C")
