"""Small models of a body: a Krylov space grown until they are right, exact in time."""

from typing import TYPE_CHECKING

from palmfield.lazy_names import lazy_names

if TYPE_CHECKING:
    from palmfield.skin.reduction.dynamic_stiffness import DynamicStiffness
    from palmfield.skin.reduction.krylov import Course, Krylov, periodic
    from palmfield.skin.reduction.reduced import Projection, Reduced
    from palmfield.skin.reduction.reduced_stepper import KnownLoad, ReducedStepper
    from palmfield.skin.reduction.reducer import TooManyVectorsError, grow_until, reduce

_WHERE = {
    "DynamicStiffness": "dynamic_stiffness",
    **dict.fromkeys(("Course", "Krylov", "periodic"), "krylov"),
    **dict.fromkeys(("Projection", "Reduced"), "reduced"),
    **dict.fromkeys(("KnownLoad", "ReducedStepper"), "reduced_stepper"),
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
]
__getattr__, __dir__ = lazy_names(__name__, _WHERE)
