"""Layer of a scene on spectral elements and its stepper; the state belongs to the caller."""

import math

import numpy as np

from palmfield.locked import locked_cached_property
from palmfield.skin.approximation.reduce_bulk_modulus import reduce_bulk_modulus
from palmfield.skin.base import Foundation
from palmfield.skin.own_mesh import FaceTransfer, OwnMesh, OwnMeshStepper
from palmfield.skin.problem import Body, SkinProblem
from palmfield.skin.solvers.spectral_elements import solve
from palmfield.skin.solvers.spectral_elements.mesh import Plan, build, plan
from palmfield.skin.solvers.spectral_elements.model import SAFETY, Model, constraints
from palmfield.skin.solvers.spectral_elements.places import Table, find
from palmfield.skin.solvers.spectral_elements.run import Points, Stepper, state_size
from palmfield.skin.solvers.spectral_elements.solid import Solid, face_areas
from palmfield.types import Float, Int

LONGEST_GRAPH = 2000
"""Largest number of steps in one CUDA graph of a call."""


class ElementLayer(OwnMesh):
    """Layer of spectral elements; see ExplicitLayer."""

    stiffest = solve.STIFFEST
    refusal = staticmethod(solve.refusal_spectral_elements)
    sizes_follow = "sizes follow studies on discs (docs/bench/skin_spectral_elements.md); the run estimates the error"

    @locked_cached_property
    def _reduced(self) -> tuple[Body, float]:
        """Body with a bulk modulus that allows longer steps, and the relative change of its motion."""
        load, width = self.planned_load(), self.layer.demand.spot_fwhm_m
        at = load.centres()[0] + np.array([[0.0, 0.0], [width, 0.0]])
        accuracy = self.layer.config.accuracy
        return reduce_bulk_modulus(self.body_of(), load, float(load.times_s[-1]), at, accuracy, None)

    @property
    def body(self) -> Body:
        return self._reduced[0]

    @locked_cached_property
    def chosen(self) -> Plan:
        """Plan of the elements."""
        load, config = self.planned_load(), self.layer.config
        demand = self.layer.demand
        reach = min(demand.path_reach_m[1] + math.hypot(*demand.offset_m[:2]), config.radius_m or math.inf)
        return plan(self.body, load, load.centres()[0] + reach * np.array([[-1.0, -1.0], [1.0, 1.0]]), config.accuracy)

    @locked_cached_property
    def solid(self) -> Solid:
        """Elements of the body."""
        with self.layer.meshing():
            return build(self.body, self.chosen)[0]

    @property
    def unknowns(self) -> int:
        return 3 * len(self.solid.nodes)

    @property
    def state_size(self) -> int:
        return state_size(self.solid, [sheet.material for sheet in self.body.sheets])

    @property
    def resolution(self) -> str:
        solid, material = self.solid, self.body.sheets[0].material
        words = f"{len(solid.elements)} elements of order {solid.order}, {len(solid.nodes)} nodes"
        if self._reduced[1] > 0.0:
            words += f", a bulk modulus of {material.bulk_Pa:.3g} Pa, which changes {100 * self._reduced[1]:.2g} %"
        return words

    def seconds(self, duration_s: float, device: str) -> float:
        # The second run of an estimate is the coarser run
        steps = (duration_s + 2.0 * self.trial_s()) / solve.likely_step(self.solid, self.body.sheets)
        return steps * solve.step_seconds(self.solid, device != "cpu")

    @property
    def face(self) -> Float:
        return self.solid.nodes[: self.solid.surface_nodes]

    def near(self, points: Float) -> tuple[Int, Float]:
        return find(self.solid, points)

    def made(self, transfer: FaceTransfer, device: str) -> "SpectralElementStepper":
        return SpectralElementStepper(self, transfer, device)

    def error(self, device: str) -> float:
        """Return the error estimate of `palmfield.skin.solve` for elements and bulk modulus under the trial load."""
        solid, chosen = self.solid, self.chosen
        areas = np.linalg.norm(face_areas(solid), axis=1)
        load, times, at = self.trial(self.body, self.face, areas)
        motion = solve.solve_spectral_elements(
            SkinProblem(self.body, load, times, at, self.layer.config.accuracy, device=device),
            order=chosen.order,
            size_m=chosen.size_m,
            deep=chosen.deep,
            nu_at_most=0.5,
        )
        return motion.error + self._reduced[1]


class SpectralElementStepper(OwnMeshStepper):
    """A body on spectral elements, in steps of the scheme that divide a substep; see SkinStepper.

    A state has u and v by node, w and y of each branch by copy (see run.Stepper). Values are float32 stored as float64,
    so that states are the same on every device. Velocities are half a step of the scheme earlier.
    Raises SceneError for an element that is flat or inverted.
    """

    name = "spectral_elements"

    def __init__(self, own: ElementLayer, transfer: FaceTransfer, device: str) -> None:
        super().__init__(own, transfer, device)
        body = own.body
        assert not isinstance(body.base, Foundation)
        self._model = Model(own.solid, body.sheets, device)
        self.state_size = state_size(own.solid, self._model.materials)
        self._holds, self._stable_s = constraints(self._model, body.base, body.side, None)
        self.steps = math.ceil(self.step_s / (SAFETY * self._stable_s))
        self._rooms: list[Stepper] = []

    def carried(self, state: Float, ends: Float, t0: float, t1: float, observed: bool) -> Float | None:
        substeps = len(ends) // 2
        room = self._room(substeps)
        room.begin(state, ends)
        room.advance(self.steps * substeps)
        room.numbers(state)
        motion = None
        if observed:
            motion = np.stack([moved.numpy()[:substeps] for moved in room.readings()], axis=1).astype(np.float64)
        self._rooms.append(room)
        return motion

    def _room(self, substeps: int) -> Stepper:
        """Return work arrays, reused from an earlier call if no other thread has them; list operations are atomic."""
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
