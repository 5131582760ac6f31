"""A scene's layer for solvers that key `solver` names and that have their own mesh: explicit elements or particles,
and those of other packages. The scene has no other reference to them.
"""

import functools
from importlib.metadata import EntryPoint, entry_points
from typing import Protocol, get_args

from palmfield.config.skin import SKIN_SOLVERS, Solver
from palmfield.errors import SceneError
from palmfield.skin.scene_layer import SceneLayer
from palmfield.skin.stepper import SkinStepper

OWN = {
    name: EntryPoint(name, f"palmfield.skin.solvers.{where}", SKIN_SOLVERS)
    for name, where in {
        "spectral_elements": "spectral_elements.stepper:ElementLayer",
        "particles": "particles.stepper:ParticleLayer",
    }.items()
}
"""Solvers of this package that have an ExplicitLayer, loaded when a scene names them."""


class ExplicitLayer(Protocol):
    """Properties of a solver's layer before stepping; made of the SceneLayer alone, costly parts at first use.

    unknowns: of its mesh. state_size: numbers of its state. resolution: in words.
    expected_error: relative, of the displacement, before any run, or None.
    preview: whether it is one. steps, sizes_follow: its time steps, and the basis of its sizes, in words.
    """

    preview: bool = False
    steps: str = "steps of its own"
    sizes_follow: str = "the solver chooses its own sizes; the run estimates the error"

    @property
    def unknowns(self) -> int: ...
    @property
    def state_size(self) -> int: ...
    @property
    def resolution(self) -> str: ...
    @property
    def expected_error(self) -> float | None:
        return None

    def refuse(self) -> None:
        """Raise SceneError, with element, key, value and what is allowed, for what the solver can't step.

        Checks only keys and materials: no mesh is made.
        """
        ...

    def seconds(self, duration_s: float, device: str) -> float:
        """Predicted time of a run of this length [s] on a device, with what estimates the error [s]."""
        ...

    def stepper(self, device: str) -> SkinStepper:
        """The stepper on a device of `palmfield.device.resolve`. Raises SceneError for impossible elements."""
        ...


def explicit_layer(layer: SceneLayer) -> ExplicitLayer | None:
    """The layer as its key `solver` has it, the same for the same layer; None for steppers of the wedges themselves."""
    solver = layer.config.solver
    return None if solver in get_args(Solver) and solver not in OWN else _made(layer)


@functools.lru_cache(maxsize=8)
def _made(layer: SceneLayer) -> ExplicitLayer:
    solver = layer.config.solver
    [entry] = [OWN[solver]] if solver in OWN else entry_points(group=SKIN_SOLVERS, name=solver)
    try:
        made: ExplicitLayer = entry.load()(layer)
        return made
    except (ImportError, AttributeError) as error:
        raise SceneError(
            f"{layer.element}: key 'solver' has value '{solver}', whose entry point '{entry.value}' cannot be "
            f"loaded: {error}; reinstall it, or set solver to auto"
        ) from error
