"""The parts of a scene that a drive needs, without a scene."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from palmfield.acoustics.air import density, sound_speed
from palmfield.acoustics.arrays import combined, layout, placed
from palmfield.acoustics.reference import pressure64
from palmfield.types import Air, Array, Complex, Float


@dataclass(repr=False)
class Source:
    """Arrays of any directivity, placed in one frame."""

    parts: tuple[Array, ...]
    placed: tuple[Array, ...]
    air: Air = field(default_factory=Air)

    @property
    def array(self) -> Array:
        """All of them; its directivity means nothing where they differ."""
        alike = [replace(part, piston_radius_m=0.0, directivity_table=None) for part in self.placed]
        return self.placed[0] if len(self.placed) == 1 else combined(alike)

    @property
    def impedance(self) -> float:
        return density(self.air) * sound_speed(self.air) ** 2

    def pressure64(self, points: Float, drive: Complex) -> Complex:
        ends = np.cumsum([len(part) for part in self.placed])[:-1]
        drives = np.split(drive, ends)
        return sum(
            pressure64(points, part, one, self.air)[0] for part, one in zip(self.placed, drives, strict=True)
        )  # fmt: skip


@pytest.fixture(scope="session")
def source() -> Source:
    """One UHEV1."""
    return Source((layout("uhev1"),), (layout("uhev1"),))


@pytest.fixture(scope="session")
def mixed() -> Source:
    """A UHEV1 with faults, and a louder array beside it, turned towards it, whose transducers are points."""
    gain = np.ones(256, complex)
    gain[[3, 70]], gain[8] = 0.0, -1.0
    first = replace(layout("uhev1"), gain=gain)
    second = replace(layout("sonicsurface"), piston_radius_m=0.0, p0_Pa_m=4.0)
    tilt = np.array([[0.8, 0.0, -0.6], [0.0, 1.0, 0.0], [0.6, 0.0, 0.8]])
    return Source((first, second), (first, placed(second, np.array([0.25, 0.0, 0.03]), tilt)))
