"""Read one skin of a simulation."""

from collections.abc import Sequence

import numpy as np

from palmfield.drive.transducer_response import present_drive
from palmfield.engine.scene_runtime import SceneRuntime
from palmfield.errors import SceneError
from palmfield.simulation.model import SkinModel
from palmfield.simulation.state import at_rest, stepper_of
from palmfield.skin.stepper import Reader
from palmfield.types import Float, Float32, Int


class Skin:
    """One skin of a simulation at the present time. Each array is computed on access."""

    def __init__(self, runtime: SceneRuntime, number: int):
        self._runtime, self._number = runtime, number
        self._readers: dict[str, Reader] = {}

    @property
    def _part(self) -> SkinModel:
        return self._runtime.model.skins[self._number]

    @property
    def name(self) -> str:
        """Name of the plugin instance."""
        return self._part.spec.name

    @property
    def solver(self) -> str:
        """Solver that the skin uses or will use: a value of key `solver` other than "auto"."""
        if at_rest(self._runtime.state, self._number):
            return self._part.choice.name
        return stepper_of(self._runtime.model, self._runtime.state, self._number)[0].name

    @property
    def rest_position(self) -> Float:
        """Surface nodes at rest, body frame [m], shape (S, 3)."""
        return self._part.nodes[0]

    @property
    def rest_normal(self) -> Float:
        """Unit outward normals of the surface nodes at rest, shape (S, 3)."""
        return self._part.nodes[1]

    @property
    def faces(self) -> Int:
        """Triangles over the surface nodes, shape (f, 3)."""
        return self._part.faces

    @property
    def position(self) -> Float:
        """Positions of the surface nodes, moved with body and bones, world [m], shape (S, 3).

        The displacement of the skin is not included.
        """
        posed = self._runtime.posed
        return posed.array_frame.points(posed.skins[self._number].nodes[0])

    def _motion(self) -> Float:
        if at_rest(self._runtime.state, self._number):
            return np.zeros((2, len(self.rest_position), 3))
        stepper, numbers = stepper_of(self._runtime.model, self._runtime.state, self._number)
        if stepper.name not in self._readers:
            self._readers[stepper.name] = stepper.reader(self._part.surface_vectors)
        motion: Float = stepper.read(numbers, self._readers[stepper.name])[0]
        return motion.reshape(2, -1, 3)

    @property
    def displacement(self) -> Float:
        """Displacement of the surface nodes, in the axes of the resting body [m], shape (S, 3)."""
        return self._motion()[0]

    @property
    def velocity(self) -> Float:
        """Velocity of the surface nodes, in the axes of the resting body [m/s], shape (S, 3)."""
        return self._motion()[1]

    @property
    def normal_displacement(self) -> Float:
        """Displacement along the outward normal [m], shape (S,); negative into the skin."""
        return np.einsum("si,si->s", self.displacement, self.rest_normal)

    @property
    def arp(self) -> Float32:
        """Acoustic radiation pressure at the surface nodes [Pa], positive inwards, shape (S,)."""
        posed, course = self._runtime.now()
        drive, factor = present_drive(course)
        if drive is None:
            return np.zeros(len(self.rest_position), np.float32)
        sound = self._runtime.work.radiation.on(posed, self._number, "nodes", drive, course.serial)
        return np.float32(factor) * sound.arp


def chosen_name(names: Sequence[str], name: str | None) -> str:
    """Return the name of a skin. Without `name`, return that of the only skin.

    Raises SceneError for an unknown name.
    """
    if name is None and len(names) == 1:
        return names[0]
    if name is None or name not in names:
        raise SceneError(f"the scene has no skin '{name}'; it has: {', '.join(names)}")
    return name
