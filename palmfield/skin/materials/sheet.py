"""A sub-layer of skin."""

import math
from dataclasses import dataclass

from palmfield.errors import SceneError
from palmfield.skin.materials.material import Material


@dataclass(frozen=True)
class Sheet:
    """A sub-layer: thickness_m [m], > 0, of one material."""

    material: Material
    thickness_m: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.thickness_m) and self.thickness_m > 0.0):
            raise SceneError(f"sheet of '{self.material.name}': thickness_m is {self.thickness_m}; give one above 0")
