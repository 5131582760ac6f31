"""The scene's arrays as one source of sound, and what it emits for a focus."""

import functools
import math
import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, NamedTuple

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
from palmfield.drive.foci import solve_foci
from palmfield.errors import SceneError
from palmfield.types import Air, Array, Complex, Field, Float, Int

if TYPE_CHECKING:
    from palmfield.aim import Aim

SAME_PLACE = 1e-9

Numbers = tuple[float, ...]


class Placement(NamedTuple):
    """Where an array is, in the frame of the scene's first array.

    position: [m], 3 numbers; rotation: 9 numbers by row
    sites: position [m] and emitting direction of each transducer in the array's own frame, for layout `sites`, else
        empty; they may move against one another
    """

    position: Numbers
    rotation: Numbers
    sites: tuple[tuple[Numbers, Numbers], ...] = ()


@dataclass(frozen=True)
class Board:
    """One array of the scene. config: its keys; placement: in the reference pose"""

    config: ArrayConfig
    placement: Placement

    def array(self, sites: tuple[tuple[Numbers, Numbers], ...] = ()) -> Array:
        """Its transducers in its own frame; sites: see Placement.

        Raises SceneError for faults that it cannot have, and for a piston's radius where there is no piston.
        """
        config = self.config
        if config.layout == "sites":
            positions, normals = zip(*sites, strict=True)
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
            if config.directivity == "point" or array.directivity_table is not None:
                raise SceneError(
                    f"key 'piston_radius_m' has value {config.piston_radius_m:g}, but layout '{config.layout}' with "
                    f"directivity '{config.directivity}' has no piston: drop it or set directivity to piston"
                )
            array = replace(array, piston_radius_m=config.piston_radius_m)
        if config.dead or config.inverted:
            array = with_faults(array, config.dead, config.inverted)
        return array


@dataclass(frozen=True)
class Kind:
    """Transducers of one directivity. array: in the frame of the first array; chosen: their numbers among all, (n,)"""

    array: Array
    chosen: Int


def kinds_of(parts: Sequence[Array]) -> tuple[Kind, ...]:
    """Arrays in one frame, sorted by directivity; transducers are numbered from array to array."""
    starts = np.cumsum([0, *(len(part) for part in parts)])
    found: dict[tuple[float, bytes], list[int]] = {}
    for i, part in enumerate(parts):
        table = b"" if part.directivity_table is None else part.directivity_table.tobytes()
        found.setdefault((part.piston_radius_m, table), []).append(i)
    return tuple(
        Kind(
            combined([parts[i] for i in same]),
            np.concatenate([np.arange(starts[i], starts[i + 1]) for i in same]).astype(np.int32),
        )
        for same in found.values()
    )


class FieldSum:
    """Field of transducers of one or several kinds: the sum over an evaluator for each, on one device."""

    def __init__(self, kinds: tuple[Kind, ...], air: Air, device: str, mode: Literal["fast", "accurate"]):
        self.kinds, self.device = kinds, device
        self.evaluators = tuple(FieldEvaluator(kind.array, air, device, mode=mode) for kind in kinds)

    def pressure(self, points: Float, drive: Complex, gradient: bool = False) -> Field:
        """As FieldEvaluator.pressure, for the drive of all transducers, shape (n,)."""
        fields = [
            evaluator.pressure(points, drive[kind.chosen], gradient)
            for kind, evaluator in zip(self.kinds, self.evaluators, strict=True)
        ]
        total = fields[0].pressure, fields[0].gradient
        for field in fields[1:]:
            slope = None if total[1] is None or field.gradient is None else total[1] + field.gradient
            total = total[0] + field.pressure, slope
        return Field(*total)


class Emitter:
    """All arrays of a scene in one relative pose; made anew only where one moves against another.

    placements: of each board, in the frame of the first
    array: all transducers in one, for positions, directions and gains. Where their kinds differ it has the widest
        piston of them and no table: take `pressure64` or `evaluator` for the sound
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
            self.parts = tuple(board.array(place.sites) for board, place in zip(boards, placements, strict=True))
            moved = [
                part if i == 0 else placed(part, np.array(place.position), np.array(place.rotation).reshape(3, 3))
                for i, (part, place) in enumerate(zip(self.parts, placements, strict=True))
            ]
            self.kinds = kinds_of(moved)
            if len(self.kinds) > 1:
                widest = max(part.piston_radius_m for part in moved)
                moved = [replace(part, piston_radius_m=widest, directivity_table=None) for part in moved]
            self.array = moved[0] if len(moved) == 1 else combined(moved)
        except SceneError as error:
            raise SceneError(f"plugin 'palmfield.array': {error}") from None

    @property
    def evaluator(self) -> FieldSum:
        """Field kernels for these arrays on the scene's device."""
        with self._lock:
            return self._evaluator

    @functools.cached_property
    def _evaluator(self) -> FieldSum:
        return FieldSum(self.kinds, self.air, resolve(self.compute), self.precision)

    def pressure64(self, points: Float, drive: Complex) -> Complex:
        """Complex peak pressure [Pa], shape (n,), at points [m], shape (n, 3), in float64 on the CPU."""
        parts = [pressure64(points, kind.array, drive[kind.chosen], self.air)[0] for kind in self.kinds]
        return np.sum(parts, axis=0)

    def same(self, placements: Sequence[Placement]) -> bool:
        """Whether the arrays stand to one another as they do here, to a nanometre and a nanoradian."""
        pairs = zip(self.placements, placements, strict=True)
        return all(same_place(a, b) for a, b in pairs)

    def unit_drive(self, point: Float) -> tuple[Complex, float]:
        """What the arrays emit for a focus at `point` (frame of the first array [m], shape (3,)) at the loudest moment.

        Several points, shape (m, 3), become foci at once, equally loud (`palmfield.drive.foci`).
        Returns the complex amplitude of each transducer relative to full drive, shape (n,), and the amplitude asked
        for, 0..1. A transducer that a point is behind stays silent.
        Raises SceneError for a focus that no transducer can make or a level that they cannot reach.
        """
        asked, known = self._unit
        if asked == tuple(point.ravel()):
            return known
        rays = np.atleast_2d(point)[:, None] - self.array.positions
        facing = (np.einsum("mij,ij->mi", rays, self.array.normals) > 0.0).all(axis=0)
        # Where none faces the point, `focus` says so
        some = facing if facing.any() else np.ones(len(self.array), dtype=bool)
        phases = np.zeros(len(self.array), complex)
        try:
            if point.ndim == 1:
                phases[some] = focus(only(self.array, some), self.air, point)
            else:
                phases[some] = solve_foci(point, only(self.array, some), self.air).drive
        except SceneError as error:
            raise SceneError(f"plugin 'palmfield.stimulus': key 'focus_m': {error}") from None
        level = 1.0 if self.stimulus.drive_amplitude is None else self.stimulus.drive_amplitude
        wanted = self.stimulus.arp_peak_Pa
        if wanted is not None:
            full = float((np.abs(self.pressure64(np.atleast_2d(point), phases)) ** 2).max()) / self.impedance
            if full == 0.0:
                raise SceneError(
                    f"plugin 'palmfield.stimulus': arp_peak_Pa {wanted:g} is wanted at {in_mm(point)}, but all "
                    "transducers that could sound there are dead: shorten key 'dead' of the array"
                )
            level = math.sqrt(wanted / full)
            if level > 1.0:
                raise SceneError(
                    f"plugin 'palmfield.stimulus': arp_peak_Pa {wanted:g} is more than the array gives at "
                    f"{in_mm(point)}: {full:.3g} Pa at full drive with p0_Pa_m {self.array.p0_Pa_m:g}"
                )
        known = (play(self.device, level * phases), level)
        self._unit = (tuple(point.ravel()), known)
        return known

    def focusing(self, foci: Float, chosen: Int) -> Complex:
        """Drives exp(-i k d) of some transducers for foci [m], shape (k, 3), each by itself, shape (k, n)."""
        wavenumber = 2.0 * math.pi * self.array.frequency_Hz / sound_speed(self.air)
        away = foci[:, None, :] - self.array.positions[chosen]
        return np.asarray(np.exp(-1j * wavenumber * np.sqrt(np.einsum("ijk,ijk->ij", away, away))))

    def unit_drives(self, points: Float, aim: "Aim") -> Complex:
        """`unit_drive` for what a stimulus asks for at several moments, shape (m, 3), as amplitudes, shape (m, n).

        aim: where the points are
        """
        one_by_one = len(aim.offsets) > 0 or self.device.name != "ideal" or self.stimulus.arp_peak_Pa is not None
        if not one_by_one and len(points) > 1:
            foci = aim.course(points)
            facing = np.einsum("mij,ij->mi", foci[:, None] - self.array.positions, self.array.normals) > 0.0
            if facing.any(axis=1).all():
                level = 1.0 if self.stimulus.drive_amplitude is None else self.stimulus.drive_amplitude
                return level * facing * self.focusing(foci, np.arange(len(self.array), dtype=np.int32))
        return np.array([self.unit_drive(aim(point))[0] for point in points])


def same_place(one: Placement, other: Placement) -> bool:
    """Whether two placements of an array agree to SAME_PLACE."""
    pairs = ((one.position, other.position), (one.rotation, other.rotation), (one.sites, other.sites))
    return one == other or all(np.allclose(a, b, rtol=0.0, atol=SAME_PLACE) for a, b in pairs)


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
    """A position, or several, as text, e.g. (0.0, 12.5, 200.0) mm."""
    if np.ndim(point) == 2:
        return " and ".join(in_mm(one) for one in np.asarray(point))
    return "(" + ", ".join(f"{1e3 * float(x):.1f}" for x in point) + ") mm"
