"""Test case for skin solvers of palmfield and of other programs, with its exact solution."""

from dataclasses import dataclass

from palmfield.skin.analytic.layer_oracle import centre_response
from palmfield.skin.materials.catalogue import preset
from palmfield.skin.materials.material import Material

F_Hz = 200.0


@dataclass(frozen=True)
class Case:
    """An infinite bonded slab under a round Gaussian spot. Each program chooses the width that it models.

    depth_m: thickness of the slab [m]
    fwhm_m: width of the spot [m]
    """

    material: Material
    depth_m: float
    fwhm_m: float

    def exact(self) -> tuple[float, complex]:
        """Return the displacement of the centre per peak pressure [m/Pa], static and at F_Hz, by waves in depth."""
        still, moving = (
            complex(centre_response(f, self.material, self.depth_m, self.fwhm_m).item()) for f in (0.0, F_Hz)
        )
        return still.real, moving


CASE = Case(preset("ecoflex_00-10"), 0.02, 0.0103)
