"""Interface of a viscoelastic body for steppers and reductions: its matrices, from any assembly."""

from collections.abc import Sequence
from typing import Any, Protocol

from palmfield.skin.materials.material import Material


class RelaxingPart(Protocol):
    @property
    def stiffness(self) -> Any: ...
    @property
    def material(self) -> Material: ...


class LinearBody(Protocol):
    """mass [kg], damping [N s/m], elastic and parts' stiffness [N/m]: symmetric, sparse or dense, shape (n, n)."""

    @property
    def mass(self) -> Any: ...
    @property
    def damping(self) -> Any: ...
    @property
    def elastic(self) -> Any: ...
    @property
    def parts(self) -> Sequence[RelaxingPart]: ...
