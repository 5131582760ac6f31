"""Layered discs under a spot: elements in r and z, harmonics in the angle, small models in time."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from palmfield.skin.solvers.axisymmetric.solve import cost_axisymmetric, refusal_axisymmetric, solve_axisymmetric

_WHERE = {
    **dict.fromkeys(("cost_axisymmetric", "refusal_axisymmetric", "solve_axisymmetric"), "solve"),
}
__all__ = ["cost_axisymmetric", "refusal_axisymmetric", "solve_axisymmetric"]


def __getattr__(name: str) -> Any:
    # Loaded when asked for: Warp and SciPy take half a second.
    if name not in _WHERE:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    return getattr(import_module(f"{__name__}.{_WHERE[name]}"), name)


def __dir__() -> list[str]:
    return __all__
