"""Tables of foci from numbers, and their files: CSV with head lines that begin with #, a line of column names, numbers.

# palmfield_stimulus: 1
# frame: array
# rate_Hz: 1000
# quantity: arp
# units: s, m
# between: held
t,x,y,z,intensity
0.0,0.0,0.0,0.2,1.0
0.001,0.002,0.0,0.2,1.0
"""

import csv
import re
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple, cast, get_args

import numpy as np

from palmfield.config.stimulus import too_far
from palmfield.errors import SceneError, did_you_mean
from palmfield.files import read_text, reading, write_text
from palmfield.stimulus.focus_table import Between, FocusTable, Quantity, TableFrame
from palmfield.tables import numbers_in
from palmfield.types import Float

VERSION = 1
HEAD = ("palmfield_stimulus", "frame", "rate_Hz", "quantity", "units", "between")
TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
MOST_ROWS, MOST_FOCI = 1_000_000, 32
HIGHEST_RATE_HZ = 40e3
OFF_SAMPLE = 0.02
"""Largest deviation of the time of a row from a whole number of samples; it allows times with few digits."""


def focus_table(
    times_s: Float,
    positions: Float,
    intensities: Float,
    *,
    rate_Hz: float,
    frame: TableFrame = "array",
    quantity: Quantity = "arp",
    between: Between = "held",
    named: Callable[[int, str], str] = lambda row, column: f"row {row + 1}, column {column}",
) -> FocusTable:
    """Make a table from numbers.

    times_s: rising times of the rows from 0 [s], shape (n,); positions: [m], shape (n, foci, 3)
    intensities: 0..1, shape (n, foci); named: function that names a row (from 0) and a column in messages
    Raises SceneError, with row and column, for times that do not begin at 0, do not rise or are not on samples, for
    numbers that are not finite, positions too far away, intensities outside 0..1, and if all intensities are 0.
    """
    times, places = np.asarray(times_s, np.float64), np.asarray(positions, np.float64)
    loud = np.asarray(intensities, np.float64)
    count, foci = len(times), places.shape[1] if places.ndim == 3 else 0
    if not 1 <= count <= MOST_ROWS or places.shape != (count, foci, 3) or loud.shape != (count, foci):
        raise SceneError(
            f"a table has {count} times, positions of shape {places.shape} and intensities of shape {loud.shape}; "
            f"allowed: 1 to {MOST_ROWS} rows of (n,), (n, foci, 3) and (n, foci)"
        )
    if not 1 <= foci <= MOST_FOCI:
        raise SceneError(f"a table has {foci} foci; allowed: 1 to {MOST_FOCI}")
    if quantity == "duty" and foci > 1:
        raise SceneError(
            f"quantity is 'duty' with {foci} simultaneous foci, which share the pulses of the transducers; "
            "allowed: amplitude | arp"
        )
    if not 0.0 < rate_Hz <= HIGHEST_RATE_HZ:
        raise SceneError(f"rate_Hz has value {rate_Hz:g}; allowed: above 0, at most {HIGHEST_RATE_HZ:g}")
    names = _columns(foci)
    wide = np.concatenate([times[:, None], np.concatenate([places, loud[..., None]], axis=2).reshape(count, -1)], 1)
    wrong = np.argwhere(~np.isfinite(wide))
    if len(wrong):
        row, column = wrong[0]
        raise SceneError(f"{named(int(row), names[column])}: {wide[row, column]:g}; give a finite number")
    _check_times(times, rate_Hz, named)
    for row, focus in zip(*np.nonzero((loud < 0.0) | (loud > 1.0)), strict=True):
        place = named(int(row), names[4 + 4 * focus])
        raise SceneError(f"{place}: {loud[row, focus]:g}; allowed: 0 (silent) to 1 (the level of the stimulus)")
    for row, focus in zip(*np.nonzero(np.linalg.norm(places, axis=2) > 10.0), strict=True):
        axis = int(np.abs(places[row, focus]).argmax())
        x, y, z = places[row, focus].tolist()
        raise SceneError(f"{named(int(row), names[1 + 4 * focus + axis])}: a focus at {x:g} {y:g} {z:g} m, "
                         f"{too_far((x, y, z))}; or name the unit in the head line units")  # fmt: skip
    if not loud.any():
        raise SceneError(f"{named(0, names[4])}: all values are 0, which is silence; give intensities up to 1")
    wide[:, 0] = np.rint(times * rate_Hz)
    return FocusTable(frame, float(rate_Hz), quantity, between, foci, np.ascontiguousarray(wide).tobytes())


def _check_times(times: Float, rate_Hz: float, named: Callable[[int, str], str]) -> None:
    if times[0] != 0.0:
        raise SceneError(
            f"{named(0, 't')}: {times[0]:g}; the first row must be at 0: subtract {times[0]:g} from all times"
        )
    falling = np.flatnonzero(np.diff(times) <= 0.0)
    if len(falling):
        row = int(falling[0]) + 1
        raise SceneError(f"{named(row, 't')}: {times[row]:g} after {times[row - 1]:g}; allowed: rising times")
    places = times * rate_Hz
    off = np.flatnonzero(np.abs(places - np.rint(places)) > OFF_SAMPLE)
    same = np.flatnonzero(np.diff(np.rint(places)) < 1.0) + 1
    if len(off) or len(same):
        row = int(off[0] if len(off) else same[0])
        raise SceneError(
            f"{named(row, 't')}: {times[row]:.9g} s is sample {places[row]:.6g} at rate_Hz {rate_Hz:g}; allowed: "
            "whole samples of the rate in the head, one row each"
        )


def _columns(foci: int) -> list[str]:
    numbers = [""] if foci == 1 else [str(number + 1) for number in range(foci)]
    return ["t", *(f"{name}{number}" for number in numbers for name in ("x", "y", "z", "intensity"))]


# -- files ---------------------------------------------------------------------------------------------------------


class _Head(NamedTuple):
    frame: TableFrame
    rate_Hz: float
    quantity: Quantity
    between: Between
    second: float
    metre: float


def read_focus_table(path: str | Path) -> FocusTable:
    """Read a table from a CSV file in the format described in this module.

    Raises SceneError, with line and column, for a file that cannot be read, head lines that are missing, unknown or
    invalid, columns other than t and x, y, z, intensity of each focus, and the errors of `focus_table`.
    """
    file = Path(path)
    with reading(file, SceneError, "a CSV file in UTF-8"):
        lines = read_text(file, "utf-8-sig").splitlines()
    heads = [(number, line) for number, line in enumerate(lines, 1) if line.lstrip().startswith("#")]
    body = [(n, line) for n, line in enumerate(lines, 1) if line.strip() and not line.lstrip().startswith("#")]
    if not body:
        raise SceneError(f"{file}: the line of column names is missing; see the example in docs/stimuli.md")
    head, names = _head(file, heads), _names(file, *body[0])
    table = np.array([numbers_in(f"{file}: line {n}", names, next(csv.reader([line]))) for n, line in body[1:]])
    if not len(table):
        raise SceneError(f"{file}: there are no rows below line {body[0][0]}; give one or more")
    foci = (len(names) - 1) // 4
    order = [names.index(name) for name in _columns(foci)]
    own = table[:, order[1:]].reshape(len(table), foci, 4)
    # Decimal arithmetic, so that 0.003 ms or 200 mm are converted exactly
    times = _scaled(table[:, order[0]], head.second)
    return focus_table(
        times, _scaled(own[..., :3], head.metre), own[..., 3], rate_Hz=head.rate_Hz, frame=head.frame,
        quantity=head.quantity, between=head.between,
        named=lambda row, column: f"{file}: line {body[1 + row][0]}, column {column}",
    )  # fmt: skip


def _scaled(values: Float, unit: float) -> Float:
    return values if unit == 1.0 else values / round(1.0 / unit)


def _head(file: Path, lines: Sequence[tuple[int, str]]) -> _Head:
    head: dict[str, tuple[int, int, str]] = {}
    for number, line in lines:
        matched = re.match(r"\s*#\s*([A-Za-z_]+)\s*:\s*(.*?)\s*$", line)
        if matched is None:
            continue  # a comment
        name, value = matched[1], matched[2]
        if name not in HEAD:
            raise SceneError(
                f"{file}: line {number}, column {matched.start(1) + 1}: head line '{name}' is "
                f"unknown{did_you_mean(name, HEAD)}; allowed: {', '.join(HEAD)} (a comment has no colon after its "
                "first word)"
            )
        if name in head:
            raise SceneError(
                f"{file}: line {number}: head line '{name}' occurs twice, first in line {head[name][0]}; remove one"
            )
        head[name] = number, matched.start(2) + 1, value
    missing = [name for name in HEAD if name not in head]
    if missing:
        raise SceneError(f"{file}: line 1: head line '# {missing[0]}: ...' is missing; give {_allowed(missing[0])}")

    def one_of(name: str, allowed: Sequence[str]) -> str:
        if head[name][2] not in allowed:
            raise _bad(name)
        return head[name][2]

    def _bad(name: str) -> SceneError:
        number, column, value = head[name]
        return SceneError(f"{file}: line {number}, column {column}: {name} has value '{value}'; {_allowed(name)}")

    one_of("palmfield_stimulus", [str(VERSION)])
    try:
        rate_Hz = float(head["rate_Hz"][2])
    except ValueError:
        raise _bad("rate_Hz") from None
    if not 0.0 < rate_Hz <= HIGHEST_RATE_HZ:
        raise _bad("rate_Hz")
    units = [unit.strip() for unit in head["units"][2].split(",")]
    if len(units) != 2 or units[0] not in TIMES or units[1] not in LENGTHS:
        raise _bad("units")
    return _Head(
        cast(TableFrame, one_of("frame", get_args(TableFrame))), rate_Hz,
        cast(Quantity, one_of("quantity", get_args(Quantity))), cast(Between, one_of("between", get_args(Between))),
        TIMES[units[0]], LENGTHS[units[1]],
    )  # fmt: skip


def _allowed(name: str) -> str:
    return (
        "allowed: "
        + {
            "palmfield_stimulus": f"{VERSION}, the version of the format",
            "frame": " | ".join(get_args(TableFrame)),
            "rate_Hz": f"a number above 0, at most {HIGHEST_RATE_HZ:g}",
            "quantity": " | ".join(get_args(Quantity)),
            "units": f"of t ({', '.join(TIMES)}), a comma, and of x, y, z ({', '.join(LENGTHS)})",
            "between": " | ".join(get_args(Between)),
        }[name]
    )


def _names(file: Path, number: int, line: str) -> list[str]:
    names = [name.strip() for name in line.split(",")]
    foci = max(1, (len(names) - 1) // 4)
    expected = _columns(foci)
    twice = next((name for name, count in Counter(names).items() if count > 1), None)
    if twice is not None:
        raise SceneError(
            f"{file}: line {number}, column {names.index(twice) + 1}: column '{twice}' occurs twice; remove one"
        )
    stray = next((name for name in names if name not in expected), None)
    if stray is not None or len(names) != len(expected):
        missing = next((name for name in expected if name not in names), expected[-1])
        fault = f"column '{missing}' is missing" if stray is None else f"column '{stray}' is unknown"
        raise SceneError(
            f"{file}: line {number}: {fault}; allowed: t, x, y, z, intensity, or t, x1, y1, z1, intensity1, x2, ..."
        )
    return names


def focus_table_text(table: FocusTable) -> str:
    """Return the table as text for `read_focus_table`, in seconds and metres with all digits."""
    head = {
        "palmfield_stimulus": VERSION, "frame": table.frame, "rate_Hz": f"{table.rate_Hz!r}",
        "quantity": table.quantity, "units": "s, m", "between": table.between,
    }  # fmt: skip
    own = np.concatenate([table.positions, table.intensities[..., None]], axis=2).reshape(len(table.samples), -1)
    rows = np.column_stack([table.times, own]).tolist()
    lines = [f"# {name}: {head[name]}" for name in HEAD] + [",".join(_columns(table.foci))]
    return "\n".join(lines + [",".join(map(repr, row)) for row in rows]) + "\n"


def write_focus_table(path: Path, table: FocusTable) -> None:
    """Write a table in the form of `focus_table_text`. Raises OutputError if it cannot be written."""
    write_text(path, focus_table_text(table))
