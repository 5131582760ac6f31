"""Calibration of one array in a JSON file: measured data of its transducers, and their source."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from scipy.spatial.transform import Rotation

from palmfield.acoustics.arrays import LAYOUTS, layout_of_version
from palmfield.acoustics.placement import placed
from palmfield.config.base import NonNegative, Positive
from palmfield.errors import SceneError, naming
from palmfield.files import MOST_SETTINGS_BYTES, read_bytes, reading, write_text
from palmfield.types import Array, Complex, Estimate

Place = tuple[float, float, float]

RANGES = {
    "phase_rad": (-2.0 * math.pi, 2.0 * math.pi, ", in radians"),
    "resonance_Hz": (20e3, 80e3, ", in hertz"),
    "quality": (1.0, 1000.0, ""),
}
"""Allowed range and unit of the numbers in a file; the ranges of the last two are those of the keys of a scene."""


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Elements(_Part):
    """Measured data of each transducer, in the order of the layout; all lists have the same length n.

    enabled: False for a transducer without sound; its other numbers are ignored.
    polarity: -1 for reversed wiring. phase_rad: additional delay [rad].
    gain: amplitude relative to p0. phase_sd_rad, gain_sd: standard errors.
    position_m: position in the array frame [m], if measured. address: number in the byte order of the board.
    resonance_Hz, quality: frequency and quality of the resonance, if measured for each transducer.
    """

    enabled: tuple[bool, ...]
    polarity: tuple[Literal[-1, 1], ...]
    phase_rad: tuple[float, ...]
    gain: tuple[NonNegative, ...]
    phase_sd_rad: tuple[NonNegative, ...] | None = None
    gain_sd: tuple[NonNegative, ...] | None = None
    position_m: tuple[Place, ...] | None = None
    address: tuple[Annotated[int, Field(ge=0)], ...] | None = None
    resonance_Hz: tuple[Positive, ...] | None = None
    quality: tuple[Positive, ...] | None = None

    def __len__(self) -> int:
        return len(self.enabled)

    @model_validator(mode="after")
    def _of_one_length(self) -> Self:
        for name in type(self).model_fields:
            values = getattr(self, name)
            if values is not None and len(values) != len(self):
                raise ValueError(f"{name} has {len(values)} entries and enabled {len(self)}; give one for each")
        if self.address is not None and sorted(self.address) != list(range(len(self))):
            raise ValueError(f"address must hold each number from 0 to {len(self) - 1} once")
        return self


class Pose(_Part):
    """Pose of the board relative to its nominal frame, with standard errors.

    offset_m: offset of the origin [m]; turn_rad: rotation vector [rad]
    """

    offset_m: Place = (0.0, 0.0, 0.0)
    offset_sd_m: Place = (0.0, 0.0, 0.0)
    turn_rad: Place = (0.0, 0.0, 0.0)
    turn_sd_rad: Place = (0.0, 0.0, 0.0)


class Level(_Part):
    """Pressure as a function of the drive level a: p = p0 a^exponent up to linear_to, and less above it.

    exponent, exponent_sd: exponent and its standard error.
    linear_to: level above which the pressure is more than 5 % too low; 1 if there is no such level."""

    exponent: Positive
    exponent_sd: NonNegative
    linear_to: Annotated[float, Field(gt=0, le=1)]


class WarmUp(_Part):
    """Amplitude over the time since switching on, relative to the final amplitude: 1 + drop exp(-t/time_s)."""

    drop: float
    drop_sd: NonNegative
    time_s: Positive


def _version(name: str) -> int:
    return LAYOUTS[name].version if name in LAYOUTS else 1


class Calibration(_Part):
    """Measured data of an array; None for data that were not measured.

    layout, layout_version: define the order of the transducers.
    p0: peak pressure of one transducer at 1 m on its axis at full drive [Pa m].
    quality, resonance_Hz: common resonance of all transducers.
    phase_offset_rad: common delay of the board [rad], relative to another board or a trigger.
    """

    format: Literal["palmfield calibration"] = "palmfield calibration"
    version: Literal[1] = 1
    layout: str
    layout_version: int = 1
    p0: Estimate | None = None
    quality: Estimate | None = None
    resonance_Hz: Estimate | None = None
    elements: Elements | None = None
    pose: Pose = Pose()
    phase_offset_rad: float = 0.0
    level: Level | None = None
    warm_up: WarmUp | None = None

    @model_validator(mode="after")
    def _of_todays_layout(self) -> Self:
        if "layout_version" not in self.model_fields_set:
            self.__dict__["layout_version"] = _version(self.layout)
        return self

    @model_validator(mode="after")
    def _with_sources(self) -> Self:
        for name in ("p0", "quality", "resonance_Hz"):
            estimate = getattr(self, name)
            if estimate is None:
                continue
            if not estimate.source.strip():
                raise ValueError(f"{name} has no source: state who measured it, when, and with which instrument")
            if estimate.kind != "measured":
                raise ValueError(f"{name} has kind '{estimate.kind}'; allowed in a calibration: measured")
        return self


def read_calibration(path: str | Path) -> Calibration:
    """Read a calibration from a JSON file with the entries of `Calibration` (docs/calibration.md).

    A layout of an earlier version gets its present name. Raises SceneError for a file that cannot be read, and with the
    entry for an invalid entry.
    """
    file = Path(path)
    with reading(file, SceneError, "a calibration's JSON file"):
        data = read_bytes(file, MOST_SETTINGS_BYTES)
    try:
        calibration = Calibration.model_validate_json(data)
    except ValidationError as error:
        raise SceneError(f"{file}: " + _message(error.errors()[0])) from None
    _check_units(file, calibration)
    version = calibration.layout_version if "layout_version" in calibration.model_fields_set else 1
    with naming(f"{file}"):
        name = layout_of_version(calibration.layout, version)
    return calibration.model_copy(update={"layout": name, "layout_version": _version(name)})


def _check_units(file: Path, calibration: Calibration) -> None:
    """Raise SceneError for numbers outside RANGES, which are usually in another unit."""
    entries = {name: getattr(calibration, name, None) for name in RANGES}
    numbers = {f"{name}.value": (name, entry.value) for name, entry in entries.items() if entry is not None}
    elements = calibration.elements
    if elements is not None:
        for name in RANGES:
            values = getattr(elements, name) or ()
            sounding = (number for number in range(len(values)) if elements.enabled[number])
            numbers |= {f"elements.{name}.{number}": (name, values[number]) for number in sounding}
    for place, (name, value) in numbers.items():
        low, high, unit = RANGES[name]
        if not low <= value <= high:
            raise SceneError(f"{file}: {place} = {value:g}; allowed: {low:.5g} to {high:.5g}{unit}")


def _message(error: Any) -> str:
    place = ".".join(str(step) for step in error["loc"])
    text = error["msg"].removeprefix("Value error, ").replace("Input should be", "allowed:")
    if error["type"] == "json_invalid":
        return f"cannot be read: {text}; give a calibration's JSON file"
    if error["type"] == "extra_forbidden":
        return f"{place} is unknown; docs/calibration.md lists the allowed keys"
    if error["type"] == "missing":
        return f"{place} is missing"
    entry = error["input"]
    value = "" if isinstance(entry, dict | list) or not place else f" = {entry!r}"
    return f"{place}{value}: {text}" if place else text


def write_calibration(path: str | Path, calibration: Calibration) -> None:
    """Write a calibration for `read_calibration`. Raises OutputError if it cannot be written."""
    write_text(path, calibration.model_dump_json(indent=1, exclude_none=True) + "\n")


def response(calibration: Calibration, count: int) -> Complex | None:
    """Return the complex emission of each transducer at unit drive relative to p0, shape (count,), 0 if disabled.

    The result is None if it was not measured. Raises SceneError if the number of transducers differs.
    """
    elements, offset = calibration.elements, calibration.phase_offset_rad
    if elements is None:
        return None if offset == 0.0 else np.full(count, np.exp(1j * offset))
    if len(elements) != count:
        raise SceneError(
            f"the calibration has {len(elements)} transducers, but the array has {count}; give the calibration of "
            "this array"
        )
    sizes = np.where(elements.enabled, elements.gain, 0.0) * np.array(elements.polarity)
    return np.asarray(sizes * np.exp(1j * (offset + np.array(elements.phase_rad))))


def calibrated(array: Array, calibration: Calibration) -> Array:
    """Return the array with its measured data, except p0.

    array: the layout. Raises SceneError for a calibration of another layout or number of transducers.
    """
    if calibration.layout != array.name:
        earlier = LAYOUTS[array.name].earlier if array.name in LAYOUTS else ()
        was = f", the earlier layout of '{array.name}': measure again, or set layout {calibration.layout}"
        raise SceneError(
            f"the calibration is for layout '{calibration.layout}', but the array is '{array.name}'"
            + was * (calibration.layout in earlier)
        )
    measured = response(calibration, len(array))
    positions, address = array.positions, array.address
    if calibration.elements is not None:
        if calibration.elements.position_m is not None:
            positions = np.array(calibration.elements.position_m)
        if calibration.elements.address is not None:
            address = np.array(calibration.elements.address, np.int32)
    own = np.ones(len(array)) if array.gain is None else array.gain
    gain = array.gain if measured is None else own * measured
    turn = Rotation.from_rotvec(calibration.pose.turn_rad).as_matrix()
    return placed(replace(array, positions=positions, address=address, gain=gain), calibration.pose.offset_m, turn)
