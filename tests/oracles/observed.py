"""What a preset's material gives where its measurements were made."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from palmfield.skin.analytic.layer_oracle import centre_response
from palmfield.skin.materials.catalogue import GEL_STORAGE_PA, MANFREDI, MIZUSHIMA, ZHANG
from palmfield.skin.materials.dispersion import describe
from palmfield.skin.materials.material import Material, complex_shear
from palmfield.skin.materials.ranges import Preset

Quantity = Literal["surface speed", "shear speed", "decay", "storage in compression"]
UNITS: dict[str, str] = {"surface speed": "m/s", "shear speed": "m/s", "decay": "1", "storage in compression": "Pa"}


@dataclass(frozen=True)
class Observation:
    """A measurement with which a material can be compared.

    quantity: "surface speed" [m/s]: phase speed of the Rayleigh wave; "shear speed" [m/s]; "decay": |u(40 mm)| /
        |u(5 mm)| from a Gaussian spot of 10 mm full width on a layer of depth depth_m, bonded to bone; "storage in
        compression" [Pa]: 3 G' of a bar with free sides.
    f_Hz: frequency [Hz]. value: in UNITS[quantity]. spread: standard deviation or half the range, None if unknown.
    """

    quantity: Quantity
    f_Hz: float
    value: float
    spread: float | None
    source: str
    depth_m: float = 0.0


READING = f"read by this project from a curve that rises to a plateau near 7 m/s ({MANFREDI}); not tabulated there"
POWER_LAW = f"finger; amplitude proportional to distance to the power -1.1 to -1.3 ({MANFREDI}, exponents of fig. 3)"
SITE_SPEEDS = tuple(
    Observation("surface speed", f, speed, None, READING)
    for f, speed in ((50.0, 3.6), (100.0, 4.6), (200.0, 6.0), (400.0, 7.1))
)
SITE_DECAY = Observation("decay", 200.0, 0.085, 0.017, POWER_LAW, depth_m=0.012)
OBSERVATIONS: dict[str, tuple[Observation, ...]] = {
    "gelatin_2": (Observation("shear speed", 200.0, 5.0, None, "Reardon et al. 2023, of their simulated tissue"),),
    **{
        name: (
            Observation(
                "storage in compression", 10.0, storage_Pa, None, f"{MIZUSHIMA}, assuming free lateral expansion"
            ),
        )
        for name, storage_Pa in GEL_STORAGE_PA.items()
    },
    "finger_pad": (*SITE_SPEEDS, SITE_DECAY),
    "palm": (*SITE_SPEEDS, SITE_DECAY),
    "forearm": (Observation("surface speed", 200.0, 3.25, 0.19, f"forearm of a volunteer, {ZHANG}"),),
}
"""Measurements by preset; the others have none."""


def observations(entry: Preset) -> tuple[Observation, ...]:
    """The measurements of a preset."""
    return OBSERVATIONS.get(entry.material.name, ())


def predicted(material: Material, observation: Observation) -> float:
    """What the material gives where the observation was made, in the observation's unit."""
    f = observation.f_Hz
    if observation.quantity == "surface speed":
        return describe(material, f).rayleigh_speed_m_s
    if observation.quantity == "shear speed":
        return describe(material, f).shear_speed_m_s
    if observation.quantity == "storage in compression":
        return 3.0 * complex_shear(material, f).real
    near, far = np.abs(centre_response(f, material, observation.depth_m, 0.010, at=np.array([0.005, 0.040])))
    return float(far / near)


def misfits(entry: Preset) -> list[float]:
    """predicted / value - 1 of each observation of a preset."""
    return [predicted(entry.material, seen) / seen.value - 1.0 for seen in observations(entry)]
