"""Problem of a field benchmark, as a file that programs of other environments can read. It imports only NumPy."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmfield.types import Array, Complex, Float, Float32

MOST_RUNS = 63
"""Largest number of runs. Programs that prepare a signal in advance need its length."""


@dataclass(frozen=True, eq=False)
class Problem:
    """Transducers, drive and a regular grid of points, with all numbers that a program needs to compute the field.

    low_m: first point of the grid [m]
    steps: number of points along x, y, z
    resolution_m: distance of neighbouring points [m]
    positions, normals: positions and axes of the transducers [m], shape (t, 3), float64; in groups of 249, for
    programs that accept
        only whole AUTD3 units
    drive: complex amplitudes, 1 is full drive, shape (t,), complex128
    p0_Pa_m, frequency_Hz, sound_speed_m_s: as in Array and Air
    piston_radius_m: 0 is a point source; absorption_Np_m: 0 is lossless air
    directivity, sine, cosine, attenuation: polynomials of palmfield.acoustics.polynomials, lowest power first
    temperature_C: temperature of the air, for programs that compute the sound speed themselves
    device: Warp device of palmfield's own methods
    """

    low_m: Float
    steps: NDArray[np.int64]
    resolution_m: float
    positions: Float
    normals: Float
    drive: Complex
    p0_Pa_m: float
    frequency_Hz: float
    sound_speed_m_s: float
    piston_radius_m: float
    absorption_Np_m: float
    directivity: Float
    sine: Float
    cosine: Float
    attenuation: Float
    temperature_C: float
    device: str = "cpu"

    @property
    def wavenumber(self) -> float:
        """Wavenumber of the sound in air [rad/m]."""
        return 2.0 * np.pi * self.frequency_Hz / self.sound_speed_m_s

    def array(self) -> Array:
        """Return the transducers, which are all equal."""
        return Array("bench", self.positions, self.normals, self.p0_Pa_m, self.frequency_Hz, self.piston_radius_m)

    def points(self) -> Float32:
        """Return the points of the grid [m], shape (product of steps, 3), float32, x running fastest."""
        axes = [low + self.resolution_m * np.arange(n) for low, n in zip(self.low_m, self.steps, strict=True)]
        z, y, x = np.meshgrid(axes[2], axes[1], axes[0], indexing="ij")
        return np.column_stack([x.ravel(), y.ravel(), z.ravel()]).astype(np.float32)

    def save(self, path: Path) -> None:
        np.savez(path, **asdict(self))


def load(path: Path) -> Problem:
    """Read a problem written by `Problem.save`."""
    with np.load(path) as stored:
        values = {name: stored[name] for name in stored.files}
    return Problem(**{name: value if value.ndim else value.item() for name, value in values.items()})


@dataclass(frozen=True)
class Method:
    """One way to compute a field.

    name: as in the table
    model: a key of palmfield.studies.bench.field.MODELS, the radiation model of one transducer
    prepare: makes the input of `run` from a Problem; this work is not repeated for another drive
    run: returns the complex pressure [Pa], shape (n,), or pressure and gradient as columns, shape (n, 4);
        real numbers are magnitudes
    needs: distributions to import before the measurement; the version of the first one is reported
    """

    name: str
    model: str
    prepare: Callable[[Problem], Any]
    run: Callable[[Any], NDArray[Any]]
    needs: tuple[str, ...] = ()
