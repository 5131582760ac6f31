"""The force of the sound on the bodies that carry skin: last stage of a step, first that MuJoCo asks for."""

import numpy as np

from palmfield.acoustics.arp import SurfaceSound
from palmfield.acoustics.surface_load import Parts, pushes, resultants
from palmfield.simulation.emission import Emission
from palmfield.simulation.model import HapticModel
from palmfield.simulation.path_sound import PathSound
from palmfield.simulation.posed_scene import PosedScene
from palmfield.simulation.radiation import Radiation
from palmfield.simulation.seen_samples import SeenSamples
from palmfield.types import Complex, Float, Float32, Int


class BodyForces:
    """Mean forces on a model's bodies over a MuJoCo step. Belongs to one state, and keeps the last resultants."""

    def __init__(self, model: HapticModel, radiation: Radiation, path_sound: PathSound | None = None):
        """path_sound: gives what lies on a path that is known ahead"""
        self.radiation = radiation
        self._path_sound = path_sound if path_sound is not None and path_sound.serves else None
        self._skins = [model.carried(number)[0] for number in range(len(model.bodies))]
        self._shapes = [(body.parts, 3) for body in model.bodies]
        self._owners: dict[int, Int] = {}
        self._pushes: dict[int, tuple[SeenSamples, Float, Parts]] = {}
        self._last: dict[int, tuple[SurfaceSound, tuple[Float, Float], SeenSamples]] = {}
        self._pressed: dict[int, tuple[SeenSamples, Float | Float32, float]] = {}

    def over(self, emission: Emission, posed: PosedScene, emitted: Complex, t0: float) -> list[tuple[Float, Float]]:
        """Forces [N] on each body's parts and torques about their origins [N m], array frame, shapes (b, 3).

        The mean over the MuJoCo step that begins at t0 [s]: a modulation faster than the step gives the right impulse.
        emitted: by all transducers at t0, shape (N,)
        """
        mean = emission.mean_drives(posed, emitted, t0)
        forces = []
        for body, shape in enumerate(self._shapes):
            self._pressed.pop(body, None)
            if len(mean.weights) == 0:
                forces.append((np.zeros(shape), np.zeros(shape)))
                continue
            skin, arp = self._skins[body], None
            if self._path_sound is not None:
                arp = self._path_sound.arp(posed, skin, "samples", mean.levels @ mean.units)
            if arp is None and len(mean.weights) > 1:
                arp = self.radiation.sums(posed, skin, mean.units, mean.levels, "samples")
            if arp is None:
                weight = float(mean.weights[0])
                force, torque = self.under(posed, body, mean.units[0])
                sound, _, samples = self._last[body]
                self._pressed[body] = samples, sound.arp, weight
                forces.append((weight * force, weight * torque))
                continue
            pressed = mean.weights @ arp
            forces.append(self._resultants(posed, body, pressed))
            self._pressed[body] = self._pushes[body][0], pressed, 1.0
        return forces

    def pressed(self, body: int) -> tuple[SeenSamples, Float] | None:
        """The mean ARP [Pa] at a body's samples in the step that `over` was asked for last; None where nothing sounded.

        Shape (n,), of the samples that are returned with it.
        """
        known = self._pressed.get(body)
        return None if known is None else (known[0], known[2] * known[1].astype(np.float64))

    def under(self, posed: PosedScene, body: int, drive: Complex) -> tuple[Float, Float]:
        """The same for one body under what the transducers emit, shape (N,)."""
        sound = self.radiation.on(posed, self._skins[body], "samples", drive)
        known = self._last.get(body)
        if known is None or known[0] is not sound:
            made = self._resultants(posed, body, sound.arp)
            known = self._last[body] = sound, made, self._pushes[body][0]
        return known[1]

    def _resultants(self, posed: PosedScene, body: int, arp: Float | Float32) -> tuple[Float, Float]:
        samples, origins = self.radiation.samples(posed, self._skins[body]), posed.bodies[body].origins
        known = self._pushes.get(body)
        if known is None or known[0] is not samples:
            points, normals, areas, numbers = samples
            owners = self._owners.get(body)
            if owners is None:
                owners = self._owners[body] = posed.bodies[body].sample_parts
            parts = Parts(owners[numbers], len(origins))
            known = self._pushes[body] = samples, pushes(areas, normals, points), parts
        return resultants(arp, known[1], origins, known[2])
