"""Spectral elements of a slab or layer, explicit in time: matrix-free, on the CPU or a GPU."""

from typing import TYPE_CHECKING

from palmfield.lazy_names import lazy_names

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
__getattr__, __dir__ = lazy_names(__name__, _WHERE)
