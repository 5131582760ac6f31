"""How far a run's numbers can be trusted: numerical errors, what was left out, what inputs leave open, what is felt.

`palmfield.run` is public there, a run with all that.
"""

from typing import TYPE_CHECKING

from palmfield.lazy_names import lazy_names

if TYPE_CHECKING:
    from palmfield.estimate.array_inputs import p0_band, p0_band_at
    from palmfield.estimate.numerical_error import error_estimate
    from palmfield.estimate.sensation_levels import felt_levels
    from palmfield.estimate.summary import array_numbers, scene_numbers, skin_numbers, stimulus_numbers

_WHERE = {
    **dict.fromkeys(("p0_band", "p0_band_at"), "array_inputs"),
    "error_estimate": "numerical_error",
    "felt_levels": "sensation_levels",
    **dict.fromkeys(("array_numbers", "scene_numbers", "skin_numbers", "stimulus_numbers"), "summary"),
}
__all__ = [
    "array_numbers",
    "error_estimate",
    "felt_levels",
    "p0_band",
    "p0_band_at",
    "scene_numbers",
    "skin_numbers",
    "stimulus_numbers",
]
__getattr__, __dir__ = lazy_names(__name__, _WHERE)
