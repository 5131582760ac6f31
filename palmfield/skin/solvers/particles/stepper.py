"""Particle layer of a scene and its stepper, for previews; the state belongs to the caller."""

import math

import numpy as np
import warp as wp

from palmfield.errors import SceneError
from palmfield.locked import locked_cached_property
from palmfield.skin.own_mesh import FaceTransfer, OwnMesh, OwnMeshStepper
from palmfield.skin.problem import Body, Layer, SkinProblem, Slab
from palmfield.skin.solvers.particles import resolution as spacing
from palmfield.skin.solvers.particles import run
from palmfield.skin.solvers.particles.cloud import Cloud, build_cloud
from palmfield.skin.solvers.particles.solve import point_weights, solve_particles
from palmfield.types import Float, Int

HALVINGS = 3
"""Largest number of times that a call is repeated with half the step after strain has stiffened the body."""


class ParticleLayer(OwnMesh):
    """Layer of particles, for previews; see ExplicitLayer."""

    preview, large_strain, stiffest = True, True, spacing.STIFFEST
    refusal = staticmethod(spacing.refusal_particles)
    sizes_follow = (
        "error measured on discs with this spacing (docs/bench/skin_particles.md); the run states at least this value"
    )

    @locked_cached_property
    def spacing_m(self) -> float:
        """Distance of particles for the target accuracy [m]."""
        return spacing.choose_spacing(self.body_of(), self.planned_load(), self.layer.config.accuracy)

    @locked_cached_property
    def body(self) -> Body:
        """See OwnMesh. The edges of a patch are as long as the distance of particles."""
        return self.body_of(self.spacing_m / self.layer.sizes.edge_fine_m)

    @locked_cached_property
    def cloud(self) -> Cloud:
        """Particles of the body."""
        with self.layer.meshing():
            return build_cloud(self.body, self.spacing_m)

    @property
    def unknowns(self) -> int:
        return 3 * len(self.cloud.points)

    @property
    def state_size(self) -> int:
        return run.state_size(self.cloud)

    @property
    def resolution(self) -> str:
        return f"{len(self.cloud.points)} particles {1e3 * self.cloud.columns.spacing_m:.2g} mm apart"

    @property
    def expected_error(self) -> float:
        """See LayerSolver. It is the error of particles with this distance on discs."""
        return spacing.law_error(self.body, self.planned_load(), self.cloud.columns.spacing_m)

    def seconds(self, duration_s: float, device: str) -> float:
        # The error estimate of a disc takes two further runs
        more = 2.0 * self.trial_s() if isinstance(self.body, Slab) else 0.0
        each = len(self.cloud.points) * spacing.SECONDS_A_STEP["cpu" if device == "cpu" else "cuda"]
        return (duration_s + more) / run.likely_step(self.cloud) * each

    @property
    def face(self) -> Float:
        return self.cloud.columns.face

    def near(self, points: Float) -> tuple[Int, Float]:
        _, near, shares = point_weights(self.cloud.columns, self.cloud.face_area, points)
        return near, shares

    def made(self, transfer: FaceTransfer, device: str) -> "ParticleStepper":
        return ParticleStepper(self, transfer, device)

    def error(self, device: str) -> float:
        """Return the error estimate of `palmfield.skin.solve` for particles at this distance under the trial load."""
        body, face = self.body, self.cloud.columns.face
        if isinstance(body, Layer):
            return self.expected_error
        load, times, at = self.trial(body, face, np.linalg.norm(self.cloud.face_area, axis=1))
        motion = solve_particles(SkinProblem(body, load, times, at, device=device), spacing_m=self.spacing_m)
        return max(motion.error, self.expected_error)


class ParticleStepper(OwnMeshStepper):
    """Particles at finite strain under a dead load, in steps that divide a substep; see SkinStepper.

    A state has displacement, velocity and memory by particle and stresses by site (see run.Particles.begin). Values are
    float32 stored as float64, so that states are the same on every device. Velocities are half a step of the particles
    earlier. `step` also raises SceneError, without a change of the state, for a body that is crushed or inverted.
    """

    name = "particles"

    def __init__(self, own: ParticleLayer, transfer: FaceTransfer, device: str) -> None:
        super().__init__(own, transfer, device)
        cloud = self._cloud = own.cloud
        self.state_size = run.state_size(cloud)
        self._stable_s = run.stable_step(cloud)
        self.steps = math.ceil(self.step_s / (run.SAFETY * self._stable_s))
        self._rooms: list[dict[int, run.Particles]] = []

    def carried(self, state: Float, ends: Float, t0: float, t1: float, observed: bool) -> Float:
        try:
            bodies = self._rooms.pop()
        except IndexError:
            bodies = {}
        for halvings in range(HALVINGS + 1):
            steps = 2**halvings * self.steps
            if steps not in bodies:
                bodies[steps] = run.Particles(self._cloud, self._device, self.step_s / steps)
            body = bodies[steps]
            body.begin(state)
            try:
                motion = self._carry(body, ends, steps, observed)
                body.check(self._stable_s)
            except (run.CrushedError, run.StepTooLongError) as error:
                if halvings < HALVINGS:
                    continue
                raise SceneError(
                    f"skin under {np.abs(ends).max():.3g} Pa from {t0:g} to {t1:g} s: {error}, even in steps of "
                    f"{body.step_s:.3g} s; solver 'particles' allows strain that shortens the step by up to "
                    f"{2**HALVINGS} times: lower the pressure, or use solver 'wedges'"
                ) from error
            break
        body.numbers(state)
        self._rooms.append(bodies)
        return motion

    def _carry(self, body: run.Particles, ends: Float, steps: int, observed: bool) -> Float:
        """Do all steps; if observed, return displacement and velocity of the face after each substep, (s, 2, f, 3)."""
        substeps, count = len(ends) // 2, ends.shape[1]
        part = np.tile(np.arange(steps) / steps, substeps)[:, None]
        first, last = np.repeat(ends[0::2], steps, axis=0), np.repeat(ends[1::2], steps, axis=0)
        table: wp.array = wp.array(
            (first + part * (last - first)).astype(np.float32), dtype=wp.float32, device=body.device
        )
        motion = np.zeros((substeps if observed else 0, 2, count, 3))
        for substep in range(substeps):
            body.steps(steps, table, follower=False, first=substep * steps)
            if observed:
                motion[substep] = body.displacement.numpy()[:count], body.velocity.numpy()[:count]
        return motion
