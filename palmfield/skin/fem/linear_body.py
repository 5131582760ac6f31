"""A viscoelastic body for steppers and reductions: its matrices, from any assembly."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from palmfield.skin.materials.material import Material


@dataclass(frozen=True)
class Part:
    """Stiffness [N/m] for G_r that relaxes as the shear modulus of a material; symmetric, sparse or dense, (n, n)."""

    stiffness: Any
    material: Material


class LinearBody(Protocol):
    """Matrices of a body, symmetric, sparse or dense, (n, n): mass [kg], damping [N s/m], elastic and parts [N/m]."""

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
