"""Poses of several worlds, read from their mjData together."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from palmfield.engine.many_data import Field, ManyData
from palmfield.engine.scene_runtime import SceneRuntime
from palmfield.errors import naming_world
from palmfield.simulation.posed_scene import PosedScene, settled_worlds
from palmfield.types import Float


class WorldPoses:
    """Reads the poses of some worlds, and stores the last poses.

    In most steps the bodies move so little from the reference pose that reduced models stay valid. This is checked for
    all worlds together. Only worlds with larger movements are checked one by one.

    positions, matrices: arrays in which the runtimes store the world frames, shapes (worlds, m, 3), (worlds, m, 9)
    """

    def __init__(self, runtimes: Sequence[SceneRuntime], positions: Float, matrices: Float):
        self.runtimes, self._positions, self._matrices = runtimes, positions, matrices
        first = runtimes[0]
        self._model, self._layout = first.model, first.layout
        fields: dict[str, tuple[Field, Field]] = {"body": ("xpos", "xmat"), "site": ("site_xpos", "site_xmat")}
        self._fields: list[tuple[Field, list[int], Float]] = []
        for kind, chosen, rows in first.frames_read:
            for field, result in zip(fields[kind], (positions, matrices), strict=True):
                own = result[:, rows]
                width = own.shape[2]
                offsets = (width * chosen[:, None] + np.arange(width)).ravel().tolist()
                flat = np.lib.stride_tricks.as_strided(own, (len(own), len(offsets)), (own.strides[0], own.strides[2]))
                self._fields.append((field, offsets, flat))
        # Rows of arrays, frames of stimuli and transducers: the pose is new if any of them moves at all
        self._fixed = max([self._layout.frames.stop, *(rows.stop for rows in self._layout.transducers)])
        self._posed: list[PosedScene] = [runtime.work.reference for runtime in runtimes]
        self.forget()

    def forget(self) -> None:
        """Drop the last poses."""
        count = len(self.runtimes)
        self._resting: NDArray[np.bool_] = np.zeros(count, dtype=bool)
        self._where: Float = np.zeros((count, self._fixed, 12))

    def read(self, many: ManyData, own: slice) -> None:
        """Read the world frames of some worlds; many: their data."""
        for field, offsets, result in self._fields:
            many.gather(field, offsets, result[own])

    def now(self, some: NDArray[np.bool_]) -> dict[int, PosedScene]:
        """Return the poses of the selected worlds, for the frames that `read` has read. some: shape (worlds,).

        Raises SceneError, with the number of the world, if a body reaches into an array.
        """
        # All worlds share this object; in a copy it is that of the original
        reference = self.runtimes[0].work.reference
        fixed = np.concatenate((self._positions[:, : self._fixed], self._matrices[:, : self._fixed]), axis=2)
        same = self._resting & some & np.logical_and.reduce(fixed == self._where, axis=(1, 2))
        if np.logical_or.reduce(same):
            turns = self._matrices.reshape(*self._positions.shape, 3)
            same &= settled_worlds(self._model, self._layout, self._positions, turns, reference)
        for world in (some & ~same).nonzero()[0].tolist():
            with naming_world(world):
                posed = self._posed[world] = self.runtimes[world].posed
            self._where[world] = fixed[world]
            self._resting[world] = (
                posed.bodies == reference.bodies
                and posed.skins == reference.skins
                and posed.arrays.serial == self._model.arrays.serial
            )
        return {world: self._posed[world] for world in some.nonzero()[0].tolist()}
