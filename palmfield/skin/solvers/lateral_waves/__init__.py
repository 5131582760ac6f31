"""Slabs by lateral waves: modes in depth for each wavenumber, exact in time; the oracle of the other solvers."""

from typing import TYPE_CHECKING

from palmfield.lazy_names import lazy_names

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
__getattr__, __dir__ = lazy_names(__name__, _WHERE)
