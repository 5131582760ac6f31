"""Slabs by lateral waves: modes in depth for each wavenumber, exact in time; the oracle of the other solvers."""

from palmfield.skin.spectral.build import refusal_spectral
from palmfield.skin.spectral.cost import cost_spectral
from palmfield.skin.spectral.solve import solve_spectral, static_spectral

__all__ = ["cost_spectral", "refusal_spectral", "solve_spectral", "static_spectral"]
