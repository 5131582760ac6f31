"""A viscoelastic body for steppers and reductions: its matrices, from any assembly."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from palmfield.skin.materials.material import Material


@dataclass(frozen=True)
class Part:
    """Stiffness [N/m] of G_r, symmetric, sparse or dense, shape (n, n), that relaxes as the shear modulus of a
    material.
    """

    stiffness: Any
    material: Material


class LinearBody(Protocol):
    """mass [kg], damping [N s/m], elastic and parts' stiffness [N/m]: symmetric, sparse or dense, shape (n, n)."""

    @property
    def mass(self) -> Any: ...
    @property
    def damping(self) -> Any: ...
    @property
    def elastic(self) -> Any: ...
    @property
    def parts(self) -> Sequence[Part]: ...


@dataclass(frozen=True)
class Matrices:
    """The matrices of a LinearBody without further data."""

    mass: Any
    damping: Any
    elastic: Any
    parts: Sequence[Part]
