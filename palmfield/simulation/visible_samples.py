"""Force samples of a body that the arrays can see. The others lie behind the body and receive no sound.

Omitting these saves time and changes nothing: the ARP kernels return 0 there (`warp_kernels.pressure.from_front`).
"""

import numpy as np
from numpy.typing import NDArray

from palmfield.acoustics.phased_array import PhasedArray
from palmfield.simulation.posed_scene import PosedSurface
from palmfield.types import Float, Int

PADDED_TO = 128
"""The number of points is padded to a multiple of this, so that a few buffer sizes are enough for all poses."""


VisibleSamples = tuple[Float, Float, Float, Int]
"""Points [m] and outward normals, array frame, shapes (n, 3), areas [m2], shape (n,), 0 for padding points, and the
numbers of these samples among all samples of the body, shape (n,)."""


def visible(points: Float, normals: Float, arrays: PhasedArray) -> NDArray[np.bool_]:
    """Return whether any transducer may be in front of points [m] with outward normals, shapes (n, 3) to (n,).

    The test uses the corners of a box that contains the transducers of each array.
    """
    nearest: Float = np.maximum.reduce(arrays.corners @ normals.T, axis=0)
    return np.asarray(nearest > np.add.reduce(points * normals, axis=1))


def visible_samples(body: PosedSurface, arrays: PhasedArray) -> VisibleSamples:
    """Return the samples of a body that the arrays can see."""
    points, normals, areas = body.samples
    front = visible(points, normals, arrays).nonzero()[0]
    count = len(front)
    numbers = np.empty(min(-(-count // PADDED_TO) * PADDED_TO, len(areas)), np.int32)
    numbers[:count], numbers[count:] = front, front[-1:]
    visible_areas = areas[numbers]
    visible_areas[count:] = 0.0
    return points[numbers], normals[numbers], visible_areas, numbers
