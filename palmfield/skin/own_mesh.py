"""Common code of solvers, and their steppers, with their own mesh below the face of a layer; transfer to its wedges.

Body, loads and operators are those of the wedges of the scene.
"""

import functools
import math
import threading
from typing import Any, Protocol

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from palmfield.blas import one_blas_thread
from palmfield.errors import SceneError
from palmfield.skin.approximation.truncate_domain import refusal_of_spot
from palmfield.skin.explicit_layer import ExplicitLayer
from palmfield.skin.fem.assembly import SkinSystem
from palmfield.skin.fem.probe import SurfaceProbe
from palmfield.skin.from_config import base_of
from palmfield.skin.materials.material import Sheet
from palmfield.skin.mesh.element import triangle_rule, triangle_shape
from palmfield.skin.problem import GAUSSIAN, Body, Layer, Load, Slab, Spot, Traction
from palmfield.skin.scene_layer import SceneLayer
from palmfield.skin.stepper import Reader, SkinStepper, SurfaceLoads, check_step, checked_operator, world_by_world
from palmfield.types import Float, Int

TONE = 8
"""Number of periods of the load for the choice of meshes: enough for a line spectrum."""
TRIAL, LONGEST_TRIAL_s = 2, 0.02
"""Length of the load for the error estimate: periods of the main frequency, and upper limit [s]."""
SAMPLES = 32
"""Number of times in each period."""
MOST_STEPS = 20_000
"""Largest number of steps of a scheme in one MuJoCo step."""


class FaceTransfer:
    """Matrices between the wedges, which define loads and operators, and the face of a stepper with its own mesh.

    system: system of the wedges. points: nodes of the other face [m], shape (f, 3).
    weights: from motion at the nodes of the other face to motion at the surface nodes of the wedges, csr, (S, f).
    pressure: from pressure at the quadrature points of the layer to pressure at the nodes of the other face, csr,
        (f, q); it evaluates the quadratic polynomial through the six points of each triangle.
    motion: from displacement of the nodes of the other face to unknowns of the wedges, csr, (ndof, 3 f); 0 below it.
    """

    def __init__(self, system: SkinSystem, points: Float, weights: sparse.csr_matrix) -> None:
        mesh, nodes = system.mesh, 3 * system.mesh.surface_nodes
        place = SurfaceProbe(mesh, points, system)
        rule, _ = triangle_rule()
        values = triangle_shape(place.local) @ np.linalg.inv(triangle_shape(rule))
        rows = np.repeat(np.arange(len(points)), len(rule))
        columns = (len(rule) * place.triangles[:, None] + np.arange(len(rule))).ravel()
        count = len(rule) * len(mesh.surface_triangles6)
        self.pressure = sparse.csr_matrix((values.ravel(), (rows, columns)), shape=(len(points), count))
        # The columns of the map are orthonormal, so its transpose gives the unknowns of nodal displacements
        unknowns = sparse.csr_matrix(system.dof_map.T)
        self.motion = sparse.csr_matrix(unknowns[:, :nodes] @ sparse.kron(weights, sparse.identity(3), format="csr"))
        self._below = unknowns[:, nodes:]

    def reader(self, operator: sparse.csr_matrix) -> Reader:
        """Convert an operator (m, ndof) on the wedges to a Reader of the nodes of the other face.

        Raises SceneError for another number of columns and for an operator that reads below the surface.
        """
        matrix = checked_operator(operator, len(self.motion.indptr) - 1)
        below = np.abs((matrix @ self._below).data).max(initial=0.0)
        if below > 1e-9 * np.abs(matrix.data).max(initial=0.0):
            raise SceneError(
                f"skin reader: the operator reads below the surface of the skin, with weights up to {below:.3g}; a "
                "solver with its own mesh gives only the motion of the surface: use solver 'wedges'"
            )
        return Reader(matrix.shape[0], sparse.csr_matrix(matrix @ self.motion))


def read(motion: Float, reader: Reader) -> Float:
    """Return displacement and velocity, (s, 2, m), from the motion of the nodes of the other face, (s, 2, f, 3)."""
    flat = motion.reshape(2 * len(motion), -1)
    return np.ascontiguousarray((reader.matrix @ flat.T).T).reshape(len(motion), 2, reader.count)


def ends_of_substeps(pressure: sparse.csr_matrix, patterns: Float, first: Float, last: Float) -> Float:
    """Return the pressure at the nodes of a face at start and end of each substep, alternating, shape (2 s, f).

    pressure: as in FaceTransfer; patterns: at the quadrature points [Pa], (k, q); first, last: weights, (s, k)
    """
    weights = np.stack([first, last], axis=1).reshape(2 * len(first), -1)
    there = np.ascontiguousarray((pressure @ np.asarray(patterns, dtype=np.float64).T).T)
    return weights @ there


class OwnMesh(ExplicitLayer, Protocol):
    """A layer on its own mesh, which a solver steps explicitly.

    face: nodes of the face [m], shape (f, 3); stiffest: largest allowed ratio of bulk to shear modulus
    """

    steps: str = "explicit steps, limited by the time in which a pressure wave crosses an element"
    stiffest: float
    layer: SceneLayer
    lock: Any

    def __init__(self, layer: SceneLayer) -> None:
        self.layer, self.lock = layer, threading.RLock()

    @property
    def face(self) -> Float: ...

    def refusal(self, body: Body, load: Load) -> str | None:
        """Return the reason why the solver cannot solve a problem, in a sentence, or None."""
        ...

    def near(self, points: Float) -> tuple[Int, Float]:
        """Return nodes and weights, both (p, k), that interpolate the motion at points of the face [m], (p, 3)."""
        ...

    def made(self, transfer: FaceTransfer, device: str) -> "OwnMeshStepper":
        """Make the stepper; transfer: matrices from and to the wedges of the scene."""
        ...

    def error(self, device: str) -> float:
        """Return the error estimate of `palmfield.skin.solve` for this mesh under the trial load, with omissions."""
        ...

    def stepper(self, device: str) -> "OwnMeshStepper":
        system, mesh = self.layer.system, self.layer.mesh
        with self.layer.meshing():
            near, shares = self.near(mesh.nodes[: mesh.surface_nodes])
            rows = np.repeat(np.arange(len(near)), near.shape[1])
            weights = sparse.csr_matrix((shares.ravel(), (rows, near.ravel())), shape=(len(near), len(self.face)))
            made = self.made(FaceTransfer(system, self.face, weights), device)
        self._check_steps(made.steps)
        return made

    def refuse(self) -> None:
        config = self.layer.config
        if config.side == "absorbing":
            allowed = "fixed, free" + (", roller" if config.shape == "disc" else "")
            raise SceneError(
                f"the solver takes no side 'absorbing'; allowed: {allowed}; or solver wedges", mends=("side",)
            )
        if config.foundation is not None:
            raise SceneError(
                f"the solver takes no foundation, here of {config.foundation[0]:g} Pa/m; allowed: none (base springs "
                "is one that spectral_elements has), or solver wedges",
                mends=("foundation_normal_Pa_m", "foundation_tangential_Pa_m"),
            )
        for material in (sheet.material for sheet in self.layer.sheets):
            ratio = material.bulk_Pa / material.shear_instant_Pa
            if ratio > self.stiffest:
                raise SceneError(
                    f"material '{material.name}' has a bulk modulus of {ratio:.3g} times its shear modulus; allowed "
                    f"with the solver, as it steps with the pressure wave: at most {self.stiffest:g}; or solver wedges",
                    mends=("material", "materials", "bulk_Pa"),
                )
        # A slab of the same sheets; only base and materials are checked here
        sheets = tuple(Sheet(sheet.material, 0.01 * sheet.thickness_m) for sheet in self.layer.sheets)
        slab = Slab(sheets, "disc", base_of(config, sheets), "fixed", 0.1)
        load = Spot(self.layer.demand.spot_fwhm_m, np.zeros(1), np.ones(1))
        reason = self.refusal(slab, load)
        if reason is not None:
            raise SceneError(reason)

    def body_of(self, refinement: float = 1.0) -> Body:
        """Return the body below the face of a layer, in its frame: a disc, or the sheets below its patch.

        refinement: factor on the edges of the patch, at most 1.
        """
        config = self.layer.config
        if config.shape == "disc":
            assert config.radius_m and config.thickness_m
            sheets = tuple(Sheet(sheet.material, sheet.thickness_m * config.thickness_m) for sheet in self.layer.sheets)
            return Slab(sheets, "disc", base_of(config, sheets), config.side, config.radius_m)
        patch = self.layer.patch if refinement >= 1.0 else self.layer.resized(refinement * self.layer.resizing).patch
        return Layer(patch, self.layer.sheets, base_of(config, self.layer.sheets), config.side)

    def planned_load(self) -> Spot:
        """Return the load for the choice of meshes; spot width and frequency come from the demand of the layer."""
        return self._spot(TONE, self.layer.demand.max_frequency_Hz)

    def trial_s(self) -> float:
        """Return the duration of the load for the error estimate [s]."""
        return min(TRIAL / self.layer.demand.main_frequency_Hz, LONGEST_TRIAL_s)

    def trial(self, body: Body, points: Float, areas_m2: Float) -> tuple[Load, Float, Float]:
        """Return the load for the error estimate, the output times, and two points of the face.

        points [m], (f, 3), areas_m2, (f,): points of the face and their areas, for a face on which x and y do not
        define a spot
        """
        f_Hz, middle = self.layer.demand.main_frequency_Hz, self._middle()
        spot = self._spot(self.trial_s() * f_Hz, f_Hz)
        load: Load = spot
        if refusal_of_spot(body, spot) is not None:
            away = np.linalg.norm(points - middle, axis=1)
            shape = np.exp(-GAUSSIAN * (away / spot.fwhm_m) ** 2)
            load = Traction(points, areas_m2, spot.times_s, spot.peak_Pa[:, None] * shape)
        away = np.linalg.norm(points - middle, axis=1)
        flank = points[np.argmin(np.abs(away - 0.5 * spot.fwhm_m))]
        return load, spot.times_s[1:], np.stack([points[np.argmin(away)], flank])

    def _spot(self, periods: float, f_Hz: float) -> Spot:
        """Return a spot in the middle of the layer whose pressure oscillates between 0 and 1 Pa."""
        times = np.linspace(0.0, periods / f_Hz, math.ceil(SAMPLES * periods) + 1)
        return Spot(self.layer.demand.spot_fwhm_m, times, np.sin(math.pi * f_Hz * times) ** 2, self._middle()[:2])

    def _middle(self) -> Float:
        """Return the middle of the layer on its face, body frame [m], shape (3,)."""
        if self.layer.config.shape == "disc":
            return np.zeros(3)
        vertices = self.layer.patch.vertices
        return vertices[cKDTree(vertices).query(self.layer.centre_m)[1]]

    def _check_steps(self, steps: int) -> None:
        """Raise SceneError if a MuJoCo step needs more than MOST_STEPS steps of the scheme."""
        in_one = steps * round(self.layer.demand.timestep_s / self.layer.step_s)
        if in_one > MOST_STEPS:
            with self.layer.named:
                raise SceneError(
                    f"the solver needs {in_one:,} steps per MuJoCo step of {self.layer.demand.timestep_s:g} s; "
                    f"allowed: at most {MOST_STEPS:,}; set the accuracy or the depth larger, the bulk modulus or the "
                    "timestep smaller, or solver to wedges",
                    setting="solver",
                    mends=("accuracy", "depth_m", "bulk_Pa"),
                )


class OwnMeshStepper(SkinStepper, Protocol):
    """Step a layer on its own mesh, in steps of a scheme that divide a substep; see SkinStepper.

    own: the layer. transfer: matrices from and to the wedges of the scene. device: from `palmfield.device.resolve`.
    steps: number of steps of the scheme in each substep.
    """

    points: Int | None = None
    steps: int
    _own: OwnMesh
    _transfer: FaceTransfer
    _device: str

    def __init__(self, own: OwnMesh, transfer: FaceTransfer, device: str) -> None:
        self._own, self._transfer, self._device = own, transfer, device
        self.step_s, self.unknowns = own.layer.step_s, own.unknowns

    @functools.cached_property
    def error(self) -> float:  # type: ignore[override]  # computed at first use
        return self._own.error(self._device)

    def carried(self, state: Float, ends: Float, t0: float, t1: float, observed: bool) -> Float | None:
        """Advance the state of one world, (state_size,), in place from t0 to t1 [s].

        ends: pressure [Pa] at the nodes of the face at both ends of each substep, (2 s, f)
        Returns the motion of the face after each substep, (s, 2, f, 3), or None unless `observed`."""
        ...

    def step(
        self, state: Float, loads: SurfaceLoads, t0: float, t1: float, observe: Reader | None = None
    ) -> Float | None:
        check_step(self, state, loads, self._transfer.pressure.shape[1], t0, t1)
        if len(state) > 1:
            return world_by_world(self, state, loads, t0, t1, observe)
        with one_blas_thread:
            ends = ends_of_substeps(self._transfer.pressure, loads.pressure_Pa[0], loads.first[0], loads.last[0])
        motion = self.carried(state[0], ends, t0, t1, observe is not None)
        return None if observe is None or motion is None else read(motion, observe)[None]

    def describe(self) -> str:
        return f"{self.name}{', a preview' * self._own.preview}: {self._own.resolution}"

    def reader(self, operator: sparse.csr_matrix) -> Reader:
        """See SkinStepper. Raises SceneError for an operator that reads below the surface."""
        return self._transfer.reader(operator)

    def read(self, state: Float, reader: Reader) -> Float:
        """See SkinStepper. A state begins with displacement and velocity of all nodes; nodes of the face are first."""
        face = 3 * len(self._own.face)
        return read(np.stack([state[:, :face], state[:, self.unknowns : self.unknowns + face]], axis=1), reader)
