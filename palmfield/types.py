"""Data types that stages exchange (see docs/architecture.md). SI units; e^{-i w t}, so a delay is +phase."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
Float32 = NDArray[np.float32]
Complex = NDArray[np.complex128]
Int = NDArray[np.int32]


@dataclass(frozen=True)
class Air:
    """Still air. Defaults are the project's reference conditions."""

    temperature_C: float = 20.0
    humidity_percent: float = 50.0
    pressure_Pa: float = 101325.0


Kind = Literal["measured", "data sheet", "inferred", "assumed"]
"""Origin of a number: calibration in a laboratory, data sheet, other published figures, or common practice."""


@dataclass(frozen=True)
class Estimate:
    """A number with its range.

    low, high: ends of the range, in the unit of the number, low <= value <= high
    kind: origin of the number; source: source of the number in words
    """

    value: float
    low: float
    high: float
    kind: Kind
    source: str

    def __post_init__(self) -> None:
        if not 0.0 < self.low <= self.value <= self.high < float("inf"):
            raise ValueError(f"{self.low} <= {self.value} <= {self.high} does not hold, or is not positive and finite")


@dataclass(frozen=True)
class Array:
    """Transducers of one array, in the array frame (origin at their centroid, x right, y up the board, z out).

    positions: [m], shape (n, 3), float64; normals: unit emitting directions, shape (n, 3), float64
    p0_Pa_m: peak pressure of one transducer at 1 m on its axis at full drive, without absorption [Pa m]
    piston_radius_m: radius of the baffled piston whose directivity is used [m]; 0 is a point source
    address: index of each transducer in the byte order of the board, shape (n,), or None
    gain: complex factor of the sound of each transducer, shape (n,): 0 for a dead one, -1 for reversed polarity; None
        is 1 for all
    directivity_table: measured directivity that replaces that of the piston, shape (m, 2): angle to the axis [deg] and
        amplitude relative to the axis; None: use `directivity`
    directivity: name of a form of `palmfield.acoustics.directivities`
    """

    name: str
    positions: Float
    normals: Float
    p0_Pa_m: float
    frequency_Hz: float = 40e3
    piston_radius_m: float = 4.5e-3
    address: Int | None = None
    gain: Complex | None = None
    directivity_table: Float | None = None
    directivity: str = "piston"

    def __len__(self) -> int:
        return len(self.positions)


@dataclass(frozen=True)
class Field:
    """Incident sound at points. Vectors are in the frame of the points.

    pressure: complex peak pressure [Pa], shape (n,), complex64
    gradient: its gradient [Pa/m], shape (n, 3), complex64, or None
    For points on a device both are Warp arrays on this device, of wp.vec2 (real, imaginary).
    """

    pressure: NDArray[np.complex64]
    gradient: NDArray[np.complex64] | None = None


@dataclass(frozen=True)
class Surface:
    """A triangle mesh in a body frame, with unit outward normals by vertex.

    vertices: [m], shape (n, 3), float64; faces: shape (m, 3), int32; normals: shape (n, 3), float64
    """

    vertices: Float
    faces: Int
    normals: Float


@dataclass(frozen=True)
class Patch:
    """The part of a surface that gets a skin layer. Extrusion along `inward` makes the solid layer.

    vertices: [m], shape (n, 3), float64, in the body frame
    faces: shape (m, 3), int32, counter-clockwise seen from outside
    inward: unit directions into the body, shape (n, 3), float64
    depth: thickness of the layer along `inward` [m], shape (n,), float64
    rim: True on vertices of the lateral boundary, shape (n,), bool
    axis: symmetry axis direction for roller sides (unit, outward), shape (3,), or None
    report: numbers for the plan and the result file (fraction of thinned area, smallest element quality, ...)
    """

    vertices: Float
    faces: Int
    inward: Float
    depth: Float
    rim: NDArray[np.bool_]
    axis: Float | None = None
    report: dict[str, float] = field(default_factory=dict)


def json_value(value: object) -> object:
    """Return NumPy scalars and arrays as values for JSON."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} cannot be written as JSON")
