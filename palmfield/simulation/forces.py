"""The force of the sound on the bodies that carry skin: last stage of a step, first that MuJoCo asks for."""

import numpy as np

from palmfield.acoustics.arp import SurfaceSound
from palmfield.acoustics.surface_load import Parts, resultants
from palmfield.simulation.emission import Emission
from palmfield.simulation.model import HapticModel
from palmfield.simulation.posed_scene import PosedScene
from palmfield.simulation.radiation import Radiation
from palmfield.types import Complex, Float


class BodyForces:
    """Mean forces on a model's bodies over a MuJoCo step. Belongs to one state, and keeps the last resultants."""

    def __init__(self, model: HapticModel, radiation: Radiation):
        self.radiation = radiation
        self._skins = [model.carried(number)[0] for number in range(len(model.bodies))]
        self._shapes = [(body.parts, 3) for body in model.bodies]
        self._parts: dict[int, Parts] = {}
        self._last: dict[int, tuple[SurfaceSound, tuple[Float, Float]]] = {}

    def over(self, emission: Emission, posed: PosedScene, emitted: Complex, t0: float) -> list[tuple[Float, Float]]:
        """Forces [N] on each body's parts and torques about their origins [N m], array frame, shapes (b, 3).

        The mean over the MuJoCo step that begins at t0 [s], with the focus at its beginning: a modulation faster than
        the step gives the right impulse. emitted: by all transducers at t0, shape (N,)
        """
        parts = []
        for shape in self._shapes:
            parts.append((np.zeros(shape), np.zeros(shape)))
        for drive, weight in emission.mean_drives(posed, emitted, t0):
            for number, (force, torque) in enumerate(parts):
                unit_force, unit_torque = self.under(posed, number, drive)
                force += weight * unit_force
                torque += weight * unit_torque
        return parts

    def under(self, posed: PosedScene, body: int, drive: Complex) -> tuple[Float, Float]:
        """The same for one body under what the transducers emit, shape (N,)."""
        sound = self.radiation.on(posed, self._skins[body], "samples", drive)
        known = self._last.get(body)
        if known is None or known[0] is not sound:
            part = posed.bodies[body]
            points, normals, areas = part.samples
            parts = self._parts.get(body)
            if parts is None:
                parts = self._parts[body] = Parts(part.sample_parts, len(part.origins))
            result = resultants(sound.arp, areas, normals, points, part.origins, parts)
            known = self._last[body] = sound, result
        return known[1]
