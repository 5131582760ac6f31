"""Motion of a skin that the acceleration of its bones causes, during a recorded run."""

import numpy as np

from palmfield.engine.host import World
from palmfield.engine.inertia import bone_accelerations
from palmfield.simulation.model import SkinModel
from palmfield.skin.fem.probe import surface_vectors
from palmfield.skin.fem.solver import static
from palmfield.skin.reduction.inertia import inertial_forces, inertial_model
from palmfield.skin.reduction.reduced import Reduced
from palmfield.types import Float, Float32


class MotionDriven:
    """Compute the part of the motion of a skin that the acceleration of its bones causes, from rest at the first time.

    The layer is linear and its motion acts on no body, so this part is computed without the sound.

    Times are multiples of the MuJoCo step; accelerations are linear within a step. Raises SceneError in the cases of
    `bone_accelerations`.

    model: reduced model for these accelerations; None until a bone accelerates
    hardest: accelerations at the largest displacement so far, in the form of `FrameRates.numbers`, for its bones
    """

    def __init__(self, world: World, number: int) -> None:
        skin: SkinModel = world.scene.model.skins[number]
        self._skin, self._step_s = skin, world.scene.model.spec.timestep_s
        self._accelerations = bone_accelerations(world, number)
        binding, count = skin.nodes_binding, len(skin.nodes[0])
        shares = np.ones((1, count)) if binding is None else binding.weights
        self._bones = np.flatnonzero(shares.any(axis=1))
        self._shares = shares[self._bones]
        self._last: Float | None = None
        self._state: Float = np.zeros(0)
        self.model: Reduced | None = None
        self.hardest, self._most_m = np.zeros(0), 0.0

    def at(self, times: Float) -> Float32:
        """Return the displacement of the surface nodes [m], shape (t, S, 3), at the next times [s], shape (t,)."""
        result = np.zeros((len(times), self._shares.shape[1], 3), np.float32)
        if self._accelerations is None:
            return result
        numbers = np.array([self._accelerations(float(time))[self._bones].ravel() for time in times])
        begun = self._last is not None
        first = np.concatenate([numbers[:1] if self._last is None else self._last[None], numbers[:-1]])
        self._last = numbers[-1]
        if self.model is None and first.any() | numbers.any():
            self.model = inertial_model(self._skin.layer.system, self._shares, self._skin.surface_vectors)
            self._state = self.model.new_state()
        new = slice(0 if begun else 1, None)
        if self.model is not None and len(numbers[new]):
            states = self.model.march(self._state, first[new], numbers[new], self._step_s)
            self._state = states[-1]
            result[new] = (states @ self.model.displaces.T).reshape(len(states), -1, 3)
            sizes = np.abs(result).max(axis=(1, 2))
            if sizes.max() > self._most_m:
                self.hardest, self._most_m = numbers[sizes.argmax()], float(sizes.max())
        return result

    def edge_error(self) -> float:
        """Return the error due to the cut sides: half of the change when fixed sides become free, or the reverse.

        It is the relative change of the static displacement under `hardest`, in the L2 norm over the nodes within half
        of the radius.
        """
        if self.model is None:
            return 0.0
        layer, (points, _) = self._skin.layer, self._skin.nodes
        near = np.linalg.norm(points - layer.centre_m, axis=1) < 0.5 * layer.sizes.radius_m
        other = layer.altered(side="fixed" if layer.config.side == "free" else "free").system
        moved = []
        for system in (layer.system, other):
            force = inertial_forces(system, self._shares) @ self.hardest
            whole = surface_vectors(system.mesh, system) @ static(system, force)
            moved.append(whole.reshape(-1, 3)[near])
        return float(0.5 * np.linalg.norm(moved[1] - moved[0]) / np.linalg.norm(moved[0]))
