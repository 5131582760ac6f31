"""Base and sides of a skin layer."""

import math
from dataclasses import dataclass
from typing import Literal

from palmfield.errors import SceneError
from palmfield.skin.materials.material import Sheet

BaseKind = Literal["bonded", "free_slip", "free"]
SideKind = Literal["fixed", "free", "roller", "absorbing"]
BASES = ("bonded", "free_slip", "free")
SIDES = ("fixed", "free", "roller", "absorbing")
NEEDS_AXIS = "roller sides need a patch with an axis, which this patch lacks: use side 'fixed' or 'free'"


@dataclass(frozen=True)
class Springs:
    """A base of springs and dashpots per area, along the normal and tangential.

    normal_Pa_m, tangential_Pa_m: stiffness [Pa/m]. normal_Pa_s_m, tangential_Pa_s_m: damping [Pa s/m]; all >= 0.
    """

    normal_Pa_m: float
    tangential_Pa_m: float
    normal_Pa_s_m: float = 0.0
    tangential_Pa_s_m: float = 0.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (math.isfinite(value) and value >= 0.0):
                raise SceneError(f"base springs: {name} is {value}; give a finite number, 0 or above")


@dataclass(frozen=True)
class Foundation:
    """Sheets below a meshed layer, the first right below it, without a mesh of their own
    (palmfield.skin.fem.foundation).

    base: below the lowest sheet; degree: degree of the polynomial in depth of each sheet, 1 or more; or 0: linear, with
        one point of integration
    walled: whether the sheets are part of a half space: they are fixed below free sides of the layer, and absorbing
        sides of both get springs, since a column without sides would sink
    frequencies_Hz, misfit: where it was fitted [Hz], and the relative error there, see fit_foundation; both (f,)
    Raises SceneError for another base or degree.
    """

    sheets: tuple[Sheet, ...]
    base: BaseKind | Springs = "bonded"
    degree: int = 4
    walled: bool = False
    frequencies_Hz: tuple[float, ...] = ()
    misfit: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        check_base_and_side(self.base, None, none=True)
        if self.degree < 0:
            raise SceneError(f"foundation: degree is {self.degree}; give 0 or more")

    @property
    def levels(self) -> int:
        """Return the number of levels of nodes below the mesh."""
        return max(self.degree, 1) * len(self.sheets)


Base = BaseKind | Springs | Foundation


def check_base_and_side(base: Base, side: SideKind | None, none: bool) -> None:
    if not isinstance(base, Springs | Foundation) and base not in BASES:
        raise SceneError(f"base is '{base}'; use one of {', '.join(BASES)}, Springs or a Foundation")
    if none:
        if side is not None:
            raise SceneError(f"side is '{side}', but an infinite slab has no sides: omit it")
    elif side not in SIDES:
        raise SceneError(f"side is '{side}'; use one of {', '.join(SIDES)}")
