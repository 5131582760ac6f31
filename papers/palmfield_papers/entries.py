"""Read the numbers of the papers and their tolerances from tolerances.toml."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from palmfield.files import read_toml

KINDS = ("INPUT", "CLAIM", "ERRATUM", "CALC")


@dataclass(frozen=True)
class Tolerance:
    """How close an answer must be. kind: "none", "relative", "factor", "absolute_degrees", "dB" or "inequality" """

    rule: str
    kind: str
    value: float


@dataclass(frozen=True)
class Entry:
    """One number of one row of a paper.

    value: printed value, a number, a range, or words
    corrected: corrected value if the paper contradicts itself
    condition: condition of an inequality; readings: names of axes; sensitive_to: names of controls
    """

    id: str
    row: str
    paper: str
    quantity: str
    unit: str
    value: float | list[float] | str
    column: str
    kind: str
    configuration: str
    tolerance: Tolerance
    readings: tuple[str, ...]
    sensitive_to: tuple[str, ...]
    testable: bool
    reason: str
    source: str
    corrected: float | str | None = None
    condition: str | None = None
    why_it_could_fail: str | None = None

    @property
    def counts(self) -> bool:
        """Return whether the entry has one of the verdicts agrees, disagrees and depends."""
        return self.kind == "CLAIM" and self.testable


@dataclass(frozen=True)
class Control:
    """A deliberate change, the configurations that it affects, and the claims that it should change."""

    name: str
    changes: str
    configurations: tuple[str, ...]
    sensitive: tuple[str, ...]


@dataclass(frozen=True)
class Book:
    """The whole file.

    axes: values of each axis of readings, the base first; changes: changes made after the first version
    """

    entries: tuple[Entry, ...]
    axes: Mapping[str, tuple[str, ...]]
    places: Mapping[str, str]
    controls: tuple[Control, ...]
    configurations: Mapping[str, Mapping[str, str]]
    metrics: Mapping[str, Mapping[str, Any]]
    changes: tuple[Mapping[str, Any], ...]

    def of_paper(self, paper: str) -> tuple[Entry, ...]:
        """Return the entries of one paper, in the order of the file."""
        return tuple(entry for entry in self.entries if entry.paper == paper)

    def base(self, entry: Entry) -> tuple[tuple[str, str], ...]:
        """Return the base value of each axis of an entry."""
        return tuple((axis, self.axes[axis][0]) for axis in entry.readings)

    def varied(self, entry: Entry) -> list[tuple[tuple[str, str], ...]]:
        """Return the base readings, and then each axis changed separately to each of its other values."""
        base = self.base(entry)
        others = [
            tuple((name, value if name == axis else old) for name, old in base)
            for axis, _ in base
            for value in self.axes[axis][1:]
        ]
        return [base, *others]


def _entry(table: dict[str, Any]) -> Entry:
    kept = {key: value for key, value in table.items() if key not in ("tolerance", "readings", "sensitive_to")}
    return Entry(
        **kept,
        tolerance=Tolerance(**table["tolerance"]),
        readings=tuple(table["readings"]),
        sensitive_to=tuple(table["sensitive_to"]),
    )


def read_book(path: Path) -> Book:
    """Read the entries, readings and controls of a file of tolerances."""
    table = read_toml(path)
    return Book(
        entries=tuple(_entry(entry) for entry in table["entry"]),
        axes={name: tuple(axis["values"]) for name, axis in table["reading_axes"].items()},
        places={name: axis["place"] for name, axis in table["reading_axes"].items()},
        controls=tuple(
            Control(name, one["changes"], tuple(one["configurations"]), tuple(one["sensitive"]))
            for name, one in table["controls"].items()
        ),
        configurations=table["configurations"],
        metrics=table["metrics"],
        changes=tuple(table["changes"]),
    )


@cache
def book() -> Book:
    """Read the file of the gallery, docs/gallery/tolerances.toml."""
    return read_book(Path(__file__).with_name("tolerances.toml"))
