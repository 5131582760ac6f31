"""The force of the sound on the bodies that carry skin: last stage of a step, first that MuJoCo asks for."""

import numpy as np

from palmfield.acoustics.surface_load import resultants
from palmfield.simulation.emission import Emission
from palmfield.simulation.model import HapticModel
from palmfield.simulation.posed_scene import PosedScene
from palmfield.simulation.radiation import Radiation, SurfaceSound
from palmfield.types import Complex, Float


class BodyForces:
    """Mean forces on a model's bodies over a MuJoCo step. Belongs to one state, and keeps the last resultants."""

    def __init__(self, model: HapticModel, radiation: Radiation):
        self.model, self.radiation = model, radiation
        self._last: dict[int, tuple[SurfaceSound, tuple[Float, Float]]] = {}

    def over(self, emission: Emission, posed: PosedScene, emitted: Complex, t0: float) -> list[tuple[Float, Float]]:
        """Forces [N] on each body's parts and torques about their origins [N m], array frame, shapes (b, 3).

        The mean over the MuJoCo step that begins at t0 [s], with the focus at its beginning: a modulation faster than
        the step gives the right impulse. emitted: by all transducers at t0, shape (N,)
        """
        parts = [(np.zeros((body.parts, 3)), np.zeros((body.parts, 3))) for body in self.model.bodies]
        for drive, weight in emission.mean_drives(posed, emitted, t0):
            for number, (force, torque) in enumerate(parts):
                unit_force, unit_torque = self.under(posed, number, drive)
                force += weight * unit_force
                torque += weight * unit_torque
        return parts

    def under(self, posed: PosedScene, body: int, drive: Complex) -> tuple[Float, Float]:
        """The same for one body under what the transducers emit, shape (N,)."""
        sound = self.radiation.on(posed, self.model.carried(body)[0], "samples", drive)
        known = self._last.get(body)
        if known is None or known[0] is not sound:
            part = posed.bodies[body]
            points, normals, areas = part.samples
            result = resultants(sound.arp, areas, normals, points, part.origins, part.sample_parts)
            known = self._last[body] = sound, result
        return known[1]
