"""Slabs by lateral waves: modes in depth for each wavenumber, exact in time; the oracle of the other solvers."""

from palmfield.skin.solvers.lateral_waves.build import refusal_spectral
from palmfield.skin.solvers.lateral_waves.cost import cost_spectral
from palmfield.skin.solvers.lateral_waves.solve import solve_spectral, static_spectral

__all__ = ["cost_spectral", "refusal_spectral", "solve_spectral", "static_spectral"]
