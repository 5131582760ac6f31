"""ARP of several drives at points on the device, in launches for a captured graph.

Points, drives and ARP are arrays on the device, shared with other kernels. `palmfield.acoustics.surface_arp` has NumPy
arrays instead.
"""

import functools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import warp as wp
from numpy.typing import NDArray

from palmfield.acoustics.air import absorption_Np_m, sound_speed
from palmfield.acoustics.arp import ArpLaw, law_weights
from palmfield.acoustics.field import off_axis
from palmfield.acoustics.phased_array import PhasedArray
from palmfield.acoustics.shadow import CLEARANCE_m, REACH_m
from palmfield.acoustics.surface_arp import Shades
from palmfield.device import SharedArray, filled, launch
from palmfield.threads import Calls
from palmfield.types import Complex, Int

if TYPE_CHECKING:
    from palmfield.acoustics.knife_edge import Emitters
from warp_kernels import point_sound as kernels
from warp_kernels.pressure import vec6

THREADS_ENOUGH = 2**18
"""Number of threads that fills a GPU; for fewer points and drives the transducers are divided as well."""
SHORTEST_RUN = 32
"""Smallest number of transducers per thread."""
ROWS = 5
"""Drives per thread if there are more than two; the cost per pair of transducer and point is then shared."""


class Transducers:
    """The transducers of the arrays of a scene on a device, sorted by directivity.

    arrays: arrays in their present pose. device: as returned by `palmfield.device.resolve`.
    order: transducer numbers in the order of the kernels. scale: strength at full drive in that order [Pa m].
    On the device: places: positions [m] and directions, shapes (count,), four numbers each; corners: corners of the
    box of the transducers of each side [m], shape (8 sides,); boards: mean direction of each array and height of its
    centre along it [m], shape (parts,).
    """

    def __init__(self, arrays: PhasedArray, device: str):
        self.device, self.count = device, len(arrays)
        self._places = SharedArray(self.count, wp.vec4, device)
        self._facing = SharedArray(self.count, wp.vec4, device)
        self._boards = SharedArray(len(arrays.sides), wp.vec4, device)
        self._corners = SharedArray(len(arrays.corners), wp.vec3, device)
        self.places: tuple[Any, Any] = (self._places.array, self._facing.array)
        self.corners, self.boards = self._corners.array, self._boards.array
        self.order = np.concatenate([group.chosen for group in arrays.groups])
        self._sorted = bool((self.order == np.arange(self.count)).all())
        self.scale = np.ones(self.count, np.complex128)
        self.groups: list[tuple[slice, Any, Any]] = []
        start = 0
        for group in arrays.groups:
            array, own = group.array, slice(start, start + len(group.chosen))
            wavenumber = 2.0 * np.pi * array.frequency_Hz / sound_speed(arrays.air)
            waves = filled(
                kernels.Waves(),
                turns_per_m=wavenumber / (2.0 * np.pi),
                absorption_Np_m=absorption_Np_m(arrays.air, array.frequency_Hz),
                per_wavenumber=1.0 / wavenumber,
            )
            directivity, slope, _ = off_axis(array, wavenumber)
            shapes = np.array([directivity, slope / wavenumber], np.float32)
            self.groups.append((own, waves, wp.array(shapes, dtype=vec6, device=device)))
            self.scale[own] = array.p0_Pa_m if array.gain is None else array.p0_Pa_m * array.gain
            start = own.stop
        self._arrays = arrays
        self._emitters: Emitters | None = None
        self.move(arrays)

    @property
    def emitters(self) -> "Emitters":
        """The same transducers as input of the shadow weights; made at first use, and moved by `move`."""
        from palmfield.acoustics.knife_edge import Emitters

        if self._emitters is None:
            self._emitters = Emitters(self._arrays, self._rows, self.device)
        return self._emitters

    @property
    def _rows(self) -> Int:
        """Return the position of each transducer in `order`."""
        return np.argsort(self.order).astype(np.int32)

    def move(self, arrays: PhasedArray) -> None:
        """Set new positions of the same transducers."""
        self._arrays = arrays
        if self._emitters is not None:
            self._emitters.move(arrays, self._rows)
        rows = np.zeros((2, self.count, 4))
        boards = np.column_stack([arrays.facing.T, arrays.heights])
        for (own, _, _), group in zip(self.groups, arrays.groups, strict=True):
            rows[0, own, :3], rows[1, own, :3] = group.array.positions, group.array.normals
        for shared, values in ((self._places, rows[0]), (self._facing, rows[1]), (self._boards, boards)):
            shared.put(values)
        self._corners.put(arrays.corners)

    def strengths(self, amplitudes: Complex) -> Complex:
        """Return the strengths for kernels [Pa m] of amplitudes relative to full drive, both of shape (k, count)."""
        return self.scale * (amplitudes if self._sorted else amplitudes[:, self.order])


class DriveTable(NamedTuple):
    """Active drives in each of w worlds, and sums of drives, on the device.

    counts: numbers of drives and sums in use, int32, shape (w, 2). drives: [Pa m], vec2, shape (w k, transducers).
    levels: weight of each drive in each sum, vec2, shape (w m, k).
    """

    counts: Any
    drives: Any
    levels: Any

    @staticmethod
    def parts(drives: int, sums: int, transducers: int, worlds: int = 1) -> dict[str, tuple[tuple[int, ...], Any]]:
        """Return shapes and types for a `SharedBlock`; drives and sums: largest numbers."""
        rows = drives if drives <= 2 else -(-drives // ROWS) * ROWS
        return {
            "counts": ((worlds, 2), wp.int32),
            "drives": ((worlds * rows, transducers), wp.vec2),
            "levels": ((worlds * sums, rows), wp.vec2),
        }


def fill_table(
    hosts: tuple[NDArray[Any], NDArray[Any], NDArray[Any]], strengths: Complex, levels: Complex | None
) -> None:
    """Write drives and sums of one world into the NumPy views of its table: counts, drives and levels.

    strengths: as returned by `Transducers.strengths`, shape (k, n); levels: shape (m, k), None for single drives
    """
    counts, drives, weights = hosts
    k = len(strengths)
    counts[:] = k, k if levels is None else len(levels)
    drives.view(np.complex64)[:k, :, 0] = strengths
    # A thread computes several drives; those after the last must be silent
    drives[k : -(-k // ROWS) * ROWS] = 0.0
    own = weights.view(np.complex64)[..., 0]
    if levels is None:
        own[:k, :k] = _unit(k)
    else:
        own[: len(levels), :k] = levels


@functools.lru_cache(maxsize=64)
def _unit(count: int) -> NDArray[np.float64]:
    return np.eye(count)


class Surface(NamedTuple):
    """Points of one body. points: slice of all points; law: ARP law or its key; mesh: obstacles for shadows by rays, or
    None; shades: shares of the sound that pass, with diffraction, or None"""

    points: slice
    law: str | ArpLaw
    mesh: wp.Mesh | None
    shades: Shades | None = None


def sound_calls(
    transducers: Transducers,
    table: DriveTable,
    points: Any,
    normals: Any,
    surfaces: Sequence[Surface],
    arrays: PhasedArray,
    result: Any,
) -> Calls:
    """Return launches that compute the ARP [Pa] of the sums of a table at points, into `result`, shape (w m, n).

    points [m], normals: unit, outward, on the device, vec3, shape (w, n); arrays: for the air
    """
    device, count = transducers.device, points.shape[1]
    if count == 0:
        return []
    capacity, worlds = table.drives.shape[0], table.counts.shape[0]
    rows = ROWS if capacity > 2 * worlds else 1
    most = max(1, THREADS_ENOUGH * rows // (count * capacity))
    sizes = []
    for own, _, _ in transducers.groups:
        length = own.stop - own.start
        sizes.append(max(SHORTEST_RUN, -(-length // most)))
    runs = [-(-(own.stop - own.start) // size) for (own, _, _), size in zip(transducers.groups, sizes, strict=True)]
    fields: wp.array = wp.zeros((capacity, sum(runs), kernels.PARTS, count), dtype=wp.float32, device=device)
    calls = []
    run = 0
    shaded = [surface for surface in surfaces if surface.shades is not None]
    for (own, waves, shapes), size, own_runs in zip(transducers.groups, sizes, runs, strict=True):
        of_group = [*transducers.places, shapes, waves, own.start, own.stop, size, run, table.counts, table.drives]
        if len(shaded) < len(surfaces):
            kernel, dim = kernels.fields(rows, device != "cpu"), (capacity // rows, own_runs, count)
            calls.append(launch(kernel, dim, [points, normals, *of_group, None, None, fields], device))
        # These launches overwrite the fields of these points, which have no shades
        for surface in shaded:
            assert surface.shades is not None
            here, dim = surface.points, (capacity // rows, own_runs, surface.points.stop - surface.points.start)
            kernel = kernels.fields(rows, device != "cpu", shaded=True)
            inputs = [points[:, here], normals[:, here], *of_group, *surface.shades, fields[:, :, :, here]]
            calls.append(launch(kernel, dim, inputs, device))
        run += own_runs
    for surface in surfaces:
        own, sums = surface.points, table.levels.shape[0]
        inputs = [points[:, own], normals[:, own], table.counts, table.levels, fields[:, :, :, own]]
        inputs += [wp.vec3(*law_weights(surface.law, arrays.air)), wp.uint64(surface.mesh.id if surface.mesh else 0)]
        inputs += [transducers.boards, CLEARANCE_m, REACH_m, result[:, own]]
        calls.append(launch(kernels.arp_of_sums, (sums, own.stop - own.start), inputs, device))
    return calls
