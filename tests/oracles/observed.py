"""What a preset's material gives where its measurements were made."""

import numpy as np

from palmfield.skin.analytic.layer_oracle import centre_response
from palmfield.skin.materials.dispersion import describe
from palmfield.skin.materials.material import Material, complex_shear
from palmfield.skin.materials.ranges import Observation, Preset


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
    return [predicted(entry.material, seen) / seen.value - 1.0 for seen in entry.observations]
