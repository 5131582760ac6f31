"""Exact answers and printed formulas: what solvers and presets are held against."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from palmfield.skin.analytic.layer_oracle import centre_response, centre_responses, layer_compliance
    from palmfield.skin.analytic.mach import mach_half_angle
    from palmfield.skin.analytic.observed import misfits, predicted

_WHERE = {
    **dict.fromkeys(("centre_response", "centre_responses", "layer_compliance"), "layer_oracle"),
    "mach_half_angle": "mach",
    **dict.fromkeys(("misfits", "predicted"), "observed"),
}
__all__ = ["centre_response", "centre_responses", "layer_compliance", "mach_half_angle", "misfits", "predicted"]


def __getattr__(name: str) -> Any:
    # Loaded when asked for: Warp and SciPy take half a second.
    if name not in _WHERE:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    return getattr(import_module(f"{__name__}.{_WHERE[name]}"), name)


def __dir__() -> list[str]:
    return __all__
