"""Logs of the data sent to a board, with times, as text. A log can be read while it is written, and sent again.

The first line is a JSON object: `palmfield_log` (1, the version), `board`, `keys` (of palmfield.driver), `transducers`,
`array`, `layout_version` (name and version of the layout), `air` (temperature_C, humidity_percent, pressure_Pa),
`limits` (keys of palmfield.driver about level and duration of sound), `p0_Pa_m` and `p0_high_Pa_m` (p0 of the first
array, and upper end of its range). If the first array differs from its layout, there are also `positions_m` (places of
its transducers), `turns_rad` (phase that each transducer adds to its command), and `address` (places of all transducers
in the byte order of the board). Null means the value of the layout. Each further line is a JSON object of one piece of
bytes: `t`, time at which the port received its first byte [s, since the link was opened]; `hex`, the bytes; `cut`, if
the number of sent bytes is unknown after a write timeout.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from palmfield.acoustics.arrays import LAYOUTS, layout, layout_of_version
from palmfield.config import DriverConfig
from palmfield.drive.board import Board
from palmfield.drive.boards import board_of
from palmfield.drive.log_lines import log_line
from palmfield.errors import SceneError
from palmfield.files import plain, read_text, reading, regular, writing
from palmfield.types import Air, Array, Complex, Float

VERSION = 1


@dataclass(frozen=True)
class LogHead:
    """Description of the board of a log; None means the value of the layout.

    keys: keys of palmfield.driver, without `board`; array: name of the layout, csv for places from a file
    limits: SAFETY_KEYS of palmfield.driver that are set
    p0_Pa_m, p0_high_Pa_m: p0 of the transducers of the first array, and upper end of its range
    turns_rad: phases that its transducers add to their command (polarity, delays) [rad], shape (n,)
    positions_m: positions of its transducers, array frame, shape (n, 3)
    address: place of each transducer of all arrays in the byte order of the board"""

    board: str
    transducers: int
    array: str
    air: Air = field(default_factory=Air)
    keys: Mapping[str, Any] = field(default_factory=dict)
    limits: Mapping[str, Any] = field(default_factory=dict)
    p0_Pa_m: float | None = None
    p0_high_Pa_m: float | None = None
    turns_rad: Sequence[float] | None = None
    positions_m: Sequence[Sequence[float]] | None = None
    address: Sequence[int] | None = None

    def measured(self, array: Array, places: Sequence[int] = ()) -> "LogHead":
        """Return the head with calibration data of the transducers of the first array; places: as in `Board`."""
        plain, own = self._layout, list(places) or list(range(self.transducers))
        turns = None if array.gain is None else np.angle(array.gain).round(6).tolist()
        same = plain is not None and np.array_equal(array.positions, plain.positions)
        moved = None if same else array.positions.round(9).tolist()
        address = None if own == self._address else own
        return replace(self, turns_rad=turns, positions_m=moved, address=address)

    @property
    def _layout(self) -> Array | None:
        """Array of the layout; None if places come from a file."""
        return None if self.array == "csv" else layout(self.array)

    @property
    def _address(self) -> list[int]:
        """Addresses of all transducers in the order of the layout."""
        plain = self._layout
        if plain is None or plain.address is None or len(plain) != self.transducers:
            return list(range(self.transducers))
        return list(map(int, plain.address))

    @property
    def elements(self) -> tuple[Float, Complex]:
        """Places of the transducers of the first array [m], shape (n, 3), and the phase factor of each, shape (n,)."""
        plain = self._layout
        if self.positions_m is not None:
            places = np.array(self.positions_m, float)
        elif plain is not None:
            places = plain.positions
        else:
            raise ValueError("array csv needs positions_m")
        count = len(places) if plain is None else len(plain)
        turns = np.zeros(count) if self.turns_rad is None else np.array(self.turns_rad, float)
        if places.shape != (count, 3) or turns.shape != (count,) or count > self.transducers:
            raise ValueError(
                f"positions_m and turns_rad have shapes {places.shape} and {turns.shape} for {count} transducers"
            )
        return places, np.exp(1j * turns)

    @property
    def playable(self) -> Board:
        """Board of this log. Raises DeviceError for an unknown board."""
        driver = DriverConfig.model_validate({"board": self.board, **self.keys})
        return board_of(driver, self.transducers, address=self._address if self.address is None else self.address)


class Piece(NamedTuple):
    """Bytes sent together. time_s: when the port received the first byte [s]; whole: False if some may be missing"""

    time_s: float
    data: bytes
    whole: bool = True


class FrameLog:
    """Writer of a log, line by line."""

    def __init__(self, path: str | Path, head: LogHead) -> None:
        """Raises OutputError if the file cannot be made."""
        self.path = Path(path)
        with writing(self.path):
            self._file = self.path.open("w", encoding="utf-8", buffering=1)
        header = {key: value for key, value in asdict(head).items() if value is not None}
        header["layout_version"] = LAYOUTS[head.array].version if head.array in LAYOUTS else 1
        self._write(json.dumps({"palmfield_log": VERSION, **header}) + "\n")

    def add(self, time_s: float, data: bytes, *, whole: bool = True) -> None:
        """Add the bytes that were sent at a time. Raises OutputError if writing fails."""
        self._write(log_line(time_s, data, whole=whole))

    def _write(self, line: str) -> None:
        with writing(self.path):
            self._file.write(line)

    def close(self) -> None:
        with writing(self.path):
            self._file.close()


def read_log(path: str | Path) -> tuple[LogHead, list[Piece]]:
    """Read a log; its last line may be incomplete, as it is during writing.

    Raises SceneError for a file that cannot be read, or is not a log of this version.
    """
    file = Path(path)
    with reading(file, SceneError, "a file of --log, or --board for raw bytes"):
        lines = read_text(file).split("\n")
    try:
        head = plain(json.loads, lines[0])
        version = head.pop("palmfield_log")
        if version != VERSION:
            raise SceneError(f"{file} is a log of version {version}; allowed: {VERSION}")
        air = Air(**head.pop("air"))
        head["array"] = layout_of_version(head["array"], head.pop("layout_version", 1))
        read = LogHead(air=air, **head)
        _ = read.elements
        if read.address is not None and sorted(read.address) != list(range(read.transducers)):
            raise ValueError(f"address must hold each number from 0 to {read.transducers - 1} once")
        return read, list(_pieces(lines[1:]))
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise SceneError(
            f"{file} is not a log of frames: {error}; give a file of --log, or --board for raw bytes"
        ) from None


def _pieces(lines: list[str]) -> Iterator[Piece]:
    for number, line in enumerate(lines):
        if not line:
            continue
        try:
            value = plain(json.loads, line)
        except ValueError:
            if number == len(lines) - 1:
                return
            raise
        yield Piece(float(value["t"]), bytes.fromhex(value["hex"]), not value.get("cut", False))


def is_log(path: str | Path) -> bool:
    """Return whether a file begins like a log."""
    try:
        with regular(path).open("rb") as file:
            return file.read(16).startswith(b'{"palmfield_log"')
    except OSError:
        return False
