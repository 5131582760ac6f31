"""Slabs by lateral waves: modes in depth for each wavenumber, exact in time; the oracle of the other solvers."""

from palmfield.skin.solvers.lateral_waves.build import refusal_lateral_waves
from palmfield.skin.solvers.lateral_waves.cost import cost_lateral_waves
from palmfield.skin.solvers.lateral_waves.solve import solve_lateral_waves, static_lateral_waves

__all__ = ["cost_lateral_waves", "refusal_lateral_waves", "solve_lateral_waves", "static_lateral_waves"]
