"""A scene's layer on a mesh of its own, for the solvers that step explicitly: spectral elements and particles.

Body, loads and operators are those of the scene's wedges; what is here has its own elements or particles below the same
face.
"""

import functools
import math
import threading
from typing import Protocol

import numpy as np
from scipy.spatial import cKDTree

from palmfield.errors import SceneError
from palmfield.locked import locked_cached_property
from palmfield.skin.approximation.reduce_bulk_modulus import reduce_bulk_modulus
from palmfield.skin.approximation.trim_absorbing_rim import refusal_of_spot
from palmfield.skin.fem.face_transfer import FaceTransfer
from palmfield.skin.from_config import base_of
from palmfield.skin.problem import GAUSSIAN, Body, Layer, Load, Sheet, Slab, Spot, Traction
from palmfield.skin.scene_layer import SceneLayer
from palmfield.skin.solvers.particles.cloud import Cloud, build_cloud
from palmfield.skin.solvers.particles.resolution import SECONDS_A_STEP, choose_spacing, law_error, refusal_particles
from palmfield.skin.solvers.particles.run import likely_step as likely_particle_step
from palmfield.skin.solvers.particles.run import state_size as particle_state_size
from palmfield.skin.solvers.particles.solve import solve_particles
from palmfield.skin.solvers.particles.stepper import ParticleStepper
from palmfield.skin.solvers.particles.stepper import face_weights as particle_weights
from palmfield.skin.solvers.spectral_elements.mesh import Plan, build, plan
from palmfield.skin.solvers.spectral_elements.run import state_size as element_state_size
from palmfield.skin.solvers.spectral_elements.solid import Solid, face_areas
from palmfield.skin.solvers.spectral_elements.solve import (
    STIFFEST,
    likely_step,
    refusal_spectral_elements,
    solve_spectral_elements,
    step_seconds,
)
from palmfield.skin.solvers.spectral_elements.stepper import SpectralElementStepper
from palmfield.skin.solvers.spectral_elements.stepper import face_weights as element_weights
from palmfield.skin.stepper import SkinStepper
from palmfield.types import Float

TONE = 8
"""Periods of the load for which meshes are chosen: enough for a spectrum that is a line."""
TRIAL, LONGEST_TRIAL_s = 2, 0.02
"""Periods of the main frequency under which a solver estimates its error, and at most that long [s]."""
SAMPLES = 32
"""Times in each period."""
MOST_STEPS = 20_000
"""Of a scheme in one of MuJoCo's steps."""


class ExplicitLayer(Protocol):
    """A layer on a mesh of its own.

    body: as the solver steps it; unknowns: of its mesh; state_size: numbers of its state
    resolution: in words; expected_error: relative, of the displacement, before anything runs, or None
    """

    @property
    def body(self) -> Body: ...
    @property
    def unknowns(self) -> int: ...
    @property
    def state_size(self) -> int: ...
    @property
    def resolution(self) -> str: ...
    @property
    def expected_error(self) -> float | None: ...

    def seconds(self, duration_s: float, device: str) -> float:
        """Predicted time of a run of this length [s] on a device, with what estimates the error [s]."""
        ...

    def stepper(self, device: str) -> SkinStepper:
        """What steps it on a device of `palmfield.device.resolve`. Raises SceneError for elements that can't be."""
        ...


@functools.lru_cache(maxsize=8)
def explicit_layer(layer: SceneLayer) -> ExplicitLayer:
    """The layer on the mesh of its key `solver`, "spectral_elements" or "particles"; the same for the same layer."""
    return ElementLayer(layer) if layer.config.solver == "spectral_elements" else ParticleLayer(layer)


def refuse_explicit(layer: SceneLayer) -> None:
    """Raise SceneError, with element, key, value and what is allowed, for what the layer's solver can't step.

    Looks at keys and materials alone: nothing is meshed.
    """
    config, solver = layer.config, layer.config.solver
    element = f"{layer.element}: key 'solver' has value '{solver}'"
    if config.side == "absorbing":
        allowed = "fixed, free" + (", roller" if config.shape == "disc" else "")
        raise SceneError(f"{element} and key 'side' value 'absorbing'; allowed with it: {allowed}; or solver wedges")
    if config.foundation is not None:
        raise SceneError(
            f"{element} and key 'foundation_normal_Pa_m' value '{config.foundation[0]:g}'; allowed with it: no "
            "foundation (base springs is one that spectral_elements has); or solver wedges"
        )
    for material in (sheet.material for sheet in layer.sheets):
        ratio = material.bulk_Pa / material.shear_instant_Pa
        if ratio > STIFFEST:
            raise SceneError(
                f"{element} and material '{material.name}' a bulk modulus of {ratio:.3g} times its shear modulus; "
                f"allowed with it, as it steps with the pressure wave: at most {STIFFEST:g} (keys material, materials, "
                "bulk_Pa); or solver wedges"
            )
    # A slab of the same sheets: what is asked of it here are base and materials
    sheets = tuple(Sheet(sheet.material, 0.01 * sheet.thickness_m) for sheet in layer.sheets)
    slab = Slab(sheets, "disc", base_of(config), "fixed", 0.1)
    load = Spot(layer.demand.spot_fwhm_m, np.zeros(1), np.ones(1))
    ask = refusal_spectral_elements if solver == "spectral_elements" else refusal_particles
    reason = ask(slab, load)
    if reason is not None:
        raise SceneError(f"{element}, but {reason}")


def body_of(layer: SceneLayer, refinement: float = 1.0) -> Body:
    """The body below a layer's face, in its frame: a disc, or the sheets below its patch.

    refinement: factor of the patch's edges, at most 1
    """
    config = layer.config
    if config.shape == "disc":
        assert config.radius_m and config.thickness_m
        sheets = tuple(Sheet(sheet.material, sheet.thickness_m * config.thickness_m) for sheet in layer.sheets)
        return Slab(sheets, "disc", base_of(config), config.side, config.radius_m)
    patch = layer.patch if refinement >= 1.0 else layer.resized(refinement * layer.resizing).patch
    return Layer(patch, layer.sheets, base_of(config), config.side)


def planned_load(layer: SceneLayer) -> Spot:
    """A spot as wide and a tone as high as the layer is made for, by which meshes are chosen."""
    return _spot(layer, TONE, layer.demand.max_frequency_Hz)


def _spot(layer: SceneLayer, periods: float, f_Hz: float) -> Spot:
    """A spot in the layer's middle whose pressure goes up and down between 0 and 1 Pa."""
    times = np.linspace(0.0, periods / f_Hz, math.ceil(SAMPLES * periods) + 1)
    return Spot(layer.demand.spot_fwhm_m, times, np.sin(math.pi * f_Hz * times) ** 2, _middle(layer)[:2])


def _middle(layer: SceneLayer) -> Float:
    """The middle of the layer on its face, body frame [m], shape (3,)."""
    if layer.config.shape == "disc":
        return np.zeros(3)
    vertices = layer.patch.vertices
    return vertices[cKDTree(vertices).query(layer.centre_m)[1]]


def _trial_s(layer: SceneLayer) -> float:
    """Time under the load by which a solver estimates its error [s]."""
    return min(TRIAL / layer.demand.main_frequency_Hz, LONGEST_TRIAL_s)


def _trial(layer: SceneLayer, body: Body, points: Float, areas_m2: Float) -> tuple[Load, Float, Float]:
    """The load under which a solver estimates its error, the times at which it looks, and two points of the face.

    points, areas_m2: of the face [m], (f, 3) and (f,), for a face on which a spot can't be given by its x and y
    """
    f_Hz, middle = layer.demand.main_frequency_Hz, _middle(layer)
    spot = _spot(layer, _trial_s(layer) * f_Hz, f_Hz)
    load: Load = spot
    if refusal_of_spot(body, spot) is not None:
        away = np.linalg.norm(points - middle, axis=1)
        shape = np.exp(-GAUSSIAN * (away / spot.fwhm_m) ** 2)
        load = Traction(points, areas_m2, spot.times_s, spot.peak_Pa[:, None] * shape)
    away = np.linalg.norm(points - middle, axis=1)
    beside = points[np.argmin(np.abs(away - 0.5 * spot.fwhm_m))]
    return load, spot.times_s[1:], np.stack([points[np.argmin(away)], beside])


def _check_steps(layer: SceneLayer, steps: int) -> None:
    """Raise SceneError where a substep of the scene takes so many steps of the scheme that a run would not end."""
    in_one = steps * round(layer.demand.timestep_s / layer.step_s)
    if in_one > MOST_STEPS:
        raise SceneError(
            f"{layer.element}: key 'solver' has value '{layer.config.solver}', which takes {in_one:,} steps in each of "
            f"MuJoCo's, of {layer.demand.timestep_s:g} s, so that the run would not end; allowed: at most "
            f"{MOST_STEPS:,}; set accuracy or depth_m larger, bulk_Pa or timestep smaller, or solver to wedges"
        )


class ElementLayer:
    """Spectral elements; see ExplicitLayer."""

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
        return element_state_size(self.solid, [sheet.material for sheet in self.body.sheets])

    @property
    def resolution(self) -> str:
        """See ExplicitLayer."""
        solid, material = self.solid, self.body.sheets[0].material
        words = f"{len(solid.elements)} elements of order {solid.order}, {len(solid.nodes)} nodes"
        if self._reduced[1] > 0.0:
            words += f", a bulk modulus of {material.bulk_Pa:.3g} Pa, which changes {100 * self._reduced[1]:.2g} %"
        return words

    @property
    def expected_error(self) -> float | None:
        """See ExplicitLayer: none, as it takes two runs to tell."""
        return None

    def seconds(self, duration_s: float, device: str) -> float:
        """See ExplicitLayer."""
        # The second run of an estimate is the coarser one
        steps = (duration_s + 2.0 * _trial_s(self.layer)) / likely_step(self.solid, self.body.sheets)
        return steps * step_seconds(self.solid, device != "cpu")

    def stepper(self, device: str) -> SkinStepper:
        """See ExplicitLayer."""
        system, solid = self.layer.system, self.solid
        face, nodes = solid.nodes[: solid.surface_nodes], system.mesh.nodes[: system.mesh.surface_nodes]
        transfer = self.layer.with_keys(lambda: FaceTransfer(system, face, element_weights(solid, nodes)))
        estimate = functools.partial(self._error, device)
        stepper = self.layer.with_keys(
            lambda: SpectralElementStepper(solid, self.body, transfer, self.layer.step_s, device, estimate)
        )
        _check_steps(self.layer, stepper.steps)
        return stepper

    def _error(self, device: str) -> float:
        """What `palmfield.skin.solve` states for these elements under the trial load, and the bulk modulus's share."""
        solid, chosen = self.solid, self.chosen
        areas = np.linalg.norm(face_areas(solid), axis=1)
        load, times, at = _trial(self.layer, self.body, solid.nodes[: solid.surface_nodes], areas)
        motion = solve_spectral_elements(
            self.body, load, times, at, accuracy=self.layer.config.accuracy, device=device, order=chosen.order,
            size_m=chosen.size_m, deep=chosen.deep, nu_at_most=0.5,
        )  # fmt: skip
        return motion.error + self._reduced[1]


class ParticleLayer:
    """Particles, a preview; see ExplicitLayer."""

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
        return particle_state_size(self.cloud)

    @property
    def resolution(self) -> str:
        """See ExplicitLayer."""
        return f"{len(self.cloud.points)} particles {1e3 * self.cloud.columns.spacing_m:.2g} mm apart"

    @property
    def expected_error(self) -> float:
        """See ExplicitLayer: what particles at this distance had on discs."""
        return law_error(self.body, planned_load(self.layer), self.cloud.columns.spacing_m)

    def seconds(self, duration_s: float, device: str) -> float:
        """See ExplicitLayer."""
        # A disc's own error takes two runs more
        more = 2.0 * _trial_s(self.layer) if isinstance(self.body, Slab) else 0.0
        each = len(self.cloud.points) * SECONDS_A_STEP["cpu" if device == "cpu" else "cuda"]
        return (duration_s + more) / likely_particle_step(self.cloud) * each

    def stepper(self, device: str) -> SkinStepper:
        """See ExplicitLayer."""
        system, cloud = self.layer.system, self.cloud
        nodes = system.mesh.nodes[: system.mesh.surface_nodes]
        transfer = self.layer.with_keys(
            lambda: FaceTransfer(system, cloud.columns.face, particle_weights(cloud, nodes))
        )
        stepper = ParticleStepper(cloud, transfer, self.layer.step_s, device, functools.partial(self._error, device))
        _check_steps(self.layer, stepper.steps)
        return stepper

    def _error(self, device: str) -> float:
        """What `palmfield.skin.solve` states for particles so far apart under the trial load."""
        body, face = self.body, self.cloud.columns.face
        if isinstance(body, Layer):
            return self.expected_error
        load, times, at = _trial(self.layer, body, face, np.linalg.norm(self.cloud.face_area, axis=1))
        motion = solve_particles(body, load, times, at, device=device, spacing_m=self.spacing_m)
        return max(motion.error, self.expected_error)
