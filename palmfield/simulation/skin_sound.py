"""Points of a skin or its body in a pose, and the sound there with nothing in its way."""

from collections.abc import Callable
from typing import Literal, NamedTuple

from palmfield.acoustics.arp import SurfaceSound
from palmfield.acoustics.surface_arp import Shades, SurfaceArp
from palmfield.locked import next_serial
from palmfield.simulation.model import SkinModel
from palmfield.simulation.posed_scene import PosedScene
from palmfield.simulation.seen_samples import seen_samples
from palmfield.types import Complex, Float, Int

Role = Literal["quadrature", "load", "samples", "nodes", "vertices", "probe"]
"""Purposes of points: each role of a skin has its own buffers."""
Key = tuple[int | bytes, ...]
"""What something was computed from, by serial numbers as a rule."""


SkinPoints = tuple[PosedScene, int, Role, Float, Float, Int | None, SurfaceArp]
"""Points at which the sound is computed: the pose, the number of the skin to which or to whose body they belong, their
role, places [m] and outward normals, array frame, shapes (n, 3), numbers of some among all that the role may have,
shape (n,), or None, and the field there where nothing is in its way."""


class FreeSound:
    """The sound on a skin as if nothing were in its way. What bodies do to it overrides this.

    bends: whether bodies leave shares of it; one_by_one: whether it must be computed for each drive by itself
    samples: gives the points for the force on a body, those that the arrays can see
    """

    bends = one_by_one = False
    samples = staticmethod(seen_samples)

    def shades(self, at: SkinPoints) -> Shades | None:
        """Shares of the sound of each transducer that pass bodies; None without obstacles. Only where it bends."""
        return None

    def sound(self, at: SkinPoints, drive: Complex) -> SurfaceSound:
        """Sound of a drive, shape (N,)."""
        *_, points, normals, _, field = at
        sound = field.evaluate(points, normals, drive, shades=self.shades(at) if self.bends else None)
        return SurfaceSound(sound.arp.copy(), sound.amplitude.copy())


class Solution(NamedTuple):
    """The sound of a drive, shape (N,), on a rigid body in a pose. at: gives it at points in the body's frame [m]"""

    posed: PosedScene
    drive: Complex
    at: Callable[[Float], SurfaceSound]

    @staticmethod
    def key(posed: PosedScene, skin: int, drive: Complex) -> tuple[object, ...]:
        """Equal while a solution is valid. Zero has one sign."""
        return posed.sound_keys[skin], (drive + 0.0).tobytes()


class ChosenPoints:
    """Some of the quadrature points of a skin.

    numbers: shape (p,); serial: unique number; rest: what `PosedSurface.moved` takes of them
    """

    def __init__(self, skin: SkinModel, numbers: Int):
        quadrature, self.numbers, self.serial = skin.layer.quadrature, numbers, next_serial()
        points = quadrature.points[numbers]
        self.rest = points, quadrature.normals[numbers], skin.carrier.bind(points)
