"""What may be left out or made coarser, and the error that it costs."""

from typing import TYPE_CHECKING

from palmfield.lazy_names import lazy_names

if TYPE_CHECKING:
    from palmfield.skin.approximation.estimate import choose_sizes, largest_change
    from palmfield.skin.approximation.load_scales import course_frequency, load_centre, load_frequency, load_width
    from palmfield.skin.approximation.reduce_bulk_modulus import relative_change
    from palmfield.skin.approximation.refine import (
        ConvergedSolution,
        Discretisation,
        MeshSolution,
        refine_in_depth,
        refine_until_converged,
    )
    from palmfield.skin.approximation.richardson import error_of_coarser, error_of_finer, relative_difference
    from palmfield.skin.approximation.trim_absorbing_rim import refusal_of_spot
    from palmfield.skin.approximation.truncate_domain import part_of, reach

_WHERE = {
    **dict.fromkeys(("choose_sizes", "largest_change"), "estimate"),
    **dict.fromkeys(("course_frequency", "load_centre", "load_frequency", "load_width"), "load_scales"),
    "relative_change": "reduce_bulk_modulus",
    **dict.fromkeys(
        ("ConvergedSolution", "Discretisation", "MeshSolution", "refine_in_depth", "refine_until_converged"), "refine"
    ),
    **dict.fromkeys(("error_of_coarser", "error_of_finer", "relative_difference"), "richardson"),
    "refusal_of_spot": "trim_absorbing_rim",
    **dict.fromkeys(("part_of", "reach"), "truncate_domain"),
}
__all__ = [
    "ConvergedSolution",
    "Discretisation",
    "MeshSolution",
    "choose_sizes",
    "course_frequency",
    "error_of_coarser",
    "error_of_finer",
    "largest_change",
    "load_centre",
    "load_frequency",
    "load_width",
    "part_of",
    "reach",
    "refine_in_depth",
    "refine_until_converged",
    "refusal_of_spot",
    "relative_change",
    "relative_difference",
]
__getattr__, __dir__ = lazy_names(__name__, _WHERE)
