"""Read arrays from a CSV file with one line per transducer."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palmfield.acoustics.placement import from_poses
from palmfield.errors import SceneError
from palmfield.tables import pop_columns, read_table
from palmfield.types import Array, Float

LENGTHS_m = {"m": 1.0, "mm": 1e-3}
NORMAL = ("nx", "ny", "nz")
MOST_GAIN = 2.0
"""Largest gain: transducers of one array differ by tenths; larger values are levels, which belong in p0."""
FARTHEST_m = 5.0
"""Distance from the origin of the array frame above which a position is assumed to be in another unit."""


@dataclass(frozen=True)
class TransducerTable:
    """Data of the transducers of an array in a file, in the array frame, one entry per transducer; comparable by value.

    positions: [m]; normals: emitting directions of any length; gains: amplitude relative to p0, and phase as in
    `palmfield.types.Array`; addresses: addresses in the byte order of the board, None if not in the file.
    """

    positions: tuple[tuple[float, ...], ...]
    normals: tuple[tuple[float, ...], ...]
    gains: tuple[complex, ...] | None
    addresses: tuple[int, ...] | None

    def array(self, p0_Pa_m: float) -> Array:
        """Return the array. Raises SceneError like `palmfield.acoustics.placement.from_poses`."""
        address = None if self.addresses is None else np.array(self.addresses, np.int32)
        gain = None if self.gains is None else np.array(self.gains)
        return from_poses("csv", self.positions, self.normals, p0_Pa_m, address=address, gain=gain)


def read_transducers(path: str | Path) -> TransducerTable:
    """Read the transducers from a CSV file with a line of column names.

    Columns: x_m, y_m, z_m or x_mm, y_mm, z_mm. Optional: emitting direction nx, ny, nz (default z); gain (amplitude
    relative to p0, -2 to 2; 0 is dead, -1 inverted); phase_deg; address, the number in the byte order of the board.
    Raises SceneError for a file that cannot be read, for a missing, unknown or repeated column, and for two transducers
    at one position; with line and column for text, NaN, a direction of length 0, gains beyond 2, and addresses that are
    not 0 to n - 1.
    """
    file = Path(path)
    columns, places = read_table(file)
    if not places:
        raise SceneError(f"{file}: the file has no transducers; give one line for each")
    units = [unit for unit in LENGTHS_m if any(f"{axis}_{unit}" in columns for axis in "xyz")]
    if len(units) != 1:
        raise SceneError(f"{file}: columns are {', '.join(columns)}; give x_m, y_m, z_m or x_mm, y_mm, z_mm")
    coordinates = [f"{axis}_{units[0]}" for axis in "xyz"]
    positions = pop_columns(file, columns, coordinates) * LENGTHS_m[units[0]]
    _check_places(file, positions, places)
    normals = np.tile([0.0, 0.0, 1.0], (len(places), 1))
    if any(name in columns for name in NORMAL):
        normals = pop_columns(file, columns, NORMAL)
        lengths = np.linalg.norm(normals, axis=1)
        if lengths.min() < 1e-6:
            n = int(np.argmin(lengths))
            raise SceneError(
                f"{file}: {places[n]}, columns nx to nz: the vector has length {lengths[n]:g}; give a direction "
                "other than 0"
            )
    gains = None
    if "gain" in columns or "phase_deg" in columns:
        sizes, phases = (
            columns.pop(name, np.full(len(places), like)) for name, like in (("gain", 1.0), ("phase_deg", 0))
        )
        loudest = int(np.argmax(np.abs(sizes)))
        if abs(sizes[loudest]) > MOST_GAIN:
            raise SceneError(
                f"{file}: {places[loudest]}, column gain: {sizes[loudest]:g}; allowed: {-MOST_GAIN:g} to "
                f"{MOST_GAIN:g}, relative to p0, which sets the level",
                mends=("p0_Pa_m",),
            )
        gains = tuple((sizes * np.exp(1j * np.radians(phases))).tolist())
    addresses = None
    if "address" in columns:
        numbers = columns.pop("address")
        if not np.array_equal(np.sort(numbers), np.arange(len(numbers))):
            raise SceneError(f"{file}: column address must hold each number from 0 to {len(numbers) - 1} once")
        addresses = tuple(int(number) for number in numbers)
    if columns:
        raise SceneError(
            f"{file}: column '{next(iter(columns))}' is unknown; allowed: x_m, y_m, z_m (or _mm), nx, ny, nz, gain, "
            "phase_deg, address"
        )
    return TransducerTable(_rows(positions), _rows(normals), gains, addresses)


def _check_places(file: Path, positions: Float, places: list[str]) -> None:
    far = np.linalg.norm(positions, axis=1)
    if far.max() > FARTHEST_m:
        n = int(np.argmax(far))
        raise SceneError(
            f"{file}: {places[n]}: {far[n]:g} m from the origin of the array frame; allowed: at most "
            f"{FARTHEST_m:g} m (columns x_mm, y_mm, z_mm hold millimetres)"
        )
    _, first, counts = np.unique(positions, axis=0, return_index=True, return_counts=True)
    if counts.max() > 1:
        n = int(first[np.argmax(counts)])
        raise SceneError(
            f"{file}: {places[n]}: another transducer has the same position {positions[n].tolist()} m; give each "
            "its own"
        )


def _rows(table: Float) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in table.tolist())
