"""The case on which skin solvers and other programs are held side by side, and what is known of its answer."""

from dataclasses import dataclass

import numpy as np

from palmfield.skin.analytic.layer_oracle import centre_response
from palmfield.skin.materials.catalogue import preset
from palmfield.skin.materials.material import Material, complex_bulk, complex_shear
from palmfield.skin.problem import GAUSSIAN

F_Hz = 200.0


@dataclass(frozen=True)
class Case:
    """An endless bonded slab under a round Gaussian spot; every program takes a piece of it as wide as it likes.

    depth_m, fwhm_m: thickness of the slab and width of the spot [m]
    """

    material: Material
    depth_m: float
    fwhm_m: float

    def moduli(self, f_Hz: float) -> tuple[complex, complex]:
        """Shear and bulk modulus [Pa] under e^{-i w t}."""
        return complex_shear(self.material, f_Hz), complex_bulk(self.material, f_Hz)

    def exact(self) -> tuple[float, complex]:
        """Push of the centre per pascal of peak pressure [m/Pa], static and at F_Hz, by plane waves in depth."""
        still, moving = (
            complex(centre_response(f, self.material, self.depth_m, self.fwhm_m).item()) for f in (0.0, F_Hz)
        )
        return still.real, moving


CASE = Case(preset("ecoflex_00-10"), 0.02, 0.0103)


def graded(half_m: float, cells: int, depth_m: float, layers: int) -> tuple[list[float], list[float]]:
    """Coordinates [m] of a graded quarter box: from the spot's centre outwards, and from the base up to the face at 0.

    Cells grow in geometric series, to eight times along the face and to three times through the depth.
    """

    def series(length: float, count: int, growth: float) -> list[float]:
        ratio = growth ** (1.0 / max(count - 1, 1))
        edges = np.concatenate([[0.0], np.cumsum(ratio ** np.arange(count))])
        return (length * edges / edges[-1]).tolist()

    along = series(half_m, cells, 8.0)
    down = [-z for z in series(depth_m, layers, 3.0)][::-1]
    return along, down


def pressure(case: Case, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The spot of 1 Pa, centred on the z axis."""
    return np.exp(-GAUSSIAN * (x**2 + y**2) / case.fwhm_m**2)
