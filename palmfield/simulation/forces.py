"""The force of the sound on the bodies that carry skin."""

import numpy as np

from palmfield.acoustics.surface_load import Parts, pushes, resultants
from palmfield.simulation.model import HapticModel
from palmfield.simulation.posed_scene import PosedScene
from palmfield.simulation.radiation import Radiation
from palmfield.simulation.skin_sound import Key
from palmfield.types import Complex, Float, Float32, Int


class BodyForces:
    """Compute forces [N] on body parts and torques about their origins [N m], array frame, shape (2, b, 3).

    An object belongs to one state, and stores the effect of a unit pressure in the last pose.
    """

    def __init__(self, model: HapticModel, radiation: Radiation):
        self.radiation = radiation
        self.skins = [model.carried(number)[0] for number in range(len(model.bodies))]
        self._owners: dict[int, Int] = {}
        self._pushes: dict[int, tuple[Key, Float, Parts]] = {}

    def under(self, posed: PosedScene, body: int, drive: Complex, serial: int = 0) -> Float:
        """Return the force on one body for an emission of the transducers, shape (N,); serial: as in `Radiation.on`."""
        return self.pressed(posed, body, self.radiation.on(posed, self.skins[body], "samples", drive, serial).arp)

    def pressed(self, posed: PosedScene, body: int, arp: Float | Float32) -> Float:
        """Return the force on one body for a pressure at its samples [Pa], shape (n,)."""
        origins, key = posed.bodies[body].origins, (posed.arrays.serial, posed.bodies[body].serial)
        known = self._pushes.get(body)
        if known is None or known[0] != key:
            points, normals, areas, numbers = self.radiation.samples(posed, self.skins[body])
            owners = self._owners.get(body)
            if owners is None:
                owners = self._owners[body] = posed.bodies[body].sample_parts
            parts = Parts(owners[numbers], len(origins))
            known = self._pushes[body] = key, pushes(areas, normals, points), parts
        return np.array(resultants(arp, known[1], origins, known[2]))
