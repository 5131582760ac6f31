"""Measured force of radiation pressure on a plate in the field (a jig), or on a scale under a body.

Pressures are acoustic radiation pressures (ARP) [Pa], positive into the plate.
"""

import math
from collections.abc import Callable
from typing import ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field
from scipy.signal import lfilter

from palmfield.config.base import NonNegative, Positive
from palmfield.errors import MeasurementError
from palmfield.hand.triangles import checked_mesh
from palmfield.instruments.settings import Settings, Vector3
from palmfield.metrics.checks import even_step, finite, trace
from palmfield.types import Float

ArpAt = Callable[[Float, Float], Float]
"""Function that returns the ARP [Pa], shape (n,), at points [m] with outward normals, both of shape (n, 3)."""
LEAST = 4
"""Smallest number of points along an edge or a radius, so that half of them give an error estimate."""
SPLITS = 8
"""Parts per edge of a mesh triangle; the parts with their centre on the plate are used."""


class Plate(Settings):
    """The face of a jig. Raises MeasurementError for values outside their limits."""

    instrument: ClassVar[str] = "plate"
    shape: Literal["rectangle", "disc"] = Field(default="rectangle")
    width_m: Positive = Field(default=0.012, description="length along x_axis; diameter of a disc")
    height_m: Positive = Field(default=0.012, description="width across x_axis; rectangle only")
    centre_m: Vector3 = Field(default=(0.0, 0.0, 0.2))
    normal: Vector3 = Field(default=(0.0, 0.0, -1.0), description="outward normal, against the sound")
    x_axis: Vector3 = Field(default=(1.0, 0.0, 0.0))
    spacing_m: Positive = Field(
        default=1e-3, description="largest spacing of the points at which the pressure is evaluated"
    )


class PlateForce(NamedTuple):
    """Force into a plate [N], and the force from points with twice the spacing [N].

    For second-order quadrature, the error of the first force is a third of their difference.
    """

    force_N: float
    coarser_N: float

    @property
    def change(self) -> float:
        """Relative change of the force with twice the spacing of points."""
        return abs(self.force_N - self.coarser_N) / abs(self.force_N) if self.force_N else math.inf


def plate_force(arp_at: ArpAt, plate: Plate) -> PlateForce:
    """Integrate the ARP over a plate.

    arp_at: for example `palmfield.acoustics.arp.arp` of a field, which ignores the effect of the edges on the sound of
        plates narrower than some wavelengths.
    """
    fine, coarse = (_integral(arp_at, plate, coarser) for coarser in (1, 2))
    return PlateForce(fine, coarse)


def _integral(arp_at: ArpAt, plate: Plate, coarser: int) -> float:
    normal, along, across = _axes(plate)
    if plate.shape == "rectangle":
        places = [_middles(length, _count(length, plate, coarser)) for length in (plate.width_m, plate.height_m)]
        x, y = (grid.ravel() for grid in np.meshgrid(*(at for at, _ in places), indexing="ij"))
        weights = np.full(x.size, places[0][1] * places[1][1])
    else:
        radius = 0.5 * plate.width_m
        rings = _count(radius, plate, coarser)
        nodes, shares = np.polynomial.legendre.leggauss(rings)
        radii = radius * np.sqrt(0.5 * (1.0 + nodes))
        angles = 2.0 * math.pi * np.arange(6 * rings) / (6 * rings)
        x, y = (np.outer(radii, turn(angles)).ravel() for turn in (np.cos, np.sin))
        weights = np.repeat(0.5 * shares * math.pi * radius**2 / len(angles), len(angles))
    points = np.array(plate.centre_m) + x[:, None] * along + y[:, None] * across
    pressure = np.asarray(arp_at(points, np.tile(normal, (len(points), 1))), dtype=float)
    if pressure.shape != weights.shape:
        raise MeasurementError(f"arp_at returned shape {pressure.shape} for {len(weights)} points")
    finite("the ARP", pressure)
    return float(pressure @ weights)


def _count(length: float, plate: Plate, coarser: int) -> int:
    return math.ceil(max(LEAST, math.ceil(length / plate.spacing_m * (1.0 - 1e-9))) / coarser)


def _middles(length: float, count: int) -> tuple[Float, float]:
    return ((np.arange(count) + 0.5) / count - 0.5) * length, length / count


def _axes(plate: Plate) -> tuple[Float, Float, Float]:
    normal, along = np.array(plate.normal), np.array(plate.x_axis)
    across = np.cross(normal, along)
    if not np.linalg.norm(across) > 1e-9 * np.linalg.norm(normal) * np.linalg.norm(along):
        raise MeasurementError(
            f"plate: x_axis {plate.x_axis} lies along the normal {plate.normal}, or one has no length"
        )
    normal, across = normal / np.linalg.norm(normal), across / np.linalg.norm(across)
    return normal, np.cross(across, normal), across


def mesh_force(arp: ArrayLike, vertices: ArrayLike, faces: ArrayLike, plate: Plate) -> Float:
    """Return the force against the normal of a plate on the part of a mesh in front of it [N], shape (...,).

    arp: [Pa] at the vertices, shape (..., v), as `arp` of a skin in a result; vertices: [m], (v, 3); faces: (f, 3),
    counter-clockwise seen from outside
    The ARP is linear between vertices; triangles are cut at the outline of the plate, seen along its normal.
    Pressure on faces that face away from the normal, such as those of the back of a finger, has the opposite sign.
    """
    places, triangles = checked_mesh(vertices, faces)
    pressure, corners = np.asarray(arp, dtype=float), places[triangles]
    normal, along, across = _axes(plate)
    area = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) @ normal
    shares = _cuts()
    middles = np.einsum("kc,fci->fki", shares, corners) - np.array(plate.centre_m)
    x, y = np.abs(middles @ along), np.abs(middles @ across)
    if plate.shape == "rectangle":
        inside = (x <= 0.5 * plate.width_m) & (y <= 0.5 * plate.height_m)
    else:
        inside = np.hypot(x, y) <= 0.5 * plate.width_m
    parts = np.einsum("fk,kc->fc", inside.astype(float), shares) / len(shares) * area[:, None]
    weights = np.zeros(len(places))
    np.add.at(weights, triangles, parts)
    if pressure.shape[-1:] != weights.shape:
        raise MeasurementError(f"arp has shape {pressure.shape}, but there are {len(weights)} vertices")
    return np.asarray(pressure @ weights)


def _cuts() -> Float:
    """Return the barycentric coordinates of the centres of equal parts of a triangle, shape (k, 3)."""
    low, high = [], []
    for i in range(SPLITS):
        for j in range(SPLITS - i):
            low.append((i + 1.0 / 3.0, j + 1.0 / 3.0))
            if j < SPLITS - i - 1:
                high.append((i + 2.0 / 3.0, j + 2.0 / 3.0))
    first, second = np.array(low + high).T / SPLITS
    return np.column_stack([first, second, 1.0 - first - second])


class Scale(Settings):
    """A scale. Raises MeasurementError for values outside their limits."""

    instrument: ClassVar[str] = "scale"
    direction: Vector3 = Field(default=(0.0, 0.0, -1.0), description="direction in which force counts as weight")
    resolution_N: NonNegative = Field(
        default=0.0, description="resolution of the readings; 0: unlimited (1 mg is 9.8e-6 N)"
    )
    time_constant_s: NonNegative = Field(default=0.0, description="time constant of settling, one pole; 0: immediate")
    tared: bool = Field(default=True, description="whether readings are differences from the first one")


def scale_reading(times_s: ArrayLike, force_N: ArrayLike, settings: Scale) -> Float:
    """Return the reading of a scale over time [N], shape (t,), for a force, shape (t, 3), as in /forces of a result.

    The first-order response of the scale (`time_constant_s`) is integrated exactly if the force is linear between
    samples. Raises MeasurementError for a direction of length 0.
    """
    times, force = trace(times_s, force_N)
    direction = np.array(settings.direction)
    if force.shape != (len(times), 3) or not np.linalg.norm(direction) > 0.0:
        raise MeasurementError(
            f"force has shape {force.shape} and direction {settings.direction}; give (t, 3), no zeros"
        )
    weight = force @ (direction / np.linalg.norm(direction))
    if settings.tared:
        weight = weight - weight[0]
    if settings.time_constant_s > 0.0:
        weight = _one_pole(weight, even_step(times) / settings.time_constant_s)
    if settings.resolution_N > 0.0:
        weight = settings.resolution_N * np.round(weight / settings.resolution_N)
    return np.asarray(weight)


def _one_pole(values: Float, step: float) -> Float:
    decay = math.exp(-step)
    mean = -math.expm1(-step) / step
    # y' = x - y with x linear over a step: y1 = keep y0 + (mean - keep) x0 + (1 - mean) x1
    return np.asarray(lfilter([1.0 - mean, mean - decay], [1.0, -decay], values, zi=[mean * values[0]])[0])
