"""ARP at fixed points for drives in a space of few dimensions, as of a focus on a predicted path."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from palmfield import cache
from palmfield.acoustics.air import sound_speed
from palmfield.acoustics.arp import ArpLaw, law_weights, unit_normals
from palmfield.acoustics.groups import axes
from palmfield.acoustics.phased_array import MultiArrayField
from palmfield.device import recorded
from palmfield.threads import Calls, cores, share
from palmfield.types import Complex, Float, Float32
from warp_kernels import transfer as kernels

OUT_OF_SPAN = 1e-6
"""Largest norm of a drive outside the span, relative to the largest drive; less than the float32 error of the field."""
LEFT_OUT = 1e-7
"""Smallest singular value in the span, relative to the largest one of the drives of a path."""
MOST_SHARE = 0.75
"""Largest dimension of the span over the number of transducers; larger spans save little work for their memory."""
NUMBERS_PER_THREAD = 1_000_000
"""Smallest number of field values per thread."""


def drives_span(drives: Complex) -> Complex | None:
    """Return V, shape (N, r), with orthonormal columns and drives = (drives @ V) V^H for drives (m, N); None if r is
    not small."""
    _, values, rows = np.linalg.svd(drives, full_matrices=False)
    count = int(np.count_nonzero(values > LEFT_OUT * values[0])) if len(values) else 0
    return np.ascontiguousarray(rows[:count].conj().T) if 0 < count <= MOST_SHARE * drives.shape[1] else None


@dataclass(frozen=True)
class SpannedFields:
    """Fields of the rows of V^H at points. Immutable, so threads can share it.

    basis: V of `drives_span`, shape (N, r); weights: weights of the ARP law; count: number of points
    fields: values as in `warp_kernels.transfer.matrix`, shape (blocks, r, 8)
    """

    basis: Complex
    weights: tuple[float, float, float]
    fields: Any
    count: int


def spanned_fields(
    field: MultiArrayField, points: Float, normals: Float, basis: Complex, law: str | ArpLaw = "default"
) -> SpannedFields:
    """Return the fields of the rows of V^H at points [m], shape (n, 3), with unit outward normals, in the array frame.

    basis: V of `drives_span`, shape (N, r)
    They are computed once, with geometry in double precision, and stored in single precision, in the cache too. Sums of
    them have less error than fields computed in single precision.
    Raises SceneError for an unknown law, PalmfieldError for bad points or normals.
    """
    outward, weights = unit_normals(normals, len(points)), law_weights(law, field.air)
    blocks, order = -(-len(points) // kernels.WIDTH), basis.shape[1]

    def make() -> cache.Arrays:
        numbers: Float32 = np.zeros((order, 8, blocks * kernels.WIDTH), np.float32)
        accurate = MultiArrayField(field.groups, field.air, field.device, "accurate")
        turns = axes(outward.astype(float))
        per_wavenumber = sound_speed(field.air) / (2.0 * np.pi * field.groups[0].array.frequency_Hz)
        for number, drive in zip(numbers, basis.conj().T, strict=True):
            sound = accurate.pressure(points, np.ascontiguousarray(drive), normals=outward)
            assert sound.gradient is not None
            along = per_wavenumber * np.einsum("nij,nj->in", turns, sound.gradient)
            rows = np.concatenate([sound.pressure[None], along])
            number[:4, : len(points)], number[4:, : len(points)] = rows.real, rows.imag
        return {"parts": numbers.reshape(order, 8, blocks, kernels.WIDTH).transpose(2, 0, 1, 3).copy()}

    parts = cache.kept("path-fields", (field.groups, field.air, field.device, points, outward, basis), make)["parts"]
    return SpannedFields(basis, weights, wp.array(parts, dtype=kernels.lanes, device="cpu"), len(points))


class SpannedArp:
    """ARP of drives in the span of some fields. It is part of the state of one simulation and not thread-safe; on the
    CPU it starts threads itself."""

    def __init__(self, fields: SpannedFields):
        self.fields = fields
        self._back: Complex = np.ascontiguousarray(fields.basis.conj())
        self._rooms: dict[int, tuple[Float32, Float32, list[Calls], int]] = {}

    def evaluate(self, drives: Complex) -> Float32 | None:
        """Return the ARP [Pa], shape (m, n), of drives (m, N); None if a drive is outside the span.

        The result is a view of a buffer that the next call with as many drives overwrites.
        """
        shares = drives @ self.fields.basis
        rest = drives - shares @ self._back.T
        if np.maximum.reduce(_squares(rest)) > OUT_OF_SPAN**2 * np.maximum.reduce(_squares(drives)):
            return None
        room = self._rooms.get(len(drives)) or self._new_room(len(drives))
        share_parts, result, blocks, threads = room
        share_parts[..., 0], share_parts[..., 1] = shares.real, shares.imag
        share(blocks, threads)
        return result

    def _new_room(self, count: int) -> tuple[Float32, Float32, list[Calls], int]:
        parts = self.fields.fields
        blocks, order, _ = parts.shape
        share_parts: Any = wp.zeros((count, order), dtype=wp.vec2, device="cpu")
        result: Any = wp.zeros((count, blocks), dtype=kernels.lanes, device="cpu")
        threads = max(1, min(cores(), count * parts.size * kernels.WIDTH // NUMBERS_PER_THREAD))
        size = max(-(-blocks // (1 if threads == 1 else 4 * threads)), 1)
        calls: list[Calls] = []
        for first in range(0, blocks, size):
            own = slice(first, min(first + size, blocks))
            inputs = [parts[own], share_parts, wp.vec3(*self.fields.weights), result[:, own]]
            launch: Callable[[], object] = recorded(kernels.arp_in_span, own.stop - own.start, inputs, "cpu")
            calls.append((launch,))
        view = result.numpy().reshape(count, -1)[:, : self.fields.count]
        room = self._rooms[count] = share_parts.numpy(), view, calls, threads
        return room


def _squares(rows: Complex) -> Float:
    """Return the sum of |a|^2 of each row."""
    return np.asarray(np.add.reduce(rows.real**2 + rows.imag**2, axis=1))
