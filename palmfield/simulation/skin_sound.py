"""Points of a skin or its body in a pose, and the free field there."""

from collections.abc import Callable
from typing import Literal, NamedTuple

from palmfield.acoustics.arp import SurfaceSound
from palmfield.acoustics.surface_arp import Shades, SurfaceArp
from palmfield.locked import next_serial
from palmfield.simulation.model import SkinModel
from palmfield.simulation.posed_scene import PosedScene
from palmfield.simulation.visible_samples import visible_samples
from palmfield.types import Complex, Float, Int

Role = Literal["quadrature", "load", "samples", "nodes", "vertices", "probe"]
"""Roles of points: each role of a skin has its own buffers."""
Key = tuple[int | bytes, ...]
"""Key of the inputs of a result, usually serial numbers."""


SkinPoints = tuple[PosedScene, int, Role, Float, Float, Int | None, SurfaceArp]
"""Points at which the sound is computed: the pose, the number of the skin (for body points: a skin on the body), the
role, places [m] and outward normals, array frame, shapes (n, 3), their numbers if they are part of the points of the
role, shape (n,), else None, and the free-field evaluator."""


class FreeSound:
    """Free-field sound on a skin. Subclasses add shadows and scattering by bodies.

    bends: whether sound passes bodies partly; one_by_one: whether each drive must be computed separately
    samples: returns the points for the force on a body, those that the arrays can see
    """

    bends = one_by_one = False
    samples = staticmethod(visible_samples)

    def shades(self, at: SkinPoints) -> Shades | None:
        """Return the share of the sound of each transducer that passes bodies; None without obstacles. Only if it
        bends.
        """
        return None

    def sound(self, at: SkinPoints, drive: Complex) -> SurfaceSound:
        """Return the sound of a drive, shape (N,)."""
        *_, points, normals, _, field = at
        sound = field.evaluate(points, normals, drive, shades=self.shades(at) if self.bends else None)
        return SurfaceSound(sound.arp.copy(), sound.amplitude.copy())


class Solution(NamedTuple):
    """Sound of a drive, shape (N,), on a rigid body in a pose. at: returns it at points in the frame of the body [m]"""

    posed: PosedScene
    drive: Complex
    at: Callable[[Float], SurfaceSound]

    @staticmethod
    def key(posed: PosedScene, skin: int, drive: Complex) -> tuple[object, ...]:
        """Return a key that is equal while a solution is valid. 0.0 and -0.0 give the same key."""
        return posed.sound_keys[skin], (drive + 0.0).tobytes()


class ChosenPoints:
    """Some of the quadrature points of a skin.

    numbers: shape (p,); serial: unique number; rest: the arguments of `PosedSurface.moved`
    """

    def __init__(self, skin: SkinModel, numbers: Int):
        quadrature, self.numbers, self.serial = skin.layer.quadrature, numbers, next_serial()
        points = quadrature.points[numbers]
        self.rest = points, quadrature.normals[numbers], skin.carrier.bind(points)
