"""Read waveforms of amplitude modulation from files."""

from pathlib import Path
from typing import Literal

import numpy as np

from palmfield.errors import SceneError
from palmfield.stimulus.am_table import AmTable
from palmfield.tables import read_table

MOST_ROWS = 10_000
COLUMNS: dict[str, Literal["period", "course"]] = {"turn": "period", "time_s": "course"}


def read_am_table(path: str | Path) -> AmTable:
    """Read the waveform from a CSV or NPZ file with two columns: turn and w of one period, or time_s and w of a course.

    Raises SceneError for a file that cannot be read, other columns, fewer than 2 rows or more than MOST_ROWS; with line
    and column for times that do not rise or are outside 0 <= turn < 1 or 0 <= time_s, and w outside -1..1 or always -1.
    """
    file = Path(path)
    columns, places = read_table(file)
    name = next((column for column in COLUMNS if set(columns) == {column, "w"}), None)
    if name is None:
        raise SceneError(f"{file}: columns are {', '.join(columns)}; give turn and w, or time_s and w")
    if not 2 <= len(places) <= MOST_ROWS:
        raise SceneError(f"{file}: the file has {len(places)} rows; allowed: 2 to {MOST_ROWS}")
    moments, values = columns[name], columns["w"]
    limit, words = (1.0, "0 to below 1") if name == "turn" else (np.inf, "0 or more")
    for bad, column, allowed in (
        ((moments < 0.0) | (moments >= limit), name, words),
        (np.append(False, np.diff(moments) <= 0.0), name, "more than in the line before"),
        (np.abs(values) > 1.0, "w", "-1 to 1"),
    ):
        if bad.any():
            row = int(bad.argmax())
            raise SceneError(f"{file}: {places[row]}, column {column}: {columns[column][row]:g}; allowed: {allowed}")
    if values.max() == -1.0:
        raise SceneError(f"{file}: column w: all values are -1, which is silence at full depth; give values up to 1")
    return AmTable(COLUMNS[name], tuple(moments.tolist()), tuple(values.tolist()))
