"""Readings of a sensor on the skin. To add a channel, add an entry to CHANNELS."""

from collections.abc import Callable
from operator import attrgetter
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from palmfield.errors import SceneError
from palmfield.simulation.model import SkinModel
from palmfield.skin.fem.probe import SurfaceProbe, nearest_on_surface
from palmfield.skin.stepper import Reader, SkinStepper
from palmfield.types import Float

if TYPE_CHECKING:
    from palmfield.hand.posed_surface import SkinBinding

REACH_M, OFF_SKIN_M = 0.01, 0.005
"""Largest distances of a sensor site from the skin layer, along the skin and normal to it."""


class SkinReading(NamedTuple):
    """Readings at the place of a sensor at the beginning of a MuJoCo step.

    arp_force_x_N, _y_N, _z_N: force of the sound on the whole body, mean over the step that begins, world axes
    normal_displacement_m, normal_velocity_m_s: of the skin along its outward normal; arp_Pa: ARP, positive inwards
    """

    arp_force_x_N: float
    arp_force_y_N: float
    arp_force_z_N: float
    normal_displacement_m: float
    normal_velocity_m_s: float
    arp_Pa: float


CHANNELS: dict[str, Callable[[SkinReading], float]] = {name: attrgetter(name) for name in SkinReading._fields}
"""Channels of a sensor, in this order."""
UNITS = tuple(
    next(unit for ending, unit in (("_m_s", "m s-1"), ("_N", "N"), ("_Pa", "Pa"), ("_m", "m")) if name.endswith(ending))
    for name in CHANNELS
)
"""Units of the channels."""


class SensorPlace:
    """Place of a sensor: the point of the layer nearest to its site, and the bones that carry this point."""

    def __init__(self, probe: SurfaceProbe, binding: "SkinBinding | None"):
        self.probe, self.binding = probe, binding
        self._readers: dict[SkinStepper, Reader] = {}

    def reader(self, stepper: SkinStepper) -> Reader:
        """Return the operator from the state of a stepper to displacement and velocity along the outward normal."""
        reader = self._readers.get(stepper)
        if reader is None:
            reader = self._readers[stepper] = stepper.reader(self.probe.operator)
        return reader


def check_site(skin: SkinModel, site: Float, element: str) -> None:
    """Check that a sensor can read at a site of the resting body (body frame [m], shape (3,)). This needs no matrices.

    Raises SceneError, naming the element, for a site above or below the skin, and for one that is far from the layer.
    """
    closest, normals, *_ = nearest_on_surface(skin.layer.mesh, site[None])
    above = float((site - closest[0]) @ normals[0])
    if abs(above) > OFF_SKIN_M:
        where = "above" if above > 0.0 else "below"
        raise SceneError(
            f"{element}: its site is {1e3 * abs(above):.1f} mm {where} the skin; allowed: at most "
            f"{1e3 * OFF_SKIN_M:g} mm: move it onto the skin"
        )
    distance = float(np.linalg.norm(site - closest[0]))
    if distance > max(REACH_M, 2.0 * skin.layer.sizes.edge_coarse_m):
        raise SceneError(
            f"{element}: its site is {1e3 * distance:.0f} mm from the skin layer and would read the rim; put it on "
            "the layer, or move patch_site closer to it"
        )


def sensor_place(skin: SkinModel, site: Float, element: str) -> SensorPlace:
    """Return the sensor place for a site, body frame at rest [m], (3,). Raises SceneError like `check_site`."""
    check_site(skin, site, element)
    probe = skin.layer.probe(site)
    return SensorPlace(probe, skin.carrier.bind(probe.closest))


def skin_reading(force: Float, motion: Float, arp: Float) -> SkinReading:
    """Make the reading at the place of a sensor, for one world or several. Only this function fills the fields.

    force: force on the body [N], shape (3,); motion: displacement [m] and velocity [m/s], shape (2,); arp: ARP [Pa]
    """
    return SkinReading._make((*force, *motion, arp))


def channels(forces: Float, motions: Float, arps: Float) -> Float:
    """Return sensor data in some worlds, shape (g, channels). Arguments as in `skin_reading`, with a leading axis.

    Fields of a reading are computed for all worlds together, and any other channel for each world separately.
    """
    together = skin_reading(forces.T, motions.T, arps)
    rows = []
    for name, channel in CHANNELS.items():
        if name in SkinReading._fields:
            rows.append(getattr(together, name))
        else:
            rows.append([channel(skin_reading(*row)) for row in zip(forces, motions, arps, strict=True)])
    return np.array(rows, dtype=np.float64).T
