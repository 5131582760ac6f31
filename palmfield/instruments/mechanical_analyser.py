"""Dynamic mechanical analyser: a disc between two plates is compressed, and its modulus is measured.

If the faces are bonded to the plates, a disc is stiffer than its material. The reading is an apparent modulus. It
depends on the shape factor S, loaded area over free area: a/(2 h) for radius a and height h.
"""

from typing import ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field
from scipy.special import ive

from palmfield.config.base import Positive
from palmfield.errors import MeasurementError
from palmfield.instruments.settings import Settings
from palmfield.skin.materials.material import Material, complex_bulk, complex_shear
from palmfield.types import Complex


class Analyser(Settings):
    """A compression test. Raises MeasurementError for values outside their limits."""

    instrument: ClassVar[str] = "analyser"
    radius_m: Positive = Field(default=0.004, description="of the disc")
    height_m: Positive = Field(default=0.002, description="of the disc")
    faces: Literal["bonded", "frictionless"] = Field(default="bonded", description="contact between plates and disc")

    @property
    def shape_factor(self) -> float:
        """Loaded area over free area of the side."""
        return self.radius_m / (2.0 * self.height_m)


def apparent_modulus(shear_Pa: ArrayLike, bulk_Pa: ArrayLike, settings: Analyser) -> Complex:
    """Return mean pressure over mean strain of a disc [Pa], for complex moduli G and K in any convention, shape (...,).

    Frictionless faces: Young's modulus, 9 K G / (3 K + G). Bonded faces: E plus the stiffness of the pressure in the
    disc, p'' + p'/r = q^2 (p - K strain), q^2 = 12 G/(K h^2), with p = 0 at the side: E + K I2(q a)/I0(q a) (Chalhoub &
    Kelly 1990, Int. J. Solids Struct. 26, 743; for infinite K E (1 + 2 S^2), Gent & Lindley 1959, Proc. Inst. Mech.
    Eng. 173, 111). The sides bulge as parabolas. The limit of thin discs is K + 4G/3, the uniaxial strain modulus.
    Inertia is neglected, which requires shear waves longer than the height of the disc.
    """
    shear, bulk = np.asarray(shear_Pa, dtype=complex), np.asarray(bulk_Pa, dtype=complex)
    if not (
        np.isfinite(shear).all() and np.isfinite(bulk).all() and (shear.real > 0.0).all() and (bulk.real > 0).all()
    ):
        raise MeasurementError("moduli must be finite with real parts above 0")
    young = 9.0 * bulk * shear / (3.0 * bulk + shear)
    if settings.faces == "frictionless":
        return np.asarray(young)
    argument = np.sqrt(12.0 * shear / bulk) * settings.radius_m / settings.height_m
    # Scaled Bessel functions, because arguments are in the thousands for thin discs with a small K
    pressed = bulk * ive(2, argument) / ive(0, argument)
    # In a thin disc the pressure contributes K, and the deviator 4G/3 in place of E
    wide = bulk + 4.0 / 3.0 * shear
    return np.asarray(young + pressed * (wide - young) / bulk)


def analyser_reading(material: Material, frequency_Hz: ArrayLike, settings: Analyser) -> Complex:
    """Return the reading for a material [Pa], E' - iE'', e^{-i w t}, in the shape of frequency_Hz.

    Raises MeasurementError for frequencies that are below 0 or not finite.
    """
    frequencies = np.asarray(frequency_Hz, dtype=float)
    if not np.isfinite(frequencies).all() or (frequencies < 0.0).any():
        raise MeasurementError("frequencies of an analyser must be finite, 0 or above")
    flat = frequencies.ravel()
    shear = np.array([complex_shear(material, float(f)) for f in flat])
    bulk = np.array([complex_bulk(material, float(f)) for f in flat])
    return apparent_modulus(shear, bulk, settings).reshape(frequencies.shape)


def shear_from_reading(apparent_Pa: ArrayLike, bulk_Pa: float, settings: Analyser) -> Complex:
    """Return the shear modulus for a reading and a bulk modulus [Pa], in the shape of apparent_Pa.

    Newton's method starts from an incompressible disc. Raises MeasurementError if it does not converge, for example for
    a modulus above the bulk modulus.
    """
    shown = np.asarray(apparent_Pa, dtype=complex)
    factor = 1.0 if settings.faces == "frictionless" else 1.0 + 2.0 * settings.shape_factor**2
    shear = shown / (3.0 * factor)
    for _ in range(60):
        if not (np.isfinite(shear).all() and (shear.real > 0.0).all()):
            break
        bulk = np.full(shear.shape, bulk_Pa)
        value = apparent_modulus(shear, bulk, settings)
        slope = (apparent_modulus(shear * (1.0 + 1e-6), bulk, settings) - value) / (1e-6 * shear)
        step = (value - shown) / slope
        shear = shear - step
        if np.abs(step).max() < 1e-10 * np.abs(shear).max():
            return np.asarray(shear)
    raise MeasurementError(
        f"no shear modulus gives an apparent modulus of {shown.ravel()[0]:g} Pa for a disc with S = "
        f"{settings.shape_factor:.3g} and K = {bulk_Pa:g} Pa"
    )
