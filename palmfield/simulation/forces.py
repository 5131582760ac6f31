"""The force of the sound on the bodies that carry skin."""

import numpy as np

from palmfield.acoustics.surface_load import Parts, pushes, resultants
from palmfield.simulation.posed_scene import PosedScene
from palmfield.simulation.radiation import Radiation
from palmfield.types import Float, Float32


def body_force(radiation: Radiation, posed: PosedScene, body: int, arp: Float | Float32) -> Float:
    """Return forces [N] on the parts of a body and torques about their origins [N m], world axes, shape (2, b, 3).

    radiation: keeps the effect of a unit pressure in the last pose. arp: at the samples of the body [Pa], shape (n,)
    """
    surface = posed.bodies[body]
    key = posed.arrays.serial, surface.serial
    of_unit, parts = radiation.kept.of(("push", body), key, _of_unit_pressure, radiation, posed, body)
    return np.array(resultants(arp, of_unit, surface.origins, parts)) @ posed.array_frame.rotation.T


def _of_unit_pressure(radiation: Radiation, posed: PosedScene, body: int) -> tuple[Float, Parts]:
    """Return the effect of a unit pressure on each sample of a body, see `pushes`, and the parts of the samples."""
    points, normals, areas, numbers = radiation.samples(posed, radiation.model.first_skins[body])
    surface = posed.bodies[body]
    return pushes(areas, normals, points), Parts(surface.sample_parts[numbers], len(surface.origins))
