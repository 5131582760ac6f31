"""Points of a skin or its body in a pose, those that the arrays can see, and the free field there.

Omitting these saves time and changes nothing: the ARP kernels return 0 there (`warp_kernels.pressure.from_front`).
"""

from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from palmfield.acoustics.arp import SurfaceSound
from palmfield.acoustics.phased_array import PhasedArray
from palmfield.acoustics.surface_arp import Shades, SurfaceArp
from palmfield.locked import next_serial
from palmfield.simulation.model import SkinModel
from palmfield.simulation.posed_scene import PosedScene, PosedSurface
from palmfield.types import Complex, Float, Int

PADDED_TO = 128
"""The number of points is padded to a multiple of this number, so that a few buffer sizes suffice for all poses."""
VisibleSamples = tuple[Float, Float, Float, Int]
"""Samples of a body that the arrays can see.

Points [m] and outward normals, array frame, (n, 3); areas [m2], (n,), 0 for padding; numbers among all samples, (n,).
"""
Role = Literal["quadrature", "load", "samples", "nodes", "vertices", "probe"]
"""Roles of points. Each role of a skin has its own buffers."""
Key = tuple[int | bytes, ...]
"""Key of the inputs of a result; usually serial numbers."""
SkinPoints = tuple[PosedScene, int, Role, Float, Float, Int | None, SurfaceArp]
"""Points at which the sound is computed.

Pose; number of the skin (for body points, of a skin on it); role; points [m] and outward normals, array frame, (n, 3);
their numbers if they are only some points of the role, (n,), else None; evaluator of the free field.
"""


def visible(points: Float, normals: Float, arrays: PhasedArray) -> NDArray[np.bool_]:
    """Return whether any transducer may be in front of each point. points [m], normals: (n, 3); result: (n,)

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


class FreeSound:
    """Free-field sound on a skin. Subclasses add shadows and scattering by bodies.

    bends: whether some sound passes around bodies; one_by_one: whether each drive must be computed separately
    samples: returns the points for the force on a body: those that the arrays can see
    """

    bends = one_by_one = False
    samples = staticmethod(visible_samples)

    def shades(self, at: SkinPoints) -> Shades | None:
        """Return the fraction of each transducer's sound that passes bodies, if `bends`; None without obstacles."""
        return None

    def sound(self, at: SkinPoints, drive: Complex) -> SurfaceSound:
        """Return the sound of a drive, shape (N,)."""
        *_, points, normals, _, field = at
        sound = field.evaluate(points, normals, drive, shades=self.shades(at) if self.bends else None)
        return SurfaceSound(sound.arp.copy(), sound.amplitude.copy())


class Solution(NamedTuple):
    """Sound of a drive, shape (N,), on a rigid body in a pose. at: function of points, body frame [m]"""

    posed: PosedScene
    drive: Complex
    at: Callable[[Float], SurfaceSound]

    @staticmethod
    def key(posed: PosedScene, skin: int, drive: Complex) -> tuple[object, ...]:
        """Return a key that is equal while a solution is valid. 0.0 and -0.0 give the same key."""
        return posed.sound_keys[skin], (drive + 0.0).tobytes()


class ChosenPoints:
    """Some of the quadrature points of a skin. numbers: numbers of the points, shape (p,)

    serial: unique number; rest: the arguments of `PosedSurface.moved`
    """

    def __init__(self, skin: SkinModel, numbers: Int):
        quadrature, self.numbers, self.serial = skin.layer.quadrature, numbers, next_serial()
        points = quadrature.points[numbers]
        self.rest = points, quadrature.normals[numbers], skin.carrier.bind(points)
