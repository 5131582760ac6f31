"""Read and write columns of numbers in CSV and NPZ files. Error messages contain line and column."""

import csv
import math
import zlib
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from zipfile import BadZipFile, is_zipfile

import numpy as np

from palmfield.errors import OutputError, PalmfieldError, SceneError, reason_of
from palmfield.files import regular, whole, writing
from palmfield.types import Float

UNREADABLE = (OSError, EOFError, ValueError, NotImplementedError, MemoryError, BadZipFile, zlib.error, csv.Error)
"""Errors that open, csv, zipfile and NumPy raise for a damaged file, and ValueError for undecodable text."""

LONGEST_NAME = 100
"""Largest number of letters of a column name."""
SEPARATORS = {";": "semicolons", "\t": "tabs"}


def read_table(file: Path, gaps: Sequence[str] = ()) -> tuple[dict[str, Float], list[str]]:
    """Return the columns of a CSV file with a header, or of an NPZ file, and the name of each row for messages.

    gaps: columns in which numbers need not be finite
    Raises SceneError for a file that cannot be read, a repeated column, and, with line (in an NPZ: row) and column, for
    text and numbers that are not finite.
    """
    try:
        if file.suffix.lower() == ".npz":
            columns, places = _npz(file)
        elif file.suffix.lower() == ".csv":
            columns, places = _csv(file)
        else:
            raise SceneError(f"{file}: the kind of the file is '{file.suffix}'; use .csv or .npz")
    except UNREADABLE as error:
        raise SceneError(f"{file}: cannot be read: {reason_of(error)}; give a CSV (UTF-8) or NPZ file") from None
    for name, values in columns.items():
        bad = np.flatnonzero(~np.isfinite(values))
        if len(bad) and name not in gaps:
            raise SceneError(f"{file}: {places[int(bad[0])]}, column {name}: {values[bad[0]]:g}; give a finite number")
    return columns, places


def pop_columns(
    file: Path, columns: dict[str, Float], names: Sequence[str], error: type[PalmfieldError] = SceneError
) -> Float:
    """Remove columns that belong together from a table and return them, shape (rows, names). Raises `error` if one is
    missing.

    file: file for messages; columns: as returned by `read_table`
    """
    missing = [name for name in names if name not in columns]
    if missing:
        together = f"{', '.join(names)} must be given together"
        raise error(f"{file}: column '{missing[0]}' is missing; {together}; columns are: {', '.join(columns)}")
    return np.stack([columns.pop(name) for name in names], axis=1)


def _npz(file: Path) -> tuple[dict[str, Float], list[str]]:
    columns: dict[str, Float] = {}
    with regular(file).open("rb") as data:
        if not is_zipfile(data):
            raise SceneError(f"{file}: is not an NPZ archive; write it by numpy.savez")
    with np.load(file, allow_pickle=False) as archive:
        for name in archive.files:
            try:
                columns[name] = np.asarray(archive[name], dtype=np.float64)
            except ValueError:
                raise SceneError(f"{file}: column {name} does not contain numbers; give numbers") from None
    shapes = {values.shape for values in columns.values()}
    if len(shapes) != 1 or len(next(iter(shapes))) != 1:
        listed = ", ".join(f"{name} {values.shape}" for name, values in columns.items())
        raise SceneError(f"{file}: arrays have shapes {listed or 'none'}; give arrays of one length, shape (rows,)")
    rows = next(iter(shapes))[0]
    return columns, [f"row {n + 1}" for n in range(rows)]


def _csv(file: Path) -> tuple[dict[str, Float], list[str]]:
    with regular(file).open(newline="", encoding="utf-8-sig") as text:
        reader = csv.reader(text)
        header = [name.strip() for name in next(reader, [])]
        _check_header(file, header)
        twice = [name for name, count in Counter(header).items() if count > 1]
        if not header or twice:
            fault = f"column '{twice[0]}' occurs twice" if twice else "the file is empty"
            raise SceneError(f"{file}: {fault}; begin with one line of different column names")
        rows, places = [], []
        for row in reader:
            if not any(cell.strip() for cell in row):
                continue
            places.append(f"line {reader.line_num}")
            rows.append(numbers_in(f"{file}: {places[-1]}", header, row, finite=False))
    table = np.array(rows, dtype=np.float64).reshape(-1, len(header))
    return {name: table[:, n] for n, name in enumerate(header)}, places


def _check_header(file: Path, header: Sequence[str]) -> None:
    """Raise SceneError for a header in the format of other programs."""
    for mark, name in SEPARATORS.items():
        if any(mark in column for column in header):
            raise SceneError(f"{file}: columns are separated by {name}; use commas between columns and decimal points")
    odd = next((name for name in header if len(name) > LONGEST_NAME or not name.isprintable()), None)
    if odd is not None:
        raise SceneError(
            f"{file}: a column name begins with {odd[:20]!r} and has {len(odd)} characters; allowed: "
            f"{LONGEST_NAME} printable characters"
        )
    if header and header[0].startswith("#"):
        raise SceneError(f"{file}: line 1 is a comment, '{header[0]}'; begin with one line of different column names")


def numbers_in(
    place: str,
    names: Sequence[str],
    cells: Sequence[str],
    error: type[PalmfieldError] = SceneError,
    *,
    finite: bool = True,
    instead: str = "give a finite number",
) -> list[float]:
    """Return the numbers in the cells of a row, one for each column name.

    place: file and line, for messages
    finite: whether to check that numbers are finite
    instead: remedy for a number that is not finite
    Raises `error`, with the column, for text and for numbers that are not finite, and for more or fewer cells.
    """
    if len(cells) != len(names):
        raise error(f"{place} has {len(cells)} values for {len(names)} columns; give one per column")
    values = []
    for name, cell in zip(names, cells, strict=True):
        try:
            values.append(float(cell))
        except ValueError:
            raise error(f"{place}, column {name}: '{cell.strip()[:40]}' is not a number; give a number") from None
        if finite and not math.isfinite(values[-1]):
            raise error(f"{place}, column {name}: {values[-1]:g}; {instead}")
    return values


def write_table(file: Path, names: Sequence[str], table: Float) -> None:
    """Write columns of numbers, shape (rows, names), to a CSV or NPZ file, which `read_table` reads unchanged.

    Raises OutputError for an unknown suffix and for a file that cannot be written.
    """
    if file.suffix.lower() not in (".csv", ".npz"):
        raise OutputError(f"{file}: the kind of the file is '{file.suffix}'; use .csv or .npz")
    with writing(file), whole(file) as part:
        if file.suffix.lower() == ".npz":
            with part.open("wb") as data:
                # Without allow_pickle=False, which numpy below 2.2 would write as another array; numbers do not need it
                np.savez_compressed(data, **dict(zip(names, table.T, strict=True)))
        else:
            with part.open("w", newline="", encoding="utf-8") as text:
                writer = csv.writer(text)
                writer.writerow(names)
                writer.writerows(table.tolist())
