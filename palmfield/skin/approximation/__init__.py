"""What may be left out or made coarser, and the error that it costs."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from palmfield.skin.approximation.estimate import choose_sizes, mesh_error
    from palmfield.skin.approximation.load_scales import course_frequency, load_centre, load_frequency, load_width
    from palmfield.skin.approximation.reduce_bulk_modulus import reduce_bulk_modulus, relative_change
    from palmfield.skin.approximation.refine import (
        ConvergedSolution,
        Discretisation,
        MeshSolution,
        refine_in_depth,
        refine_until_converged,
    )
    from palmfield.skin.approximation.richardson import error_of_coarser, error_of_finer, relative_difference
    from palmfield.skin.approximation.trim_absorbing_rim import trim_absorbing_rim
    from palmfield.skin.approximation.truncate_domain import truncate_domain

_WHERE = {
    **dict.fromkeys(("choose_sizes", "mesh_error"), "estimate"),
    **dict.fromkeys(("course_frequency", "load_centre", "load_frequency", "load_width"), "load_scales"),
    **dict.fromkeys(("reduce_bulk_modulus", "relative_change"), "reduce_bulk_modulus"),
    **dict.fromkeys(
        ("ConvergedSolution", "Discretisation", "MeshSolution", "refine_in_depth", "refine_until_converged"), "refine"
    ),
    **dict.fromkeys(("error_of_coarser", "error_of_finer", "relative_difference"), "richardson"),
    "trim_absorbing_rim": "trim_absorbing_rim",
    "truncate_domain": "truncate_domain",
}
__all__ = [
    "ConvergedSolution",
    "Discretisation",
    "MeshSolution",
    "choose_sizes",
    "course_frequency",
    "error_of_coarser",
    "error_of_finer",
    "load_centre",
    "load_frequency",
    "load_width",
    "mesh_error",
    "reduce_bulk_modulus",
    "refine_in_depth",
    "refine_until_converged",
    "relative_change",
    "relative_difference",
    "trim_absorbing_rim",
    "truncate_domain",
]


def __getattr__(name: str) -> Any:
    # Loaded when asked for: Warp and SciPy take half a second.
    if name not in _WHERE:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    return getattr(import_module(f"{__name__}.{_WHERE[name]}"), name)


def __dir__() -> list[str]:
    return __all__
