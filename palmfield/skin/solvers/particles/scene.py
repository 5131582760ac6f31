"""A scene's layer of particles."""

import functools
import threading

import numpy as np

from palmfield.locked import locked_cached_property
from palmfield.skin.explicit_layer import (
    STEPS,
    ExplicitLayer,
    body_of,
    check_steps,
    planned_load,
    refuse_explicit,
    trial,
    trial_s,
)
from palmfield.skin.fem.face_transfer import FaceTransfer
from palmfield.skin.problem import Body, Layer, Slab
from palmfield.skin.scene_layer import SceneLayer
from palmfield.skin.solvers.particles.cloud import Cloud, build_cloud
from palmfield.skin.solvers.particles.resolution import (
    SECONDS_A_STEP,
    STIFFEST,
    choose_spacing,
    law_error,
    refusal_particles,
)
from palmfield.skin.solvers.particles.run import likely_step, state_size
from palmfield.skin.solvers.particles.solve import solve_particles
from palmfield.skin.solvers.particles.stepper import ParticleStepper, face_weights
from palmfield.skin.stepper import SkinStepper


class ParticleLayer(ExplicitLayer):
    """Particles, a preview; see ExplicitLayer."""

    preview, steps = True, STEPS
    sizes_follow = "what such particles had on discs (docs/bench/skin_particles.md); the run states at least as much"

    def __init__(self, layer: SceneLayer) -> None:
        self.layer, self.lock = layer, threading.RLock()

    @locked_cached_property
    def spacing_m(self) -> float:
        """Distance of particles for the wanted accuracy [m]."""
        return choose_spacing(body_of(self.layer), planned_load(self.layer), self.layer.config.accuracy)

    @locked_cached_property
    def body(self) -> Body:
        """See ExplicitLayer; a patch is meshed with edges as long as the particles are apart."""
        return body_of(self.layer, self.spacing_m / self.layer.sizes.edge_fine_m)

    @locked_cached_property
    def cloud(self) -> Cloud:
        """The particles."""
        return self.layer.with_keys(lambda: build_cloud(self.body, self.spacing_m))

    @property
    def unknowns(self) -> int:
        """See ExplicitLayer."""
        return 3 * len(self.cloud.points)

    @property
    def state_size(self) -> int:
        """See ExplicitLayer."""
        return state_size(self.cloud)

    @property
    def resolution(self) -> str:
        """See ExplicitLayer."""
        return f"{len(self.cloud.points)} particles {1e3 * self.cloud.columns.spacing_m:.2g} mm apart"

    @property
    def expected_error(self) -> float:
        """See ExplicitLayer: what particles at this distance had on discs."""
        return law_error(self.body, planned_load(self.layer), self.cloud.columns.spacing_m)

    def refuse(self) -> None:
        """See ExplicitLayer."""
        refuse_explicit(self.layer, STIFFEST, refusal_particles)

    def seconds(self, duration_s: float, device: str) -> float:
        """See ExplicitLayer."""
        # A disc's own error takes two runs more
        more = 2.0 * trial_s(self.layer) if isinstance(self.body, Slab) else 0.0
        each = len(self.cloud.points) * SECONDS_A_STEP["cpu" if device == "cpu" else "cuda"]
        return (duration_s + more) / likely_step(self.cloud) * each

    def stepper(self, device: str) -> SkinStepper:
        """See ExplicitLayer."""
        system, cloud = self.layer.system, self.cloud
        nodes = system.mesh.nodes[: system.mesh.surface_nodes]
        transfer = self.layer.with_keys(lambda: FaceTransfer(system, cloud.columns.face, face_weights(cloud, nodes)))
        estimate = functools.partial(self._error, device)
        stepper = ParticleStepper(cloud, transfer, self.layer.step_s, device, estimate, self.resolution)
        check_steps(self.layer, stepper.steps)
        return stepper

    def _error(self, device: str) -> float:
        """What `palmfield.skin.solve` states for particles so far apart under the trial load."""
        body, face = self.body, self.cloud.columns.face
        if isinstance(body, Layer):
            return self.expected_error
        load, times, at = trial(self.layer, body, face, np.linalg.norm(self.cloud.face_area, axis=1))
        motion = solve_particles(body, load, times, at, device=device, spacing_m=self.spacing_m)
        return max(motion.error, self.expected_error)


scene_particles = ParticleLayer
