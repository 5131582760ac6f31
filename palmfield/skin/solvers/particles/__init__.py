"""Total-Lagrangian particles: large deformation, and quick previews at a stated error."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from palmfield.skin.solvers.particles.resolution import cost_particles, refusal_particles
    from palmfield.skin.solvers.particles.solve import solve_particles

_WHERE = {
    **dict.fromkeys(("cost_particles", "refusal_particles"), "resolution"),
    "solve_particles": "solve",
}
__all__ = ["cost_particles", "refusal_particles", "solve_particles"]


def __getattr__(name: str) -> Any:
    # Loaded when asked for: Warp and SciPy take half a second.
    if name not in _WHERE:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    return getattr(import_module(f"{__name__}.{_WHERE[name]}"), name)


def __dir__() -> list[str]:
    return __all__
