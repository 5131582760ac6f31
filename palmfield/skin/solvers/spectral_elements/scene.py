"""A scene's layer on spectral elements."""

import functools
import math
import threading

import numpy as np

from palmfield.locked import locked_cached_property
from palmfield.skin.approximation.reduce_bulk_modulus import reduce_bulk_modulus
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
from palmfield.skin.problem import Body
from palmfield.skin.scene_layer import SceneLayer
from palmfield.skin.solvers.spectral_elements.mesh import Plan, build, plan
from palmfield.skin.solvers.spectral_elements.run import state_size
from palmfield.skin.solvers.spectral_elements.solid import Solid, face_areas
from palmfield.skin.solvers.spectral_elements.solve import (
    STIFFEST,
    likely_step,
    refusal_spectral_elements,
    solve_spectral_elements,
    step_seconds,
)
from palmfield.skin.solvers.spectral_elements.stepper import SpectralElementStepper, face_weights
from palmfield.skin.stepper import SkinStepper


class ElementLayer(ExplicitLayer):
    """Spectral elements; see ExplicitLayer."""

    steps = STEPS
    sizes_follow = (
        "elements follow studies on discs (docs/bench/skin_spectral_elements.md); the run estimates what was reached"
    )

    def __init__(self, layer: SceneLayer) -> None:
        self.layer, self.lock = layer, threading.RLock()

    @locked_cached_property
    def _reduced(self) -> tuple[Body, float]:
        """The body with a bulk modulus that allows longer steps, and the relative change of its motion."""
        load, width = planned_load(self.layer), self.layer.demand.spot_fwhm_m
        at = load.centres()[0] + np.array([[0.0, 0.0], [width, 0.0]])
        accuracy = self.layer.config.accuracy
        return reduce_bulk_modulus(body_of(self.layer), load, float(load.times_s[-1]), at, accuracy, None)

    @property
    def body(self) -> Body:
        """See ExplicitLayer."""
        return self._reduced[0]

    @locked_cached_property
    def chosen(self) -> Plan:
        """Order and size of the elements."""
        load, config = planned_load(self.layer), self.layer.config
        demand = self.layer.demand
        reach = min(demand.path_reach_m[1] + math.hypot(*demand.beside_m[:2]), config.radius_m or math.inf)
        return plan(self.body, load, load.centres()[0] + reach * np.array([[-1.0, -1.0], [1.0, 1.0]]), config.accuracy)

    @locked_cached_property
    def solid(self) -> Solid:
        """The elements."""
        return self.layer.with_keys(lambda: build(self.body, self.chosen)[0])

    @property
    def unknowns(self) -> int:
        """See ExplicitLayer."""
        return 3 * len(self.solid.nodes)

    @property
    def state_size(self) -> int:
        """See ExplicitLayer."""
        return state_size(self.solid, [sheet.material for sheet in self.body.sheets])

    @property
    def resolution(self) -> str:
        """See ExplicitLayer."""
        solid, material = self.solid, self.body.sheets[0].material
        words = f"{len(solid.elements)} elements of order {solid.order}, {len(solid.nodes)} nodes"
        if self._reduced[1] > 0.0:
            words += f", a bulk modulus of {material.bulk_Pa:.3g} Pa, which changes {100 * self._reduced[1]:.2g} %"
        return words

    def refuse(self) -> None:
        """See ExplicitLayer."""
        refuse_explicit(self.layer, STIFFEST, refusal_spectral_elements)

    def seconds(self, duration_s: float, device: str) -> float:
        """See ExplicitLayer."""
        # The second run of an estimate is the coarser one
        steps = (duration_s + 2.0 * trial_s(self.layer)) / likely_step(self.solid, self.body.sheets)
        return steps * step_seconds(self.solid, device != "cpu")

    def stepper(self, device: str) -> SkinStepper:
        """See ExplicitLayer."""
        system, solid = self.layer.system, self.solid
        face, nodes = solid.nodes[: solid.surface_nodes], system.mesh.nodes[: system.mesh.surface_nodes]
        transfer = self.layer.with_keys(lambda: FaceTransfer(system, face, face_weights(solid, nodes)))
        estimate = functools.partial(self._error, device)
        stepper = self.layer.with_keys(
            lambda: SpectralElementStepper(
                solid, self.body, transfer, self.layer.step_s, device, estimate, self.resolution
            )
        )
        check_steps(self.layer, stepper.steps)
        return stepper

    def _error(self, device: str) -> float:
        """What `palmfield.skin.solve` states for these elements under the trial load, and the bulk modulus's share."""
        solid, chosen = self.solid, self.chosen
        areas = np.linalg.norm(face_areas(solid), axis=1)
        load, times, at = trial(self.layer, self.body, solid.nodes[: solid.surface_nodes], areas)
        motion = solve_spectral_elements(
            self.body, load, times, at, accuracy=self.layer.config.accuracy, device=device, order=chosen.order,
            size_m=chosen.size_m, deep=chosen.deep, nu_at_most=0.5,
        )  # fmt: skip
        return motion.error + self._reduced[1]


scene_spectral_elements = ElementLayer
