"""A laboratory's calibration of an array as a TOML file: what the transducers were measured to do, and by whom."""

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from palmfield.errors import OutputError, SceneError
from palmfield.types import Complex, Estimate

NUMBERS = ("value", "low", "high")


@dataclass(frozen=True)
class Elements:
    """How each transducer differs from the others, in the layout's order; shapes (n,), as tuples.

    polarity: +1, or -1 for one wired the other way round; phase_rad: by which it comes late [rad]; gain: its amplitude
    relative to p0; enabled: whether it may sound
    """

    polarity: tuple[int, ...]
    phase_rad: tuple[float, ...]
    gain: tuple[float, ...]
    enabled: tuple[bool, ...]

    @property
    def response(self) -> Complex:
        """What each makes of a unit drive, e^{-iwt}, shape (n,); 0 for those that may not sound."""
        sound = np.array(self.polarity) * np.array(self.gain) * np.exp(1j * np.array(self.phase_rad))
        return np.where(np.array(self.enabled), sound, 0.0)


@dataclass(frozen=True)
class Calibration:
    """What has been measured of an array's transducers.

    p0: peak pressure of one at 1 m on its axis at full drive [Pa m]; quality: of its resonance, None where it was not
        measured; elements: how they differ, None where that was not measured
    """

    p0: Estimate
    quality: Estimate | None = None
    elements: Elements | None = None


def read_calibration(path: str | Path) -> Calibration:
    """The calibration in a TOML file.

    Tables `p0` (in Pa m) and, if it was measured, `quality`, each with value, low, high (the 95 % interval) and source:
    who measured when, and with what. Table `elements`, if there is one, has a list for each transducer in the layout's
    order of one or more of `polarity` (1 or -1), `phase_deg` (by which it comes late), `gain` (relative to p0) and
    `enabled`.
    Raises SceneError for a file that cannot be read, and for a table, key or value that does not fit.
    """
    file = Path(path)
    try:
        tables = tomllib.loads(file.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise SceneError(f"{file}: cannot be read: {error}; give a TOML file with a table [p0]") from None
    unknown = sorted(set(tables) - {"p0", "quality", "elements"})
    if unknown or "p0" not in tables:
        fault = f"'{unknown[0]}' is unknown" if unknown else "table 'p0' is missing"
        raise SceneError(f"{file}: {fault}; allowed: tables p0, quality and elements")
    quality = _estimate(file, "quality", tables["quality"]) if "quality" in tables else None
    elements = _elements(file, tables["elements"]) if "elements" in tables else None
    return Calibration(_estimate(file, "p0", tables["p0"]), quality, elements)


def _elements(file: Path, table: Any) -> Elements:
    columns = {"polarity": (1, -1), "phase_deg": (), "gain": (), "enabled": (True, False)}
    if not isinstance(table, Mapping) or not table or set(table) - set(columns):
        found = ", ".join(map(str, table)) if isinstance(table, Mapping) else repr(table)
        raise SceneError(f"{file}: table 'elements' has {found or 'no keys'}; allowed: {', '.join(columns)}")
    count = len(next(iter(table.values()))) if isinstance(next(iter(table.values())), list) else 0
    for key, values in table.items():
        if not isinstance(values, list) or len(values) != count or not count:
            raise SceneError(
                f"{file}: elements.{key} is no list as long as the others; give a value for each transducer"
            )
        for number, value in enumerate(values):
            numeric = not isinstance(value, bool) and isinstance(value, int | float) and math.isfinite(value)
            fits = isinstance(value, bool) if key == "enabled" else numeric
            if fits and columns[key]:
                fits = value in columns[key]
            if not fits or (key == "gain" and value < 0):
                takes = {"polarity": "1 or -1", "enabled": "true or false", "gain": "a number >= 0"}.get(
                    key, "a number"
                )
                raise SceneError(f"{file}: elements.{key} has {value!r} for transducer {number}; allowed: {takes}")
    return Elements(
        tuple(table.get("polarity", [1] * count)),
        tuple(math.radians(value) for value in table.get("phase_deg", [0.0] * count)),
        tuple(float(value) for value in table.get("gain", [1.0] * count)),
        tuple(table.get("enabled", [True] * count)),
    )


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
    if calibration.elements is not None:
        own = calibration.elements
        degrees = [math.degrees(value) for value in own.phase_rad]
        text += f"[elements]\npolarity = {list(own.polarity)}\nphase_deg = {degrees}\ngain = {list(own.gain)}\n"
        text += f"enabled = [{', '.join('true' if value else 'false' for value in own.enabled)}]\n"
    try:
        Path(path).write_text(text, encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error}; give a place that can be written to") from None
