"""Exact answers and printed formulas: what solvers and presets are held against."""

from typing import TYPE_CHECKING

from palmfield.lazy_names import lazy_names

if TYPE_CHECKING:
    from palmfield.skin.analytic.layer_oracle import centre_response, centre_responses, layer_compliance
    from palmfield.skin.analytic.mach import mach_half_angle

_WHERE = {
    **dict.fromkeys(("centre_response", "centre_responses", "layer_compliance"), "layer_oracle"),
    "mach_half_angle": "mach",
}
__all__ = ["centre_response", "centre_responses", "layer_compliance", "mach_half_angle"]
__getattr__, __dir__ = lazy_names(__name__, _WHERE)
