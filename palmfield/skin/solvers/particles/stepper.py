"""Particles that step a state of the caller, for scenes: a preview."""

import math
from collections.abc import Callable
from functools import cached_property

import numpy as np
import warp as wp
from scipy import sparse

from palmfield.blas import one_blas_thread
from palmfield.errors import SceneError
from palmfield.skin.fem.face_transfer import FaceTransfer, ends_of_substeps, read
from palmfield.skin.solvers.particles.cloud import Cloud
from palmfield.skin.solvers.particles.probe import point_weights
from palmfield.skin.solvers.particles.run import (
    SAFETY,
    CrushedError,
    Particles,
    StepTooLongError,
    stable_step,
    state_size,
)
from palmfield.skin.stepper import Reader, SkinStepper, SurfaceLoads, check_step, world_by_world
from palmfield.types import Float

HALVINGS = 3
"""How often a call is begun anew with half the step where strain has stiffened the body."""


def face_weights(cloud: Cloud, points: Float) -> sparse.csr_matrix:
    """Motion at points of the face [m], (p, 3), by that of its particles, csr, shape (p, f)."""
    _, near, weights = point_weights(cloud.columns, cloud.face_area, points)
    rows = np.repeat(np.arange(len(near)), near.shape[1])
    return sparse.csr_matrix((weights.ravel(), (rows, near.ravel())), shape=(len(near), len(cloud.face_area)))


class ParticleStepper(SkinStepper):
    """Particles at finite strain under a dead load, in steps that divide a substep; see SkinStepper.

    cloud: the particles; transfer: from and to the scene's wedges; step_s: length of a substep [s]
    device: of `palmfield.device.resolve`; estimate: gives the error when asked for it
    resolution: the particles, in words
    A state has displacement, velocity and memory by particle and the stresses by site (see run.Particles.begin), as
    float32 in float64, so that it is the same on every device. Velocities are those of half a particles' step before.
    `step` also raises SceneError, and leaves the state as it was, for a body that is crushed or turned inside out.
    """

    name = "particles"
    points = None

    def __init__(
        self,
        cloud: Cloud,
        transfer: FaceTransfer,
        step_s: float,
        device: str,
        estimate: Callable[[], float],
        resolution: str,
    ) -> None:
        self.step_s, self._cloud, self._transfer = step_s, cloud, transfer
        self._device, self._estimate = device, estimate
        self.state_size, self.unknowns, self._resolution = state_size(cloud), 3 * len(cloud.points), resolution
        self._stable_s = stable_step(cloud)
        self.steps = math.ceil(step_s / (SAFETY * self._stable_s))
        """Of the particles in each substep."""
        self._rooms: list[dict[int, Particles]] = []

    @cached_property
    def error(self) -> float:  # type: ignore[override]  # found when it is asked for
        """See SkinStepper."""
        return self._estimate()

    def describe(self) -> str:
        """See SkinStepper."""
        return f"{self.name}, a preview: {self._resolution}"

    def step(
        self, state: Float, loads: SurfaceLoads, t0: float, t1: float, observe: Reader | None = None
    ) -> Float | None:
        """See SkinStepper."""
        check_step(self, state, loads, self._transfer.pressure.shape[1], t0, t1)
        if len(state) > 1:
            return world_by_world(self, state, loads, t0, t1, observe)
        with one_blas_thread:
            ends = ends_of_substeps(self._transfer.pressure, loads.pressure_Pa[0], loads.first[0], loads.last[0])
        try:
            bodies = self._rooms.pop()
        except IndexError:
            bodies = {}
        for halvings in range(HALVINGS + 1):
            steps = 2**halvings * self.steps
            if steps not in bodies:
                bodies[steps] = Particles(self._cloud, self._device, self.step_s / steps)
            body = bodies[steps]
            body.begin(state[0])
            try:
                motion = self._carry(body, ends, steps, observe is not None)
                body.check(self._stable_s)
            except (CrushedError, StepTooLongError) as error:
                if halvings < HALVINGS:
                    continue
                raise SceneError(
                    f"skin under {np.abs(ends).max():.3g} Pa from {t0:g} to {t1:g} s: {error}, even in steps of "
                    f"{body.step_s:.3g} s; solver 'particles' follows strain up to a step {2**HALVINGS} times shorter "
                    "than at rest: lower the pressure, or use solver 'wedges'"
                ) from error
            break
        body.numbers(state[0])
        self._rooms.append(bodies)
        return None if observe is None else read(motion, observe)[None]

    def _carry(self, body: Particles, ends: Float, steps: int, seen: bool) -> Float:
        """Take all steps; displacement and velocity of the face after each substep, shape (s, 2, f, 3), if seen."""
        substeps, count = len(ends) // 2, ends.shape[1]
        part = np.tile(np.arange(steps) / steps, substeps)[:, None]
        first, last = np.repeat(ends[0::2], steps, axis=0), np.repeat(ends[1::2], steps, axis=0)
        table: wp.array = wp.array(
            (first + part * (last - first)).astype(np.float32), dtype=wp.float32, device=body.device
        )
        motion = np.zeros((substeps if seen else 0, 2, count, 3))
        for substep in range(substeps):
            body.steps(steps, table, follower=False, first=substep * steps)
            if seen:
                motion[substep] = body.displacement.numpy()[:count], body.velocity.numpy()[:count]
        return motion

    def reader(self, operator: sparse.csr_matrix) -> Reader:
        """See SkinStepper. Raises SceneError for an operator that reads below the surface."""
        return self._transfer.reader(operator)

    def read(self, state: Float, reader: Reader) -> Float:
        """See SkinStepper."""
        particles, face = 3 * len(self._cloud.points), 3 * len(self._cloud.face_area)
        motion = np.stack([state[:, :face], state[:, particles : particles + face]], axis=1)
        return read(motion, reader)
