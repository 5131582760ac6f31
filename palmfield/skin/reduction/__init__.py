"""Small models of a body: a Krylov space grown until they are right, exact in time."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from palmfield.skin.reduction.dynamic_stiffness import DynamicStiffness
    from palmfield.skin.reduction.krylov import Course, Krylov, periodic
    from palmfield.skin.reduction.reduced import Projection, Reduced
    from palmfield.skin.reduction.reduced_stepper import KnownLoad, ReducedStepper, reduced_stepper
    from palmfield.skin.reduction.reducer import TooManyVectorsError, grow_until, reduce

_WHERE = {
    "DynamicStiffness": "dynamic_stiffness",
    **dict.fromkeys(("Course", "Krylov", "periodic"), "krylov"),
    **dict.fromkeys(("Projection", "Reduced"), "reduced"),
    **dict.fromkeys(("KnownLoad", "ReducedStepper", "reduced_stepper"), "reduced_stepper"),
    **dict.fromkeys(("TooManyVectorsError", "grow_until", "reduce"), "reducer"),
}
__all__ = [
    "Course",
    "DynamicStiffness",
    "KnownLoad",
    "Krylov",
    "Projection",
    "Reduced",
    "ReducedStepper",
    "TooManyVectorsError",
    "grow_until",
    "periodic",
    "reduce",
    "reduced_stepper",
]


def __getattr__(name: str) -> Any:
    # Loaded when asked for: Warp and SciPy take half a second.
    if name not in _WHERE:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    return getattr(import_module(f"{__name__}.{_WHERE[name]}"), name)


def __dir__() -> list[str]:
    return __all__
