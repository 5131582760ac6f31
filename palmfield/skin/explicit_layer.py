"""Interface between the layer of a scene and its solver. Other code uses this interface, not the name of the solver.

Wedges, modes and reduced models use the mesh of the scene. Spectral elements, particles and the solvers of other
packages use their own mesh below the same face. Body, loads and operators are always those of the wedges.
"""

import functools
import math
from importlib.metadata import EntryPoint, entry_points
from typing import Protocol

from palmfield.config.skin import SKIN_SOLVERS
from palmfield.errors import SceneError
from palmfield.skin.scene_layer import SceneLayer
from palmfield.skin.stepper import SkinStepper

OWN = {
    name: EntryPoint(name, f"palmfield.skin.{where}", SKIN_SOLVERS)
    for name, where in {
        "wedges": "explicit_layer:WedgeLayer",
        "reduced": "explicit_layer:ReducedLayer",
        "modal": "explicit_layer:ModalLayer",
        "spectral_elements": "solvers.spectral_elements.stepper:ElementLayer",
        "particles": "solvers.particles.stepper:ParticleLayer",
    }.items()
}
"""Solvers of this package that step scenes, loaded at first use."""


class LayerSolver(Protocol):
    """Solver of the layer of a scene before its stepper is made; costly parts are made at first use.

    any_pose, of_class, exact_in_time, factorises: as in SkinStepper, available without loading the stepper.
    own_mesh: whether the solver has another mesh than the wedges, so that its stepper needs only the layer.
    large_strain: whether it is valid beyond linear elasticity. preview: whether it is a preview.
    unknowns: number of unknowns of its mesh. state_size: upper bound of the size of its state.
    expected_error: relative error of the displacement, estimated before any run, or None.
    resolution, steps, sizes_follow: resolution, time steps and basis of the sizes, in words.
    """

    any_pose: bool = True
    of_class: bool = False
    exact_in_time: bool = False
    factorises: bool = False
    own_mesh: bool = False
    large_strain: bool = False
    preview: bool = False
    steps: str
    sizes_follow: str

    def __init__(self, layer: SceneLayer) -> None: ...
    @property
    def unknowns(self) -> int: ...
    @property
    def state_size(self) -> int: ...
    @property
    def resolution(self) -> str:
        return "the scene's wedges"

    @property
    def expected_error(self) -> float | None:
        return None

    def refuse(self) -> None:
        """Raise SceneError, with value and allowed values, for a layer that the solver cannot step.

        The scene adds the element and its key `solver`. Only keys and materials are checked; no mesh is made.
        """

    def seconds(self, duration_s: float, device: str) -> float:
        """Return the predicted time [s] of a run of this length [s] on a device, with its error estimate.

        It is infinite if it depends on the load (see `palmfield.skin.stepper_choice`)."""
        return math.inf

    def stepper(self, device: str) -> SkinStepper | None:
        """Return the stepper on a device from `palmfield.device.resolve`; None if it needs more than the layer.

        Raises SceneError for impossible elements.
        """
        return None


class WedgeLayer(LayerSolver):
    """All unknowns of the wedges."""

    factorises = True
    steps = "full wedge model, implicit, factorised once"
    sizes_follow = "sizes follow a convergence study on a disc (docs/bench/skin_c0.md); the run estimates the error"

    def __init__(self, layer: SceneLayer) -> None:
        self.layer = layer

    @property
    def unknowns(self) -> int:
        return self.layer.dofs

    @property
    def state_size(self) -> int:
        """See LayerSolver. It is the size for the whole layer, because a run may change to it."""
        return self.layer.state_room


class ModalLayer(WedgeLayer):
    """Modes of the wedges."""

    of_class, factorises = True, False
    steps = "modes for every sound of these arrays on this region, built once"


class ReducedLayer(WedgeLayer):
    """A reduced model of the wedges."""

    any_pose, exact_in_time, factorises = False, True, False
    steps = "reduced model for this stimulus"


class ExplicitLayer(LayerSolver, Protocol):
    """Layer of a solver with its own mesh; it needs only the SceneLayer."""

    own_mesh: bool = True
    steps: str = "steps of the solver"
    sizes_follow: str = "the solver chooses its own sizes; the run estimates the error"

    @property
    def resolution(self) -> str: ...
    def seconds(self, duration_s: float, device: str) -> float: ...
    def stepper(self, device: str) -> SkinStepper: ...


@functools.lru_cache
def solver_class(name: str) -> type[LayerSolver]:
    """Return the solver class of this name. Raises SceneError if it cannot be loaded."""
    [entry] = [OWN[name]] if name in OWN else entry_points(group=SKIN_SOLVERS, name=name)
    try:
        solver: type[LayerSolver] = entry.load()
        return solver
    except (ImportError, AttributeError) as error:
        raise SceneError(
            f"the entry point '{entry.value}' of the solver cannot be loaded: {error}; reinstall it, or set solver "
            "to auto",
            setting="solver",
        ) from error


def layer_solver(layer: SceneLayer, name: str) -> LayerSolver:
    """Return the solver of a layer. A solver with its own mesh is made once for each layer."""
    made = solver_class(name)
    return _cached(made, layer) if made.own_mesh else made(layer)


@functools.lru_cache(maxsize=8)
def _cached(made: type[LayerSolver], layer: SceneLayer) -> LayerSolver:
    return made(layer)
