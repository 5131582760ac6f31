"""The arrays of a scene as one source of sound: their transducers in one frame, and their common field.

The frame is that of the first array of the scene ("array frame"). All objects are immutable, so that threads and
simulations can share them. If arrays move relative to each other, a new `PhasedArray` is made.
"""

import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import scipy  # loads its submodules at first use
from numpy.typing import NDArray

from palmfield.acoustics.air import density, sound_speed
from palmfield.acoustics.arrays import LAYOUTS, combined, from_poses, layout, placed, with_faults
from palmfield.acoustics.directivities import FORMS, form_of
from palmfield.acoustics.directivity import Directivity
from palmfield.acoustics.field import FieldEvaluator, FieldSum, Mode, Parts
from palmfield.acoustics.placement import sides_of
from palmfield.acoustics.reference import pressure64
from palmfield.acoustics.transducer import ANY_P0, ANY_QUALITY
from palmfield.config import ArrayConfig
from palmfield.errors import SceneError
from palmfield.locked import next_serial
from palmfield.transforms import Numbers, Placement, corners_of
from palmfield.types import Air, Array, Complex, Estimate, Float, Int

if TYPE_CHECKING:
    from palmfield.acoustics.calibration_file import Calibration
    from palmfield.acoustics.transducer_file import TransducerTable

HOUSING_M = 5e-3
"""Distance by which a board extends beyond its transducers, and height of a transducer [m]."""
FLAT_M = 1e-6
"""Largest difference of the heights of transducers in one plane [m]."""
SAME_PLACE = 1e-9
"""Difference of positions [m] and directions below which they count as equal."""


@dataclass(frozen=True)
class ArrayInstance:
    """One array of the scene.

    config: keys of the array. placement: placement in the reference pose of the scene.
    calibration: calibration from the file of key `calibration`. table: table from the file of key `transducers`.
    """

    config: ArrayConfig
    placement: Placement
    calibration: "Calibration | None" = None
    table: "TransducerTable | None" = None

    @property
    def p0(self) -> Estimate:
        """Peak pressure of one transducer at 1 m on its axis at full drive [Pa m].

        It is the calibrated value, or else key `p0_Pa_m`, or else that of the layout. Without a range in the scene,
        the range of the layout is widened to include the key.
        """
        config, usual = self.config, _layout_estimates(self.config.layout)[0]
        if self.calibration is not None and self.calibration.p0 is not None:
            return self.calibration.p0
        if config.p0_Pa_m is None:
            return usual
        low, high = config.p0_low_Pa_m or usual.low, config.p0_high_Pa_m or usual.high
        return _scene_estimate(config.p0_Pa_m, low, high, "p0_Pa_m")

    @property
    def quality(self) -> Estimate:
        """Quality factor of the resonance: calibrated, or of key `quality`, or of the layout."""
        config, usual = self.config, _layout_estimates(self.config.layout)[1]
        if self.calibration is not None and self.calibration.quality is not None:
            return self.calibration.quality
        if config.quality is None:
            return usual
        return _scene_estimate(config.quality, usual.low, usual.high, "quality")

    def pole(self, count: int) -> tuple[Float, Float]:
        """Return resonance [Hz] and quality factor of each transducer, shapes (count,), by the calibration or keys."""
        calibration = self.calibration
        f0 = np.full(count, self.config.resonance_Hz)
        quality = np.full(count, self.quality.value)
        if calibration is not None and calibration.resonance_Hz is not None:
            f0 = np.full(count, calibration.resonance_Hz.value)
        if calibration is not None and calibration.elements is not None:
            f0 = f0 if calibration.elements.resonance_Hz is None else np.array(calibration.elements.resonance_Hz)
            quality = quality if calibration.elements.quality is None else np.array(calibration.elements.quality)
        return f0, quality

    def array(self, sites: tuple[tuple[Numbers, Numbers], ...] = ()) -> Array:
        """Return the transducers in the frame of the array.

        sites: position [m] and emitting direction of each transducer, for layout `sites`.
        Raises SceneError for invalid dead or inverted transducers, for a piston radius without a piston, and for the
        calibration of another array.
        """
        config = self.config
        if config.layout == "sites":
            positions, normals = zip(*sites, strict=True)
            array = from_poses("sites", np.array(positions), np.array(normals), self.p0.value)
        elif self.table is not None:
            array = self.table.array(self.p0.value)
        else:
            array = layout(config.layout, self.p0.value)
        if config.directivity in FORMS:
            array = FORMS[config.directivity].of(array)
        if config.piston_radius_m is not None:
            if not form_of(array).sized:
                raise SceneError(
                    f"layout '{config.layout}' with directivity '{config.directivity}' has no piston: remove the "
                    "radius or set directivity to piston",
                    setting="piston_radius_m",
                )
            array = replace(array, piston_radius_m=config.piston_radius_m)
        if self.calibration is not None:
            from palmfield.acoustics.calibration_file import calibrated

            array = calibrated(array, self.calibration)
        if config.dead or config.inverted:
            array = with_faults(array, config.dead, config.inverted)
        return array


def _scene_estimate(value: float, low: float, high: float, key: str) -> Estimate:
    """Return the estimate for a value of the scene, with a range that is widened to include it."""
    return Estimate(value, min(low, value), max(high, value), "assumed", f"{key} of the scene")


def _layout_estimates(name: str) -> tuple[Estimate, Estimate]:
    """Return the estimates of p0 and quality factor of a layout, or for other boards those of all transducers."""
    board = LAYOUTS.get(name)
    return (ANY_P0, ANY_QUALITY) if board is None else (board.p0, board.quality)


@dataclass(frozen=True)
class DirectivityGroup:
    """All transducers with one directivity.

    array: these transducers, in the array frame; chosen: their numbers among all transducers, shape (n,)
    """

    array: Array
    chosen: Int


def directivity_groups(parts: Sequence[Array]) -> tuple[DirectivityGroup, ...]:
    """Group the transducers of arrays in one frame by directivity; they are numbered from array to array."""
    starts = np.cumsum([0, *(len(part) for part in parts)])
    members: dict[tuple[float, Directivity], list[int]] = {}
    for i, part in enumerate(parts):
        members.setdefault((part.piston_radius_m, form_of(part)), []).append(i)
    return tuple(
        DirectivityGroup(
            combined([parts[i] for i in same]),
            np.concatenate([np.arange(starts[i], starts[i + 1]) for i in same]).astype(np.int32),
        )
        for same in members.values()
    )


@dataclass(frozen=True)
class BoardOutline:
    """Outline of an array for collision checks, in the frame of the array.

    low, high: x and y of the corners of the housing [m], for transducers in one plane that face along z; height: z of
        this plane [m].
    nearest: tree of the transducers, for arrays without such a plane; else None.
    """

    low: tuple[float, float]
    high: tuple[float, float]
    height: float
    nearest: "scipy.spatial.cKDTree | None" = None

    @staticmethod
    def of(array: Array) -> "BoardOutline":
        """Return the outline of an array in its own frame."""
        positions = array.positions
        (low_x, low_y, low), (high_x, high_y, high) = positions.min(axis=0).tolist(), positions.max(axis=0).tolist()
        flat = high - low <= FLAT_M and array.normals[:, 2].min() >= 0.5
        return BoardOutline(
            (low_x - HOUSING_M, low_y - HOUSING_M),
            (high_x + HOUSING_M, high_y + HOUSING_M),
            float(positions[:, 2].mean()),
            None if flat else scipy.spatial.cKDTree(positions),
        )

    def clearance(self, points: Float) -> float:
        """Return the smallest distance of points [m], shape (n, 3), from the board [m]: negative behind it, inf if no
        point is over it. For an array without a plane it is the smallest distance from the face of a transducer."""
        if self.nearest is not None:
            return float(np.minimum.reduce(self.nearest.query(points)[0], initial=np.inf)) - HOUSING_M
        x, y, z = points.T
        over = (x >= self.low[0]) & (x <= self.high[0]) & (y >= self.low[1]) & (y <= self.high[1])
        return float(np.minimum.reduce(z, where=over, initial=np.inf)) - self.height


class MultiArrayField(FieldSum):
    """Field of transducers of one or several directivities, as the sum of one evaluator for each, on one device.

    For repeated radiation pressures at a constant number of points use `palmfield.acoustics.surface_arp.SurfaceArp`.

    groups: transducers of each evaluator; evaluators: one per group
    air: air of all groups; device: "cpu" or "cuda:N"; mode: as for FieldEvaluator
    count: number of different transducers; a transducer in several groups emits from several positions
    """

    def __init__(self, groups: tuple[DirectivityGroup, ...], air: Air, device: str = "auto", mode: Mode = "fast"):
        """Raises SceneError for a bad array or air, PalmfieldError for a device that is not on this machine."""
        super().__init__()
        self.groups, self.air, self.mode = groups, air, mode
        self.evaluators = tuple(FieldEvaluator(group.array, air, device, mode=mode) for group in groups)
        self.device, self.name = self.evaluators[0].device, "the field"
        self.count = len(np.unique(np.concatenate([group.chosen for group in groups])))
        self._parts = [(one, group.chosen[one.order]) for group, one in zip(groups, self.evaluators, strict=True)]

    @property
    def parts(self) -> Parts:
        return self._parts


class PhasedArray:
    """All arrays of a scene in one relative pose. Immutable, so threads can share it.

    instances: arrays of the scene; air, precision of the kernels and frame are those of the first array.
    placements: placement of each array in the frame of the first one.
    device: device on which the field is computed, "auto", "cpu" or "cuda:N".
    wall_m: distance from the plane of the transducers to a flat wall in front of them, for multiple reflections
        (`palmfield.acoustics.echo`); None without reflections.
    parts: transducers of each array in its own frame. slices: slice of each part in the numbering of all transducers.
    groups: transducers by directivity, in the array frame. images: groups for the multiple reflections.
    array: all transducers, for positions, directions and gains only: with different directivities it has the largest
        piston and no table. For sound use `pressure64` or `field`. impedance: rho c^2 of the air [Pa].
    frames: frame of each part relative to the first. boards: outline of each part, in its own frame.
    sides: numbers of the transducers of each part, or of each direction of a part that wraps a body.
    corners: corners of a box round the transducers of each side, array frame [m], shape (8 sides, 3).
    facing: mean direction of the transducers of each side, array frame, by column, shape (3, sides).
    heights: height of the centre of each side along that direction [m], shape (sides,).
    serial: unique number.
    """

    def __init__(
        self,
        instances: Sequence[ArrayInstance],
        placements: Sequence[Placement],
        device: str = "auto",
        wall_m: float | None = None,
    ):
        """Raises SceneError for an array that cannot be built."""
        first = instances[0].config
        self.air = Air(first.temperature_C, first.humidity_percent, first.pressure_Pa)
        self.precision: Mode = first.precision
        self.device, self.wall_m, self.serial = device, wall_m, next_serial()
        self.placements = tuple(placements)
        self.frames = tuple(placement.transform for placement in self.placements)
        self._lock = threading.Lock()
        self._field: MultiArrayField | None = None
        self.parts = tuple(one.array(place.sites) for one, place in zip(instances, placements, strict=True))
        self.impedance = density(self.air) * sound_speed(self.air) ** 2
        # The frame of the first array is the common one, so its transducers are unchanged to the last digit
        moved = [
            part if i == 0 else placed(part, *place.transform)
            for i, (part, place) in enumerate(zip(self.parts, placements, strict=True))
        ]
        self.groups = directivity_groups(moved)
        self.boards = tuple(BoardOutline.of(part) for part in self.parts)
        ends = np.cumsum([len(part) for part in self.parts]).tolist()
        self.slices = tuple(slice(end - len(part), end) for end, part in zip(ends, self.parts, strict=True))
        split = [sides_of(part.normals) for part in self.parts]
        pairs = [(part, side) for part, its in zip(moved, split, strict=True) for side in its]
        self.sides = [own.start + side for own, its in zip(self.slices, split, strict=True) for side in its]
        self.corners: Float = np.concatenate([corners_of(part.positions[side]) for part, side in pairs])
        facing = np.array([part.normals[side].mean(axis=0) for part, side in pairs])
        middles = np.array([part.positions[side].mean(axis=0) for part, side in pairs])
        self.facing, self.heights = np.ascontiguousarray(facing.T), (middles * facing).sum(axis=1)
        self.images = () if wall_m is None else self._images(wall_m, facing[0])
        if len(self.groups) > 1:
            widest = max(part.piston_radius_m for part in moved)
            moved = [replace(FORMS["piston"].of(part), piston_radius_m=widest) for part in moved]
        self.array = moved[0] if len(moved) == 1 else combined(moved)

    def __len__(self) -> int:
        """Return the number of transducers of all arrays."""
        return len(self.array)

    @property
    def field(self) -> MultiArrayField:
        """Field kernels for these arrays; made at first use.

        Raises PalmfieldError for a device that is not on this machine.
        """
        # Made only once, because callers compare fields by identity
        with self._lock:
            if self._field is None:
                groups = self.groups + self.images
                self._field = MultiArrayField(groups, self.air, self.device, self.precision)
            return self._field

    def pressure64(self, points: Float, drive: Complex) -> Complex:
        """Return the peak pressure [Pa], complex (n,), at points [m], (n, 3), in float64 on the CPU, without echoes.

        drive: complex amplitudes of all transducers, 1 is full drive, shape (len(self),)
        """
        return _sum64(self.groups, points, drive, self.air)

    def with_echoes64(self, points: Float, drive: Complex) -> Complex:
        """Return `pressure64` with the multiple reflections, as in `field`."""
        return _sum64(self.groups + self.images, points, drive, self.air)

    def _images(self, wall_m: float, outward: Float) -> tuple[DirectivityGroup, ...]:
        from palmfield.acoustics.echo import image_shifts

        shifts = image_shifts(self.air, self.groups[0].array.frequency_Hz, wall_m, outward)
        return tuple(
            DirectivityGroup(replace(group.array, positions=group.array.positions + shift), group.chosen)
            for shift in shifts
            for group in self.groups
        )

    def same(self, placements: Sequence[Placement]) -> bool:
        """Return whether placements equal those of this object to a nanometre and a nanoradian."""
        placements = tuple(placements)
        return placements == self.placements or all(
            same_place(a, b) for a, b in zip(self.placements, placements, strict=True)
        )


def _sum64(groups: Sequence[DirectivityGroup], points: Float, drive: Complex, air: Air) -> Complex:
    total: Complex = np.zeros(len(points), complex)
    for group in groups:
        total += pressure64(points, group.array, drive[group.chosen], air)[0]
    return total


def same_place(one: Placement, other: Placement) -> bool:
    """Return whether two placements of an array agree to SAME_PLACE."""
    pairs = ((one.position, other.position), (one.rotation, other.rotation), (one.sites, other.sites))
    return one == other or all(np.allclose(a, b, rtol=0.0, atol=SAME_PLACE) for a, b in pairs)


def only(array: Array, chosen: NDArray[np.bool_] | Int) -> Array:
    """Return the chosen transducers of an array; chosen: numbers or a mask, shape (n,)."""
    return replace(
        array,
        positions=array.positions[chosen],
        normals=array.normals[chosen],
        address=None if array.address is None else array.address[chosen],
        gain=None if array.gain is None else array.gain[chosen],
    )
