"""Spatio-temporal modulation of AUTD3 units (`FociStm` of autd3 0.12) as plain data in a JSON file, and as a table.

autd3 has no file format. The file contains the arguments of its constructors, with their names and units:

{"autd3_foci_stm": 1, "divide": 40, "loop": "infinite", "origin_mm": [-86.6, -66.7, 0.0],
 "points": [{"points": [{"point": [86.6, 66.7, 200.0], "phase_offset": 0}], "intensity": 255}]}

divide: of SamplingConfig; each entry of points lasts divide / 40 kHz; loop: LoopBehavior, "infinite" or "once"
origin_mm: origin of autd3's geometry (first transducer of the first unit) relative to the centre of all transducers,
the origin of palmfield's array frame. Points are in mm; units round them to 0.025 mm. The limits of units are those of
autd3's emulator: at least 2 entries, at most 65,536 foci, and a range of positions (`_check`).
"""

import json
import math
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from palmfield.acoustics.arrays import layout
from palmfield.errors import OutputError, SceneError, fault_of, naming
from palmfield.files import read_json, write_text
from palmfield.stimulus.focus_table import FocusTable
from palmfield.stimulus.focus_table_file import focus_table
from palmfield.types import Float

CARRIER_HZ = 40e3
LEVELS = 255
MM = 1e3
STEP_MM = 0.025
MOST_FOCI = 65536
"""Largest number of foci in all entries together that a unit can store."""
FARTHEST = 2**17
"""Largest number of steps from any transducer of a unit to a focus along each axis; one less in positive direction."""
Number = Annotated[float, Field(allow_inf_nan=False)]
Triple = tuple[Number, Number, Number]


class _Plain(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class ControlPoint(_Plain):
    """A focus [mm], and the phase of its sound relative to other foci in 1/256 of a turn."""

    point: Annotated[Triple, Field(strict=False)]
    phase_offset: Annotated[int, Field(ge=0, le=255)] = 0


class ControlPoints(_Plain):
    """1 to 8 simultaneous foci and their common intensity; the pulse width gives an amplitude of intensity / 255."""

    points: Annotated[list[ControlPoint], Field(min_length=1, max_length=8)]
    intensity: Annotated[int, Field(ge=0, le=LEVELS)] = LEVELS


class FociStm(_Plain):
    """Contents of the file described in this module."""

    autd3_foci_stm: Literal[1]
    divide: Annotated[int, Field(ge=1, le=65535)]
    loop: Literal["infinite", "once"] = "infinite"
    origin_mm: Annotated[Triple, Field(strict=False)] | None = None
    points: list[ControlPoints]


def default_origin_mm() -> tuple[float, float, float]:
    """Return the origin of one unit: its first transducer, relative to the centre of all 249 [mm]."""
    x, y, z = (MM * layout("autd3").positions[0]).tolist()
    return x, y, z


def read_foci_stm(path: str | Path) -> FociStm:
    """Read the content of a file. Raises SceneError, with the invalid entry, for an invalid file."""
    file = Path(path)
    content = json_of(file)
    try:
        with naming(f"{file}"):
            stm = FociStm.model_validate(content)
            _check(stm)
            return stm
    except ValidationError as error:
        raise SceneError(f"{file}: {fault_of(error)}") from None


def json_of(file: Path) -> Any:
    """Return the content of a JSON file. Raises SceneError, with line and column, if it is none."""
    try:
        return read_json(file)
    except json.JSONDecodeError as error:
        raise SceneError(f"{file}: line {error.lineno}, column {error.colno}: {error.msg}; give JSON") from None
    except (OSError, ValueError) as error:
        raise SceneError(f"{file}: cannot be read: {error}; give a JSON file in UTF-8") from None


def _check(stm: FociStm) -> None:
    """Raise SceneError for an STM that units do not accept."""
    if len(stm.points) < 2:
        raise SceneError(f"points has {len(stm.points)} entries; allowed: at least 2; list a stationary focus twice")
    count = sum(len(entry.points) for entry in stm.points)
    if count > MOST_FOCI:
        raise SceneError(
            f"points holds {count} foci; allowed: {MOST_FOCI} in all entries together: use a lower rate or a "
            "shorter duration"
        )
    places = np.array([point.point for entry in stm.points for point in entry.points])
    wide = np.ptp(layout("autd3").positions, axis=0) * MM / STEP_MM
    low, high = np.rint(wide) - FARTHEST, FARTHEST - 1
    steps = np.rint(places / STEP_MM)
    bad = (steps < low) | (steps > high)
    if bad.any():
        row, axis = (int(one[0]) for one in np.nonzero(bad))
        raise SceneError(
            f"focus {row}: {'xyz'[axis]} is {places[row, axis]:.7g} mm from the first transducer; allowed: "
            f"{STEP_MM * low[axis]:.7g} to {STEP_MM * high:.7g} mm"
        )


def table_of_stm(stm: FociStm) -> FocusTable:
    """Return the foci in the array frame, each constant until the next; `loop` corresponds to key path_end.

    Raises SceneError if the number of simultaneous foci changes, or if their phases, which a stimulus computes, differ.
    """
    counts = [len(entry.points) for entry in stm.points]
    if min(counts) != max(counts):
        row = next(i for i, count in enumerate(counts) if count != counts[0])
        raise SceneError(
            f"points.{row}: {counts[row]} foci at once, but the first entry has {counts[0]}; give the same number"
        )
    for row, entry in enumerate(stm.points):
        offsets = {point.phase_offset for point in entry.points}
        if len(offsets) > 1:
            raise SceneError(
                f"points.{row}: phase offsets {', '.join(map(str, sorted(offsets)))}; allowed: equal ones, because "
                "the phases of simultaneous foci are computed during the play"
            )
    origin = np.array(default_origin_mm() if stm.origin_mm is None else stm.origin_mm)
    places = np.array([[point.point for point in entry.points] for entry in stm.points])
    loud = np.repeat(np.array([[entry.intensity / LEVELS] for entry in stm.points]), counts[0], axis=1)
    rate_Hz = CARRIER_HZ / stm.divide
    times = np.arange(len(stm.points)) / rate_Hz
    return focus_table(times, (places + origin) / MM, loud, rate_Hz=rate_Hz, quantity="amplitude")


def stm_of_table(
    table: FocusTable, origin_mm: tuple[float, float, float] | None = None, *, again: bool = False
) -> FociStm:
    """Convert a table in the array frame for AUTD3 units; intensities are rounded to 1/255 of full amplitude.

    origin_mm: origin of autd3's geometry, None for that of one unit; again: whether the STM repeats
    Raises SceneError for another frame, linear interpolation, a rate that is not 40 kHz divided by a whole number, more
    than 8 foci, simultaneous foci of different intensities, and rows and positions that units do not accept.
    """
    divide = CARRIER_HZ / table.rate_Hz
    refused = ""
    if table.frame != "array":
        refused = f"frame is '{table.frame}'; allowed: array"
    elif table.between != "held":
        refused = "between is 'linear', but the units hold each focus; sample it by `palmfield stimulus export --rate`"
    elif abs(divide - round(divide)) > 1e-9 * divide or round(divide) > 65535:
        near = sorted({CARRIER_HZ / max(1, n) for n in (math.floor(divide), math.ceil(divide))})
        rates = " or ".join(f"{rate:g}" for rate in near)
        refused = f"rate_Hz is {table.rate_Hz:g}; allowed: 40 kHz divided by a whole number, such as {rates}"
    elif table.foci > 8:
        refused = f"there are {table.foci} foci at once; allowed: 8"
    elif table.length_samples * table.foci > MOST_FOCI:
        refused = (
            f"it has {table.length_samples} samples of {table.foci} foci; allowed: {MOST_FOCI // table.foci} "
            "samples: use a lower rate or a shorter duration"
        )
    every: Float = np.arange(min(table.length_samples, MOST_FOCI)) / table.rate_Hz
    amplitudes = np.sqrt(table.arp_of_each(every))
    if not refused and np.ptp(amplitudes, axis=1).max() > 0.0:
        refused = "simultaneous foci differ in intensity; allowed: one intensity for all"
    if refused:
        raise SceneError(f"no STM of AUTD3 units can be made of the table: {refused}")
    origin = default_origin_mm() if origin_mm is None else origin_mm
    places = (MM * table.positions_at(every) - np.array(origin)).tolist()
    levels = np.rint(LEVELS * amplitudes[:, 0]).astype(int).tolist()
    points = [
        ControlPoints(points=[ControlPoint(point=(x, y, z)) for x, y, z in foci], intensity=level)
        for foci, level in zip(places, levels, strict=True)
    ]
    loop: Literal["infinite", "once"] = "infinite" if again else "once"
    stm = FociStm(autd3_foci_stm=1, divide=round(divide), loop=loop, origin_mm=origin, points=points)
    with naming("no STM of AUTD3 units can be made of the table"):
        _check(stm)
    return stm


def write_foci_stm(path: Path, stm: FociStm) -> None:
    """Write the file, with one line per entry of points. Raises OutputError if it cannot be written."""
    content = stm.model_dump(mode="json")
    entries = ",\n  ".join(json.dumps(entry) for entry in content.pop("points"))
    head = json.dumps(content)[:-1]
    write_text(path, f'{head}, "points": [\n  {entries}\n]}}\n')


def autd3_command(stm: FociStm, sound_speed_m_s: float) -> Any:
    """Return the `FociStm` of autd3, for its client. Raises OutputError without the extra `autd3`."""
    try:
        from autd3 import commands, units, value
    except ImportError:
        raise OutputError("autd3 is not installed: pip install 'palmfield[autd3]'") from None
    # Units accept a finite loop only if it begins with the first entry of the table
    loop, begin = value.LoopBehavior.Infinite, value.TransitionMode.Immediate
    if stm.loop == "once":
        loop, begin = value.LoopBehavior.Once, value.TransitionMode.SyncIdx
    option = commands.FociStmOption(
        sound_speed=sound_speed_m_s * units.m / units.s, loop_behavior=loop, transition_mode=begin
    )
    return commands.FociStm(value.SamplingConfig(stm.divide), control_points(stm), option)


def control_points(stm: FociStm) -> list[Any]:
    """Return the `ControlPoints` of autd3 for `FociStm`; they can be read back, as float32."""
    from autd3 import value

    return [
        value.ControlPoints([value.ControlPoint(one.point, one.phase_offset) for one in entry.points], entry.intensity)
        for entry in stm.points
    ]
