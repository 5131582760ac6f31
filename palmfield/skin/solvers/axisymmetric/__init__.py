"""Layered discs under a spot: elements in r and z, harmonics in the angle, small models in time."""

from typing import TYPE_CHECKING

from palmfield.lazy_names import lazy_names

if TYPE_CHECKING:
    from palmfield.skin.solvers.axisymmetric.solve import cost_axisymmetric, refusal_axisymmetric, solve_axisymmetric

_WHERE = {
    **dict.fromkeys(("cost_axisymmetric", "refusal_axisymmetric", "solve_axisymmetric"), "solve"),
}
__all__ = ["cost_axisymmetric", "refusal_axisymmetric", "solve_axisymmetric"]
__getattr__, __dir__ = lazy_names(__name__, _WHERE)
