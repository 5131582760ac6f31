"""Read scans in the text format of Polytec software (PSV, VibSoft): a file for each point, in one folder.

Source File Name:   palm
Point Index:        12
Component:          Root
Signal:             Time - Vib Velocity - Samples

Time    Time Signal
[ s ]   [ m/s ]
0       -0.000201617
...

Names, values and columns are separated by tabs. Polytec has not published the format. It is taken from public programs
that read such files, and deviations give an error. The files do not give the unit of positions, so positions are read
from `places.csv` in the same folder: columns point, x_m, y_m, z_m and, if the lines of sight are available, sight_x,
sight_y, sight_z.
"""

import re
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from palmfield.errors import MeasurementError, SceneError, did_you_mean
from palmfield.files import read_bytes, reading
from palmfield.instruments.scan import SIGHTS, UNITS, Quantity, Scan
from palmfield.tables import read_table
from palmfield.types import Float

HEADINGS = ("Source File Name", "Point Index", "Component", "Signal")
QUANTITIES: dict[str, Quantity] = {"Vib Velocity": "velocity", "Vib Displacement": "displacement"}
PLACES = "places.csv"
COLUMNS = ("point", "x_m", "y_m", "z_m")
ENCODINGS = ("utf-8-sig", "cp1252")


class _Point(NamedTuple):
    number: int
    quantity: Quantity
    times_s: Float
    values: Float


def read_polytec(folder: Path) -> Scan:
    """Read a scan from a folder of text files and its table of positions.

    Raises MeasurementError for a part of a file that is not recognised, for points without a position, and for signals
    of different kinds or times.
    """
    files = sorted(folder.glob("*.txt"))
    if not files:
        raise MeasurementError(f"{folder}: contains no .txt files; give a folder of one text file for each point")
    places, sights = _places(folder / PLACES)
    points = [_point(file) for file in files]
    first = points[0]
    for file, one in zip(files, points, strict=True):
        if one.number not in places:
            raise MeasurementError(f"{file}: belongs to point {one.number}, but {PLACES} has no line for it")
        if one.quantity != first.quantity:
            raise MeasurementError(
                f"{file}: contains {one.quantity}, {files[0].name} {first.quantity}; give files of one quantity"
            )
        if one.times_s.shape != first.times_s.shape or np.abs(one.times_s - first.times_s).max() > 1e-9:
            raise MeasurementError(f"{file}: its times differ from those of {files[0].name}; give equal times")
    numbers = [one.number for one in points]
    twice = [number for number, count in Counter(numbers).items() if count > 1]
    if twice:
        raise MeasurementError(f"{folder}: point {twice[0]} has several files; give one for each point")
    return Scan(
        first.quantity, first.times_s, np.array([places[number] for number in numbers]),
        np.column_stack([one.values for one in points]),
        None if sights is None else np.array([sights[number] for number in numbers]), folder.name,
    )  # fmt: skip


def _places(file: Path) -> tuple[dict[int, Float], dict[int, Float] | None]:
    try:
        columns, _ = read_table(file)
    except SceneError as error:
        raise MeasurementError(
            f"{error} (positions of the points: columns {', '.join(COLUMNS)} and, if known, {', '.join(SIGHTS)})"
        ) from None
    with_sights = any(name in columns for name in SIGHTS)
    for name in (*COLUMNS, *(SIGHTS if with_sights else ())):
        if name not in columns:
            raise MeasurementError(f"{file}: has no column '{name}'{did_you_mean(name, columns)}")
    numbers = columns["point"]
    if not np.array_equal(numbers, np.round(numbers)) or len(np.unique(numbers)) < len(numbers):
        raise MeasurementError(f"{file}: column point must contain whole numbers, each once")

    def by_number(names: tuple[str, ...]) -> dict[int, Float]:
        table = np.column_stack([columns[name] for name in names])
        return {int(number): row for number, row in zip(numbers, table, strict=True)}

    return by_number(COLUMNS[1:]), by_number(SIGHTS) if with_sights else None


def _point(file: Path) -> _Point:
    lines = _text(file)
    heading: dict[str, str] = {}
    for at, line in enumerate(lines):
        if not line.strip():
            break
        name, colon, value = line.partition(":")
        if not colon or name.strip() not in HEADINGS:
            raise MeasurementError(
                f"{file}: line {at + 1} is '{line.strip()[:60]}'; the head has lines {', '.join(HEADINGS)} and "
                "ends with an empty line"
            )
        heading[name.strip()] = value.strip()
    else:
        raise MeasurementError(f"{file}: the empty line after the head is missing; give a Polytec text file")
    for name in ("Point Index", "Signal"):
        if name not in heading:
            raise MeasurementError(f"{file}: the head has no line '{name}:', so its {name.lower()} is unknown")
    number = re.match(r"\d+", heading["Point Index"])
    if number is None:
        raise MeasurementError(
            f"{file}: Point Index is '{heading['Point Index']}'; allowed: a text that begins with a whole number"
        )
    quantity = _quantity(file, heading["Signal"])
    table = _table(file, lines[at + 1 :], at + 2, quantity)
    return _Point(int(number.group()), quantity, table[:, 0], table[:, 1])


def _text(file: Path) -> list[str]:
    with reading(file, MeasurementError, "a text file"):
        data = read_bytes(file)
    for encoding in ENCODINGS:
        with suppress(UnicodeDecodeError):
            return data.decode(encoding).splitlines()
    raise MeasurementError(f"{file}: is not text")


def _quantity(file: Path, signal: str) -> Quantity:
    parts = [part.strip() for part in signal.split(" - ")]
    if len(parts) != 3 or parts[0] != "Time" or parts[2] != "Samples" or parts[1] not in QUANTITIES:
        raise MeasurementError(
            f"{file}: Signal is '{signal}'; allowed: samples over time along one beam: "
            + " and ".join(f"'Time - {name} - Samples'" for name in QUANTITIES)
        )
    return QUANTITIES[parts[1]]


def _table(file: Path, lines: list[str], first: int, quantity: Quantity) -> Float:
    """Return times [s] and values [m or m/s], shape (t, 2). first: number, in the file, of the first line"""
    names, units = ([cell.strip() for cell in line.split("\t")] for line in (*lines[:2], "", "")[:2])
    if len(names) != 2 or names[0] != "Time" or len(units) != 2:
        raise MeasurementError(
            f"{file}: line {first} is '{' '.join(names)[:60]}'; needed after the head: two columns, Time and the signal"
        )
    time, unit = (re.fullmatch(r"\[\s*(.*?)\s*\]", cell) for cell in units)
    kind = "" if unit is None else unit.group(1).replace("\u00b5", "u").replace("\u03bc", "u")
    if time is None or time.group(1) != "s" or kind not in UNITS[quantity]:
        raise MeasurementError(
            f"{file}: line {first + 1}: units are '{' '.join(units)}'; allowed: [ s ] and, of {quantity}, "
            + ", ".join(f"[ {name} ]" for name in UNITS[quantity])
        )
    rows = []
    for at, line in enumerate(lines[2:], first + 2):
        if not line.strip():
            continue
        cells = line.split("\t")
        try:
            rows.append([float(cells[0]), float(cells[1])])
        except (ValueError, IndexError):
            raise MeasurementError(
                f"{file}: line {at} is '{line.strip()[:40]}'; give two numbers separated by a tab, with decimal points"
            ) from None
        if len(cells) > 2 or not np.isfinite(rows[-1]).all():
            raise MeasurementError(f"{file}: line {at} is '{line.strip()[:40]}'; give two finite numbers")
    return np.array(rows, dtype=float).reshape(-1, 2) * [1.0, UNITS[quantity][kind]]
