"""Slabs by lateral waves: modes in depth for each wavenumber, exact in time; the oracle of the other solvers."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from palmfield.skin.solvers.lateral_waves.build import refusal_lateral_waves
    from palmfield.skin.solvers.lateral_waves.cost import cost_lateral_waves
    from palmfield.skin.solvers.lateral_waves.solve import solve_lateral_waves, static_lateral_waves

_WHERE = {
    "refusal_lateral_waves": "build",
    "cost_lateral_waves": "cost",
    **dict.fromkeys(("solve_lateral_waves", "static_lateral_waves"), "solve"),
}
__all__ = ["cost_lateral_waves", "refusal_lateral_waves", "solve_lateral_waves", "static_lateral_waves"]


def __getattr__(name: str) -> Any:
    # Loaded when asked for: Warp and SciPy take half a second.
    if name not in _WHERE:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    return getattr(import_module(f"{__name__}.{_WHERE[name]}"), name)


def __dir__() -> list[str]:
    return __all__
