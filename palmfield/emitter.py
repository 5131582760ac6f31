"""The scene's arrays as one source of sound, and what it emits for a focus."""

import functools
import math
import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from palmfield.acoustics.air import density, sound_speed
from palmfield.acoustics.arrays import combined, from_poses, layout, placed, with_faults
from palmfield.acoustics.field import FieldEvaluator
from palmfield.acoustics.focus import focus
from palmfield.acoustics.reference import pressure64
from palmfield.acoustics.transducer import T4010A1_DIRECTIVITY
from palmfield.config import ArrayConfig, StimulusConfig
from palmfield.device import resolve
from palmfield.drive.device import Device, play
from palmfield.errors import SceneError
from palmfield.types import Air, Array, Complex, Float

SAME_PLACE = 1e-9

Numbers = tuple[float, ...]
Placement = tuple[Numbers, Numbers]
"""Position [m], 3 numbers, and rotation, 9 numbers by row, in the frame of the scene's first array."""


@dataclass(frozen=True)
class Board:
    """One array of the scene.

    config: its keys; placement: in the reference pose; sites: position and emitting direction of each transducer in the
    array's frame, for layout `sites`, else empty
    """

    config: ArrayConfig
    placement: Placement
    sites: tuple[tuple[Numbers, Numbers], ...] = ()

    def array(self) -> Array:
        """Its transducers in its own frame. Raises SceneError for faults that it cannot have."""
        config = self.config
        if config.layout == "sites":
            positions, normals = zip(*self.sites, strict=True)
            array = from_poses("sites", np.array(positions), np.array(normals), config.p0_Pa_m)
        else:
            array = layout(config.layout, config.p0_Pa_m)
        if config.directivity == "point":
            array = replace(array, piston_radius_m=0.0, directivity_table=None)
        elif config.directivity == "piston":
            array = replace(array, directivity_table=None)
        elif config.directivity == "t4010a1":
            array = replace(array, directivity_table=T4010A1_DIRECTIVITY)
        if config.piston_radius_m is not None:
            array = replace(array, piston_radius_m=config.piston_radius_m)
        if config.dead or config.inverted:
            array = with_faults(array, config.dead, config.inverted)
        return array


class Emitter:
    """All arrays of a scene in one relative pose; made anew only where one moves against another.

    placements: of each board, in the frame of the first
    """

    def __init__(
        self,
        boards: Sequence[Board],
        placements: Sequence[Placement],
        stimulus: StimulusConfig,
        device: Device,
    ):
        first = boards[0].config
        self.stimulus, self.device = stimulus, device
        self.air = Air(first.temperature_C, first.humidity_percent, first.pressure_Pa)
        self.compute, self.precision = first.compute, first.precision
        self.placements = tuple(placements)
        self.impedance = density(self.air) * sound_speed(self.air) ** 2
        self._lock = threading.RLock()
        self._unit: tuple[tuple[float, ...], tuple[Complex, float]] = ((), (np.zeros(0, complex), 0.0))
        try:
            self.parts = tuple(board.array() for board in boards)
            moved = [
                part if i == 0 else placed(part, np.array(p), np.array(turn).reshape(3, 3))
                for i, (part, (p, turn)) in enumerate(zip(self.parts, placements, strict=True))
            ]
            self.array = moved[0] if len(moved) == 1 else combined(moved)
        except SceneError as error:
            raise SceneError(f"plugin 'palmfield.array': {error}") from None
        self.starts = np.cumsum([0, *(len(part) for part in self.parts)])

    @property
    def evaluator(self) -> FieldEvaluator:
        """Field kernels for these arrays on the scene's device."""
        with self._lock:
            return self._evaluator

    @functools.cached_property
    def _evaluator(self) -> FieldEvaluator:
        return FieldEvaluator(self.array, self.air, resolve(self.compute), mode=self.precision)

    def same(self, placements: Sequence[Placement]) -> bool:
        """Whether the arrays stand to one another as they do here, to a nanometre and a nanoradian."""
        pairs = zip(self.placements, placements, strict=True)
        return all(np.allclose(sum(a, ()), sum(b, ()), rtol=0.0, atol=SAME_PLACE) for a, b in pairs)

    def unit_drive(self, point: Float) -> tuple[Complex, float]:
        """What the arrays emit for a focus at `point` (frame of the first array [m], shape (3,)) at the loudest moment.

        Returns the complex amplitude of each transducer relative to full drive, shape (n,), and the amplitude asked
        for, 0..1. A transducer that the point is behind stays silent.
        Raises SceneError for a focus that no transducer can make or a level that they cannot reach.
        """
        asked, known = self._unit
        if asked == tuple(point):
            return known
        facing = np.einsum("ij,ij->i", point - self.array.positions, self.array.normals) > 0.0
        # Where none faces the point, `focus` says so
        some = facing if facing.any() else np.ones(len(self.array), dtype=bool)
        phases = np.zeros(len(self.array), complex)
        try:
            phases[some] = focus(only(self.array, some), self.air, point)
        except SceneError as error:
            raise SceneError(f"plugin 'palmfield.stimulus': key 'focus_m': {error}") from None
        level = 1.0 if self.stimulus.drive_amplitude is None else self.stimulus.drive_amplitude
        wanted = self.stimulus.arp_peak_Pa
        if wanted is not None:
            full = abs(pressure64(point[None], self.array, phases, self.air)[0][0]) ** 2 / self.impedance
            level = math.sqrt(wanted / full)
            if level > 1.0:
                raise SceneError(
                    f"plugin 'palmfield.stimulus': arp_peak_Pa {wanted:g} is more than the array gives at "
                    f"{in_mm(point)}: {full:.3g} Pa at full drive with p0_Pa_m {self.array.p0_Pa_m:g}"
                )
        known = (play(self.device, level * phases), level)
        self._unit = (tuple(point), known)
        return known


def only(array: Array, chosen: Float) -> Array:
    """The chosen transducers of an array."""
    return replace(
        array,
        positions=array.positions[chosen],
        normals=array.normals[chosen],
        address=None if array.address is None else array.address[chosen],
        gain=None if array.gain is None else array.gain[chosen],
    )


def in_mm(point: Sequence[float] | Float) -> str:
    """A position as text, e.g. (0.0, 12.5, 200.0) mm."""
    return "(" + ", ".join(f"{1e3 * float(x):.1f}" for x in point) + ") mm"
