"""Total-Lagrangian particles: large deformation, and quick previews at a stated error."""

from typing import TYPE_CHECKING

from palmfield.lazy_names import lazy_names

if TYPE_CHECKING:
    from palmfield.skin.solvers.particles.resolution import cost_particles, refusal_particles
    from palmfield.skin.solvers.particles.solve import solve_particles

_WHERE = {
    **dict.fromkeys(("cost_particles", "refusal_particles"), "resolution"),
    "solve_particles": "solve",
}
__all__ = ["cost_particles", "refusal_particles", "solve_particles"]
__getattr__, __dir__ = lazy_names(__name__, _WHERE)
