"""Spectral elements that step a state of the caller, for scenes."""

import math
from collections.abc import Callable
from functools import cached_property

import numpy as np
from scipy import sparse

from palmfield.blas import one_blas_thread
from palmfield.skin.fem.face_transfer import FaceTransfer, ends_of_substeps, read
from palmfield.skin.problem import Body, Foundation
from palmfield.skin.solvers.spectral_elements.loads import Table
from palmfield.skin.solvers.spectral_elements.model import SAFETY, Model, hold
from palmfield.skin.solvers.spectral_elements.places import find
from palmfield.skin.solvers.spectral_elements.run import Points, Stepper, state_size
from palmfield.skin.solvers.spectral_elements.solid import Solid
from palmfield.skin.stepper import Reader, SkinStepper, SurfaceLoads, check_step, world_by_world
from palmfield.types import Float

LONGEST_GRAPH = 2000
"""Steps that one CUDA graph of a call holds at most."""


def face_weights(solid: Solid, points: Float) -> sparse.csr_matrix:
    """Motion at points of the face [m], (p, 3), by that of its nodes, csr, shape (p, f); errors as `find`."""
    nodes, shares = find(solid, points)
    rows = np.repeat(np.arange(len(nodes)), nodes.shape[1])
    return sparse.csr_matrix((shares.ravel(), (rows, nodes.ravel())), shape=(len(nodes), solid.surface_nodes))


class SpectralElementStepper(SkinStepper):
    """A body on spectral elements, in steps of the scheme that divide a substep; see SkinStepper.

    solid: the elements; body: its sheets, base and sides; transfer: from and to the scene's wedges
    step_s: length of a substep [s]; device: of `palmfield.device.resolve`; estimate: gives the error when asked for it
    resolution: the elements, in words
    A state has u and v by node, w and y of each branch by copy (see run.Stepper), as float32 in float64, so that it is
    the same on every device. Velocities are those of half a step of the scheme before.
    Raises SceneError for an element that is flat or inside out.
    """

    name = "spectral_elements"
    points = None

    def __init__(
        self,
        solid: Solid,
        body: Body,
        transfer: FaceTransfer,
        step_s: float,
        device: str,
        estimate: Callable[[], float],
        resolution: str,
    ) -> None:
        assert not isinstance(body.base, Foundation)
        self.step_s, self._transfer, self._estimate = step_s, transfer, estimate
        self._model = Model(solid, body.sheets, device)
        self.state_size, self.unknowns = state_size(solid, self._model.materials), 3 * len(solid.nodes)
        self._resolution = resolution
        self._holds = hold(self._model, body.base, body.side)
        rows = self._model.mass[self._holds.rows, None, None]
        rate = float((np.abs(self._holds.spring) / rows).sum(axis=2).max(initial=0.0))
        self._stable_s = self._model.stable_step(rate)
        self.steps = math.ceil(step_s / (SAFETY * self._stable_s))
        """Of the scheme in each substep."""
        self._rooms: list[Stepper] = []

    @cached_property
    def error(self) -> float:  # type: ignore[override]  # found when it is asked for
        """See SkinStepper."""
        return self._estimate()

    def describe(self) -> str:
        """See SkinStepper."""
        return f"{self.name}: {self._resolution}"

    def step(
        self, state: Float, loads: SurfaceLoads, t0: float, t1: float, observe: Reader | None = None
    ) -> Float | None:
        """See SkinStepper."""
        check_step(self, state, loads, self._transfer.pressure.shape[1], t0, t1)
        if len(state) > 1:
            return world_by_world(self, state, loads, t0, t1, observe)
        substeps = loads.first.shape[1]
        with one_blas_thread:
            frames = ends_of_substeps(self._transfer.pressure, loads.pressure_Pa[0], loads.first[0], loads.last[0])
        room = self._room(substeps)
        room.begin(state[0], frames)
        room.advance(self.steps * substeps)
        room.numbers(state[0])
        seen = None
        if observe is not None:
            motion = np.stack([moved.numpy()[:substeps] for moved in room.readings()], axis=1)
            seen = read(motion.astype(np.float64), observe)[None]
        self._rooms.append(room)
        return seen

    def reader(self, operator: sparse.csr_matrix) -> Reader:
        """See SkinStepper. Raises SceneError for an operator that reads below the surface."""
        return self._transfer.reader(operator)

    def read(self, state: Float, reader: Reader) -> Float:
        """See SkinStepper."""
        nodes, face = 3 * len(self._model.solid.nodes), 3 * self._model.solid.surface_nodes
        motion = np.stack([state[:, :face], state[:, nodes : nodes + face]], axis=1)
        return read(motion, reader)

    def _room(self, substeps: int) -> Stepper:
        """Arrays to step in: those of an earlier call if no other thread has them. Taken and given back atomically."""
        try:
            room = self._rooms.pop()
        except IndexError:
            return self._new_room(substeps)
        return room if len(room.frames) >= 2 * substeps else self._new_room(substeps)

    def _new_room(self, substeps: int) -> Stepper:
        model, count = self._model, self._model.solid.surface_nodes
        step, part = np.divmod(np.arange(self.steps * substeps), self.steps)
        table = Table(
            moving=False,
            steps=len(step),
            spot=np.zeros((1, 3)),
            spread=0.0,
            frames=np.zeros((2 * substeps, count)),
            frame=2 * step,
            share=part / self.steps,
        )
        target = self.steps * np.arange(1, substeps + 1, dtype=np.int32) - 1
        every = Points(np.arange(count, dtype=np.int32)[:, None], np.ones((count, 1)))
        length = self.step_s / self.steps
        graph = min(len(step), LONGEST_GRAPH)
        return Stepper(model, self._holds, length, table, every, target, self._stable_s, graph)
