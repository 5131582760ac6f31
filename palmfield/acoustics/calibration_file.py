"""A laboratory's calibration of an array as a TOML file: what the transducers were measured to do, and by whom."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from palmfield.errors import OutputError, SceneError
from palmfield.types import Estimate

NUMBERS = ("value", "low", "high")


@dataclass(frozen=True)
class Calibration:
    """What has been measured of an array's transducers.

    p0: peak pressure of one at 1 m on its axis at full drive [Pa m]; quality: of its resonance, None where it was not
        measured
    """

    p0: Estimate
    quality: Estimate | None = None


def read_calibration(path: str | Path) -> Calibration:
    """The calibration in a TOML file.

    Tables `p0` (in Pa m) and, if it was measured, `quality`, each with value, low, high (the 95 % interval) and source:
    who measured when, and with what.
    Raises SceneError for a file that cannot be read, and for a table, key or value that does not fit.
    """
    file = Path(path)
    try:
        tables = tomllib.loads(file.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise SceneError(f"{file}: cannot be read: {error}; give a TOML file with a table [p0]") from None
    unknown = sorted(set(tables) - {"p0", "quality"})
    if unknown or "p0" not in tables:
        fault = f"'{unknown[0]}' is unknown" if unknown else "table 'p0' is missing"
        raise SceneError(f"{file}: {fault}; allowed: tables p0 and quality")
    quality = _estimate(file, "quality", tables["quality"]) if "quality" in tables else None
    return Calibration(_estimate(file, "p0", tables["p0"]), quality)


def _estimate(file: Path, name: str, table: Any) -> Estimate:
    keys = (*NUMBERS, "source")
    if not isinstance(table, Mapping) or set(table) != set(keys):
        found = ", ".join(table) if isinstance(table, Mapping) else repr(table)
        raise SceneError(f"{file}: table '{name}' has {found or 'no keys'}; give {', '.join(keys)}")
    numbers = [table[key] for key in NUMBERS]
    for key, number in zip(NUMBERS, numbers, strict=True):
        if isinstance(number, bool) or not isinstance(number, int | float):
            raise SceneError(f"{file}: {name}.{key} = {number!r}; give a number")
    if not isinstance(table["source"], str) or not table["source"].strip():
        raise SceneError(f"{file}: {name}.source = {table['source']!r}; say who measured when, and with what")
    try:
        value, low, high = (float(number) for number in numbers)
        return Estimate(value, low, high, "measured", table["source"].strip())
    except ValueError:
        raise SceneError(
            f"{file}: table '{name}' has low {low:g}, value {value:g} and high {high:g}; give 0 < low <= value <= high"
        ) from None


def write_calibration(path: str | Path, calibration: Calibration) -> None:
    """Write a calibration that `read_calibration` reads back. Raises OutputError where it cannot be written."""
    text = ""
    for name, estimate in (("p0", calibration.p0), ("quality", calibration.quality)):
        if estimate is not None:
            text += f"[{name}]\n" + "".join(f"{key} = {float(getattr(estimate, key))!r}\n" for key in NUMBERS)
            quoted = "".join(f"\\u{ord(c):04x}" if ord(c) < 32 or c in '"\\\x7f' else c for c in estimate.source)
            text += f'source = "{quoted}"\n\n'
    try:
        Path(path).write_text(text, encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error}; give a place that can be written to") from None
