"""Read designs from the command line and from tables."""

import csv
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from palmfield.errors import SceneError, naming, reason_of
from palmfield.files import regular
from palmfield.studies.sweeps.design import Design, Range, Value, check_range, grid, listed, random, sobol

FORMS = (
    "KEY=a:b:n (n numbers from a to b), KEY=a:b:n:log (logarithmic spacing), KEY=v1,v2,..., KEY=value (the same "
    "for all points) or KEY= (removed)"
)
DRAWN_FORMS = "KEY=a:b, KEY=a:b:log, KEY=v1,v2,... (one of them), KEY=value (the same for all points) or KEY= (removed)"


def read_design(
    settings: Sequence[str],
    *,
    random_points: int | None = None,
    sobol_points: int | None = None,
    table: Path | None = None,
    seed: int = 0,
) -> tuple[Design, dict[str, Value | None]]:
    """Parse the design and the shared keys from texts such as `stimulus.am_frequency_Hz=50:300:6`.

    A shared key with value None is removed from the scene.

    settings: KEY=VALUES, in one of FORMS; with random_points or sobol_points in one of DRAWN_FORMS
    table: CSV file with keys in its first line and a row for each point; settings then define the shared keys
    Raises SceneError for an invalid text, an empty range, a repeated key, or several kinds of design at once.
    """
    kinds = [random_points is not None, sobol_points is not None, table is not None]
    if sum(kinds) > 1:
        raise SceneError("--random, --sobol and --list exclude each other; give one of them")
    drawn = random_points is not None or sobol_points is not None
    swept: dict[str, Range | list[Value]] = {}
    fixed: dict[str, Value | None] = {}
    for text in settings:
        key, equals, values = text.partition("=")
        key, values = key.strip(), values.strip()
        if not equals or not key:
            raise SceneError(f"--set {text} has no values; write {DRAWN_FORMS if drawn else FORMS}")
        if key in swept or key in fixed:
            raise SceneError(f"--set {text}: key '{key}' is given twice; give each key once")
        span = _values(key, values, drawn) if values else None
        if isinstance(span, list | Range):
            swept[key] = span
        else:
            fixed[key] = span
    if table is not None:
        if swept:
            raise SceneError(
                f"--set {next(iter(swept))} has several values, but --list already gives the points; "
                "give one of the two"
            )
        return _read_table(table, fixed), fixed
    if random_points is not None:
        return random(swept, random_points, seed), fixed
    if sobol_points is not None:
        return sobol(swept, sobol_points, seed), fixed
    if not swept:
        raise SceneError(f"the sweep has no values; give --set with several values: {FORMS}")
    return grid({key: span for key, span in swept.items() if not isinstance(span, Range)}), fixed


def _values(key: str, text: str, drawn: bool) -> list[Value] | Range | Value:
    """Parse a text: several values, a range for random values, or one value."""
    parts = text.split(":")
    logarithmic = len(parts) > 2 and parts[-1] == "log"
    numbers = parts[:-1] if logarithmic else parts
    if len(numbers) > 1:
        return _range(key, text, numbers, logarithmic, drawn)
    if "," in text:
        words = [word.strip() for word in text.split(",")]
        if not all(words):
            raise SceneError(f"--set {key}={text} has an empty value between commas; write {FORMS}")
        return [_number(word) for word in words]
    return _number(text)


def _range(key: str, text: str, parts: list[str], logarithmic: bool, drawn: bool) -> list[Value] | Range:
    forms = DRAWN_FORMS if drawn else FORMS
    if len(parts) != (2 if drawn else 3):
        raise SceneError(f"--set {key}={text} is not a range; write {forms}")
    try:
        low, high = float(parts[0]), float(parts[1])
        count = 2 if drawn else int(parts[2])
    except ValueError:
        raise SceneError(f"--set {key}={text} is not a range of numbers; write {forms}") from None
    if count < 1:
        raise SceneError(f"--set {key}={text} is empty: it has {count} values; allowed: at least 1")
    if count == 1 and low == high:
        return [low]
    span = Range(low, high, logarithmic)
    check_range(key, span)
    if drawn:
        return span
    values = np.geomspace(low, high, count) if logarithmic else np.linspace(low, high, count)
    # Rounded, because 0.1 + 0.2 would be labelled 0.30000000000000004
    return [float(f"{value:.12g}") for value in values]


def _number(word: str) -> Value:
    """Parse a number, or numbers separated by spaces as a vector. Other text is returned unchanged."""
    try:
        parts = tuple(float(part) for part in word.split())
    except ValueError:
        return word
    return parts[0] if len(parts) == 1 else parts


def _read_table(path: Path, fixed: dict[str, Value | None]) -> Design:
    """Read the points of a CSV file. Raises SceneError if it cannot be read or is not a table."""
    try:
        with regular(path).open(newline="", encoding="utf-8-sig") as file:
            rows = [row for row in csv.reader(file, skipinitialspace=True) if any(cell.strip() for cell in row)]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise SceneError(f"--list {path} cannot be read: {reason_of(error)}") from None
    if len(rows) < 2:
        raise SceneError(f"--list {path} has {len(rows)} lines; allowed: a line of keys, then a line for each point")
    head = [cell.strip() for cell in rows[0]]
    twice = next((key for key, count in Counter(head).items() if count > 1 or key in fixed), None)
    if twice is not None:
        raise SceneError(f"--list {path}: key '{twice}' is given twice; give each key once")
    for number, row in enumerate(rows[1:], start=2):
        if len(row) != len(head) or not all(cell.strip() for cell in row):
            filled = sum(1 for cell in row if cell.strip())
            raise SceneError(
                f"--list {path}: line {number} has {filled} values for {len(head)} keys; give each a value"
            )
    columns = zip(*rows[1:], strict=True)
    with naming(f"--list {path}"):
        return listed({key: [_number(cell.strip()) for cell in one] for key, one in zip(head, columns, strict=True)})
