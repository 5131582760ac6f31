"""Radiation pressure at a constant number of points, for the steps of a simulation."""

import cmath
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import warp as wp

import warp_kernels.arp as kernels
from palmfield.acoustics import check
from palmfield.acoustics.air import sound_speed
from palmfield.acoustics.arp import ArpLaw, SurfaceSound, law_weights
from palmfield.acoustics.field import FieldEvaluator, scratch, shared_out
from palmfield.acoustics.phased_array import DirectivityGroup, MultiArrayField
from palmfield.device import SharedArray, filled, recorded
from palmfield.errors import PalmfieldError
from palmfield.threads import Calls, cores, share
from palmfield.types import Complex, Float, Float32, Int
from warp_kernels.gradient import MOST
from warp_kernels.pressure import BLOCK

MATRIX_FROM = 128
"""Number of drives from which a transfer matrix is used. With 256 transducers, 762 points and one core, 128 drives take
15 ms with a new matrix and without one; 32 take 8.5 ms with a new matrix, 3.7 ms with a stored one and 3.6 ms without.
The choice depends only on the number of drives, so that runs repeat to the bit."""
RANGES_KEPT = 64
MATRIX_KEPT_BYTES = 2**26
"""Largest transfer matrix that is stored for the next call with the same points."""


class Shades(NamedTuple):
    """Share of the sound of each transducer at each point: real and imaginary part on the device, float32.

    Shape (blocks of points, transducers as `rows_of` numbers them, points of a block).
    """

    real: Any
    imag: Any


def rows_of(field: MultiArrayField) -> Int:
    """Return the row of each transducer in `Shades`, shape (field.count,)."""
    rows: Int = np.empty(field.count, np.int32)
    order = [group.chosen[one.order] for group, one in zip(field.groups, field.evaluators, strict=True)]
    rows[np.concatenate(order)] = np.arange(field.count)
    return rows


class SurfaceArp:
    """ARP and related quantities at `count` points for successive drives, in fixed buffers with recorded launches.

    It is part of the state of one simulation and not thread-safe; on the CPU it starts threads itself.

    field: field of the arrays. count: number of points. law: law of `palmfield.acoustics.arp` or its key.
    threads: number of threads on the CPU, 1 or more; None is all cores of this process.
    """

    def __init__(self, field: MultiArrayField, count: int, law: str | ArpLaw = "default", threads: int | None = None):
        """Raises SceneError for an unknown law."""
        self.field, self.count, self.law = field, count, law
        device = field.device
        accurate = field.mode == "accurate"
        self._gpu = device != "cpu"
        self._points = SharedArray(count, wp.vec3d if accurate else wp.vec3, device)
        self._normals = SharedArray(count, wp.vec3, device)
        self._arp, self._amplitude = (SharedArray((MOST, count), wp.float32, device) for _ in range(2))
        self._flux = SharedArray(count, wp.vec3, device)
        self._sound = SurfaceSound(self._arp.host[0], self._amplitude.host[0])
        self._sound_and_flux = SurfaceSound(*self._sound[:2], self._flux.host)
        self._sounding = SharedArray(1, wp.int32, device)  # number of drives per pass
        self._fields = _fields(MOST, count, device)
        self._flat_normals = self._normals.host.reshape(-1)
        self._columns = np.empty((3, count), np.float64 if accurate else np.float32)
        self._group_drives = [_GroupDrive(*pair) for pair in zip(field.groups, field.evaluators, strict=True)]
        most = cores() if threads is None else threads
        self._threads, self._blocks = shared_out(field.evaluators[0], count, field.count, most)
        self._recorded: dict[tuple[str, ...], list[Calls]] = {}
        self._shaded: dict[tuple[str, ...], list[Calls]] = {}
        self._shades: Any = None
        self._sums: dict[tuple[tuple[str, ...], tuple[int, int]], _Sums] = {}
        self._transfer: Any = None
        self._weights = law_weights(law, field.air)
        self._per_wavenumber = sound_speed(field.air) / (2.0 * np.pi * field.groups[0].array.frequency_Hz)

    def evaluate(
        self,
        points: Float | Float32,
        normals: Float | Float32,
        drive: Complex,
        flux: bool = False,
        shades: Shades | None = None,
    ) -> SurfaceSound:
        """Return the sound of one drive at the points, as views of buffers that the next call overwrites.

        points: [m], normals: unit outward, array frame, both of shape (count, 3).
        drive: complex amplitudes of all transducers, 1 is full drive, shape (field.count,).
        flux: whether the result has the energy flux.
        shades: share of the sound of each transducer at each point that passes bodies, None without obstacles.
        Raises PalmfieldError for other shapes and numbers that are not finite. Normals are assumed to be unit vectors.
        """
        if drive.dtype != np.complex128:
            drive = drive.astype(np.complex128)
        count = self.count
        if points.shape != (count, 3) or normals.shape != (count, 3) or drive.shape != (self.field.count,):
            raise PalmfieldError(
                f"points {points.shape}, normals {normals.shape} and drive {drive.shape}: this SurfaceArp takes "
                f"({count}, 3), ({count}, 3) and ({self.field.count},)"
            )
        if count > 0:
            self._run(points, normals, drive[None], shades=shades)
        return self._sound_and_flux if flux else self._sound

    def evaluate_sums(
        self, points: Float | Float32, normals: Float | Float32, units: Complex, levels: Complex
    ) -> Float32:
        """Return the ARP [Pa] of sums of a few drives, levels @ units, shape (m, count); each field is computed once.

        units: drives, shape (k, field.count); silent transducers cost nothing. levels: weight of each, shape (m, k).
        Raises PalmfieldError like `evaluate`, and for levels that are not finite or not of shape (m, k).
        """
        shape = self.count, 3
        if points.shape != shape or normals.shape != shape or units.shape[1:] != (self.field.count,):
            self.evaluate(points, normals, units[0])  # raises an error with the expected shapes
        if levels.ndim != 2 or levels.shape[1] != len(units) or len(units) == 0:
            raise PalmfieldError(
                f"levels {levels.shape} of units {units.shape}: give (m, k) and (k, {self.field.count}), k >= 1"
            )
        if not cmath.isfinite(np.add.reduce(levels, axis=None)):
            raise _not_finite("levels", levels)
        if self.count == 0 or len(levels) == 0:
            return np.zeros((len(levels), self.count), np.float32)
        sums = self._run(points, normals, units, levels=levels)
        assert sums is not None
        return sums.arp.host.copy()

    def _run(
        self,
        points: Float | Float32,
        normals: Float | Float32,
        drives: Complex,
        out: Float32 | None = None,
        levels: Complex | None = None,
        shades: Shades | None = None,
        amplitudes: Float32 | None = None,
    ) -> "_Sums | None":
        """Compute drives, complex128, shape (m, N), in passes of MOST.

        out: filled with the ARP; amplitudes: filled with the peak amplitudes of the pressures; shapes (m, count)
        levels: weights of sums, whose ARP is in the returned arrays
        """
        self._points.host[...] = points
        self._normals.host[...] = normals
        # By column, because reduction along short rows takes ten times as long in NumPy
        self._columns[...] = points.T
        low = np.minimum.reduce(self._columns, axis=1).tolist()
        high = np.maximum.reduce(self._columns, axis=1).tolist()
        if not math.isfinite(sum(low)) or min(low) < -check.FARTHEST_m or max(high) > check.FARTHEST_m:
            check.points(points, np.float64)  # raises an error with the invalid point
        if not cmath.isfinite(np.add.reduce(drives, axis=None)):
            raise _not_finite("drive", drives[int(check.first_bad(drives))])
        sums: _Sums | None = None
        for start in range(0, len(drives), MOST):
            part = drives[start : start + MOST]
            count = len(part)
            self._sounding.host[0] = count
            falls: tuple[str, ...] = ()
            for group in self._group_drives:
                kind, group.fall.host[...] = group.evaluator.fall(low, high, gradient=True)
                falls = (*falls, kind)
                emitted = part.take(group.chosen, axis=1)
                if group.gain is not None:
                    emitted *= group.gain
                group.amplitudes[:count] = emitted
                whole = np.logical_and.reduce(emitted, axis=None)
                group.ranges.host[...] = group.whole if whole else group.narrowed(emitted)
            if levels is not None:
                sums = self._sums.get((falls, levels.shape)) or self._record_sums(falls, *levels.shape)
                sums.levels.host[..., 0] = levels.real
                sums.levels.host[..., 1] = levels.imag
                blocks = sums.blocks[start // MOST]
            else:
                launches = self._recorded
                if shades is not None:
                    if self._shades is not shades.real:
                        self._shades, self._shaded = shades.real, {}
                    launches = self._shaded
                if falls not in launches:
                    launches[falls] = self._record(falls, shades)
                blocks = launches[falls]
            if self._gpu:
                self._run_on_gpu(blocks, count, sums)
            else:
                share(blocks, self._threads)
            if sums is not None:
                continue
            # The ARP does not show a NaN, because such a point is dark
            if not math.isfinite(np.add.reduce(self._amplitude.host[:count], axis=None)):
                raise _not_finite("normals", self._normals.host)
            if out is not None:
                out[start : start + count] = self._arp.host[:count]
            if amplitudes is not None:
                amplitudes[start : start + count] = self._amplitude.host[:count]
        if not math.isfinite(np.add.reduce(self._flat_normals)):
            raise _not_finite("normals", self._normals.host)
        return sums

    def evaluate_many(
        self,
        points: Float | Float32,
        normals: Float | Float32,
        drives: Complex,
        shades: Shades | None = None,
        amplitudes: Float32 | None = None,
    ) -> Float32:
        """Return the ARP [Pa] of many drives at the points, shape (m, count), by the faster method.

        From MATRIX_FROM drives on, the method is a transfer matrix, which is stored for the next call with the same
        points. Kernels of the field compute fewer drives, different directivities, mode "accurate" and points far
        apart.

        drives: shape (m, field.count). shades: as for `evaluate`; they exclude a matrix.
        amplitudes: array to fill with the peak amplitudes of the pressures [Pa], shape (m, count), float32.
        Raises PalmfieldError like `evaluate`, and for normals that are not unit vectors.
        """
        evaluator, frames = self.field.evaluators[0], len(drives)
        result = np.empty((frames, self.count), np.float32)
        uniform = len(self._group_drives) == 1 and self.field.mode == "fast" and shades is None
        if frames == 0 or self.count == 0:
            return result
        by_matrix = uniform and frames >= MATRIX_FROM
        transfer = self._stored_matrix(points, normals) if by_matrix else None
        if by_matrix and transfer is None:
            # Imported here, because few scenes have so many drives together
            from palmfield.acoustics.transfer import Transfer, arp_frames, matrix_bytes, memory_limit, too_steep

            by_matrix = not too_steep(evaluator, points)
        if not by_matrix:
            shape = self.count, 3
            if points.shape != shape or normals.shape != shape or drives.shape[1:] != (self.field.count,):
                self.evaluate(points, normals, drives[0])  # raises an error with the expected shapes
            exact = drives.astype(np.complex128, copy=False)
            self._run(points, normals, exact, result, shades=shades, amplitudes=amplitudes)
            return result
        if transfer is None:
            size = matrix_bytes(self.field.count, self.count)
            if size > min(MATRIX_KEPT_BYTES, memory_limit(self.field.device)):
                if amplitudes is not None:
                    self._run(points, normals, drives.astype(np.complex128, copy=False), amplitudes=amplitudes)
                result[:] = arp_frames(evaluator, points, normals, drives, self.law)
                return result
            transfer = self._transfer = Transfer(evaluator, points, normals)
        if self._gpu:
            peaks: Any = None if amplitudes is None else wp.empty(result.shape, wp.float32, self.field.device)
            result[:] = transfer.arp_on_gpu(drives, self.law, peaks).numpy()
            if amplitudes is not None:
                amplitudes[:] = peaks.numpy()
            return result
        if amplitudes is not None:
            amplitudes[:] = np.abs(transfer.pressure(drives))
        return transfer.arp(drives, self.law, out=result)

    def _stored_matrix(self, points: Float | Float32, normals: Float | Float32) -> Any:
        """Return the stored transfer matrix if it is for these points, else None."""
        last = self._transfer
        if last is None or points.shape != last.where.shape or normals.shape != last.where.shape:
            return None
        same = np.logical_and.reduce(last.where == points.astype(np.float32), axis=None)
        return last if same and np.logical_and.reduce(last.normals == normals.astype(np.float32), axis=None) else None

    def _record(self, falls: tuple[str, ...], shades: Shades | None = None) -> list[Calls]:
        """Return the launches of each block: fields of every directivity are added, then the ARP is computed."""
        blocks: list[Calls] = []
        for block in self._blocks:
            pressure, gradient = (values[:, block] for values in self._fields)
            at = filled(
                kernels.SurfacePoints(),
                count=self._sounding.array,
                pressure=pressure,
                gradient=gradient,
                normals=self._normals.array[block],
                per_wavenumber=self._per_wavenumber,
                weights=wp.vec3(*self._weights),
                arp=self._arp.array[:, block],
                amplitude=self._amplitude.array[:, block],
                flux=self._flux.array[block],
            )
            sound = recorded(kernels.surface_sound, block.stop - block.start, [at], self.field.device)
            blocks.append([*self._record_fields(falls, block, (pressure, gradient), shades), sound])
        return blocks

    def _record_sums(self, falls: tuple[str, ...], frames: int, units: int) -> "_Sums":
        """Return the launches of each block for sums, in passes of MOST units; the last pass computes the ARP."""
        device = self.field.device
        levels = SharedArray((frames, units), wp.vec2, device)
        arp = SharedArray((frames, self.count), wp.float32, device)
        fields = _fields(units, self.count, device)
        blocks: list[list[Calls]] = []
        for start in range(0, units, MOST):
            own = [tuple(values[start:, block] for values in fields) for block in self._blocks]
            blocks.append([self._record_fields(falls, *pair) for pair in zip(self._blocks, own, strict=True)])
        for i, block in enumerate(self._blocks):
            inputs = [levels.array, *(values[:, block] for values in fields), self._normals.array[block]]
            inputs += [self._per_wavenumber, wp.vec3(*self._weights), arp.array[:, block]]
            sound = recorded(kernels.arp_of_sums, block.stop - block.start, inputs, device)
            blocks[-1][i] = [*blocks[-1][i], sound]
        self._sums[falls, (frames, units)] = result = _Sums(levels, arp, blocks)
        return result

    def _run_on_gpu(self, blocks: list[Calls], drives: int, sums: "_Sums | None") -> None:
        """Run launches, with copies to and from the device, for the ARP of sums or the sound of a number of drives."""
        arrays = [self._points, self._normals, self._sounding]
        for values in arrays if sums is None else [*arrays, sums.levels]:
            values.upload()
        for group in self._group_drives:
            group.upload()
        share(blocks, 1)
        if sums is not None:
            sums.arp.download()
        else:
            for result in (self._arp, self._amplitude):
                result.download(drives * self.count)
            self._flux.download()
        wp.synchronize_stream(self.field.device)

    def _record_fields(
        self, falls: tuple[str, ...], block: slice, into: tuple[Any, Any], shades: Shades | None = None
    ) -> Calls:
        """Return launches that sum the fields of directivities at a block of points into pressures and gradients."""
        calls, row = [], 0
        room = scratch(self.field.device)
        for group, fall in zip(self._group_drives, falls, strict=True):
            adds = row > 0
            rows, row = slice(row, row + len(group.evaluator.array)), row + len(group.evaluator.array)
            weights: Sequence[Any] = (None, None)
            if shades is not None:
                weights = [values[block.start // BLOCK :, rows] for values in shades]
            inputs = [self._points.array[block], *group.inputs, self._sounding.array, adds, *into, *weights]
            inputs += [self._normals.array[block], room]
            threads = -(-(block.stop - block.start) // group.evaluator.points_per_thread)
            kernel = group.evaluator.kernel(fall, True, shades is not None, faced=True)
            calls.append(recorded(kernel, (MOST if self._gpu else 1, threads), inputs, self.field.device))
        return calls


def _fields(drives: int, points: int, device: str) -> tuple[Any, Any]:
    """Return arrays for pressures and gradients."""
    pressure: wp.array = wp.empty((drives, points), dtype=wp.vec2, device=device)
    return pressure, wp.empty((drives, points, 3), dtype=wp.vec2, device=device)


class _Sums(NamedTuple):
    """Work arrays of `evaluate_sums`: weight of each unit, ARP, and launches for passes of MOST units."""

    levels: SharedArray
    arp: SharedArray
    blocks: list[list[Calls]]


def _not_finite(name: str, values: Complex | Float | Float32) -> PalmfieldError:
    bad = check.first_bad(values)
    return PalmfieldError(f"{name}[{bad}] = {values[bad].tolist()} is not finite: correct the source of the {name}")


class _GroupDrive:
    """Transducers of one directivity as input of the kernels, for up to MOST drives per pass.

    chosen: transducer numbers in the order of the kernels; gain: gain of each, or None; whole: ranges of all drives
    amplitudes: amplitudes of drives, shape (MOST, n); fall, ranges: inputs of the kernels
    """

    def __init__(self, group: DirectivityGroup, evaluator: FieldEvaluator):
        self.evaluator = evaluator
        array, device = group.array, evaluator.device
        self.chosen = group.chosen[evaluator.order].astype(np.intp)
        self.gain = None if array.gain is None else array.gain[evaluator.order]
        vec4 = wp.vec4d if evaluator.mode == "accurate" else wp.vec4
        elements: Any = wp.array(evaluator.elements(gradient=True), dtype=vec4, device=device)
        self._drives = SharedArray((MOST, len(array)), wp.vec2, device)
        self.amplitudes = self._drives.host.view(np.complex64)[..., 0]
        self.fall = SharedArray(1, wp.vec4, device)
        self.whole = evaluator.ranges_of(MOST)
        self.ranges = SharedArray(len(self.whole), wp.vec4i, device)
        self._narrowed: dict[bytes, Int] = {}
        inputs = evaluator.inputs(elements, self._drives.array, True, self.ranges.array)
        self.inputs = [*inputs, self.fall.array]

    def narrowed(self, emitted: Complex) -> Int:
        """Return ranges without silent transducers and drives at both ends, for amplitudes (m, n)."""
        silent = (emitted == 0.0).tobytes()
        ranges = self._narrowed.get(silent)
        if ranges is not None:
            return ranges
        if len(self._narrowed) >= RANGES_KEPT:
            self._narrowed.clear()
        self._narrowed[silent] = result = np.zeros_like(self.whole)
        for ends, (first, last) in zip(result, self.whole[:, :2].tolist(), strict=True):
            drives, numbers = np.nonzero(emitted[:, first:last])
            if len(drives) > 0:
                ends[:] = first + numbers.min(), first + numbers.max() + 1, drives[0], drives[-1] + 1
        return result

    def upload(self) -> None:
        for values in (self._drives, self.fall, self.ranges):
            values.upload()
