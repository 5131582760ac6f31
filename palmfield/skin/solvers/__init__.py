"""The solvers behind `palmfield.skin.solve`, by their names there."""

from typing import TYPE_CHECKING

from palmfield.lazy_names import lazy_names

if TYPE_CHECKING:
    from palmfield.skin.solvers.axisymmetric.solve import solve_axisymmetric
    from palmfield.skin.solvers.lateral_waves.solve import solve_lateral_waves, static_lateral_waves
    from palmfield.skin.solvers.particles.solve import solve_particles
    from palmfield.skin.solvers.reduced import solve_reduced
    from palmfield.skin.solvers.spectral_elements.solve import solve_spectral_elements
    from palmfield.skin.solvers.wedges import solve_wedges, static_wedges

_WHERE = {
    "solve_axisymmetric": "axisymmetric.solve",
    **dict.fromkeys(("solve_lateral_waves", "static_lateral_waves"), "lateral_waves.solve"),
    "solve_particles": "particles.solve",
    "solve_reduced": "reduced",
    "solve_spectral_elements": "spectral_elements.solve",
    **dict.fromkeys(("solve_wedges", "static_wedges"), "wedges"),
}
__all__ = [
    "solve_axisymmetric",
    "solve_lateral_waves",
    "solve_particles",
    "solve_reduced",
    "solve_spectral_elements",
    "solve_wedges",
    "static_lateral_waves",
    "static_wedges",
]
__getattr__, __dir__ = lazy_names(__name__, _WHERE)
