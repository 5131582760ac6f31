"""Total-Lagrangian particles: large deformation, and quick previews at a stated error."""

from palmfield.skin.solvers.particles.resolution import cost_particles, refusal_particles
from palmfield.skin.solvers.particles.solve import solve_particles

__all__ = ["cost_particles", "refusal_particles", "solve_particles"]
