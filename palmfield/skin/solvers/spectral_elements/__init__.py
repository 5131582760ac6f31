"""Spectral elements of a slab or layer, explicit in time: matrix-free, on the CPU or a GPU."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from palmfield.skin.solvers.spectral_elements.solve import (
        cost_spectral_elements,
        refusal_spectral_elements,
        solve_spectral_elements,
    )

_WHERE = {
    **dict.fromkeys(("cost_spectral_elements", "refusal_spectral_elements", "solve_spectral_elements"), "solve"),
}
__all__ = ["cost_spectral_elements", "refusal_spectral_elements", "solve_spectral_elements"]


def __getattr__(name: str) -> Any:
    # Loaded when asked for: Warp and SciPy take half a second.
    if name not in _WHERE:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    return getattr(import_module(f"{__name__}.{_WHERE[name]}"), name)


def __dir__() -> list[str]:
    return __all__
