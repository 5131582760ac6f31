"""Compare a recording of a microphone or vibrometer with the result of a trial at its position.

The CSV file has head lines `# quantity: pressure`, `# unit: Pa`, `# place_m: 0 0 0.15`, then `t,value` and rows with t
in seconds. The quantity pressure is the peak amplitude of the carrier at the position. Displacement and velocity are
those of the skin along its outward normal, at the point nearest to place_m when the trial begins. place_m is in the
frame of the array.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np

from palmfield.errors import SceneError, naming, refuse_unknown
from palmfield.estimate.array_inputs import p0_band
from palmfield.files import read_text, reading
from palmfield.instruments import scan
from palmfield.studies.trial.field import TrialMoment, TrueSound
from palmfield.studies.trial.sending import Drives
from palmfield.studies.trial.skin_response import SkinResponse
from palmfield.tables import numbers_in
from palmfield.types import Float

Quantity = Literal["pressure", "displacement", "velocity"]
UNITS: dict[Quantity, dict[str, float]] = {
    "pressure": {"Pa": 1.0, "kPa": 1e3, "mPa": 1e-3}, "displacement": scan.UNITS["displacement"],
    "velocity": scan.UNITS["velocity"],
}  # fmt: skip
"""Factors from a unit to Pa, m and m/s."""
HEAD = ("quantity", "unit", "place_m")
SHIFT = 0.25
"""Largest difference between the clocks of recording and trial, as a fraction of the length of the recording."""
FEWEST = 16


@dataclass(frozen=True)
class Recording:
    """A recording. times: rising times [s], shape (n,); values: [Pa, m or m/s], shape (n,); place_m: array frame [m]"""

    quantity: Quantity
    times: Float
    values: Float
    place_m: tuple[float, float, float]
    name: str = "recording"


@dataclass(frozen=True)
class Compared:
    """A recording compared with the computed signal at its position, aligned in time.

    shift_s: delay of the recording relative to the computed signal [s]
    overlap_s: duration for which both signals exist [s]
    rms: rms of the difference, relative to the rms of the computed signal
    correlation: correlation of both signals without their means
    ratio: recorded divided by computed amplitude, by least squares
    band: expected range of the ratio due to the range of p0, if all other parameters are right (ARP and motion are
        quadratic in p0)
    """

    name: str
    quantity: str
    shift_s: float
    overlap_s: float
    rms: float
    correlation: float
    ratio: float
    band: tuple[float, float]

    def as_dict(self) -> dict[str, Any]:
        return {**self.__dict__, "band": list(self.band)}

    def __str__(self) -> str:
        low, high = self.band
        return (
            f"recording       {self.name}: {self.quantity}, shifted by {1e3 * self.shift_s:+.2f} ms, "
            f"{self.overlap_s:.3g} s in common\n"
            f"                correlation {self.correlation:.3f}, rms difference {100 * self.rms:.1f} % of the "
            f"computed signal; amplitude ratio {self.ratio:.3f} ({low:.2g} to {high:.2g} within the range of p0)"
        )


def read_recording(path: str | Path) -> Recording:
    """Read a recording from a file, in the format of this module's description.

    Raises SceneError, with the line, for a file that cannot be read, an incomplete head, another unit,
    text, numbers that are not finite, and times that do not rise.
    """
    file = Path(path)
    with reading(f"recording {file}", SceneError, "a CSV file (UTF-8)"):
        lines = read_text(file, "utf-8-sig").splitlines()
    with naming(f"recording {file}"):
        return _recording(lines, file.name)


def _recording(lines: list[str], name: str) -> Recording:
    head: dict[str, str] = {}
    begin = sum(1 for _ in takewhile(lambda line: line.startswith("#"), lines))
    for line in lines[:begin]:
        key, _, value = line[1:].partition(":")
        if key.strip() in HEAD:
            head[key.strip()] = value.strip()
    for name in HEAD:
        if name not in head:
            raise SceneError(
                f"the head has no '# {name}: ...'; begin with lines '# quantity: pressure', '# unit: Pa', "
                "'# place_m: 0 0 0.15'"
            )
    refuse_unknown(SceneError, "quantity is {}", head["quantity"], UNITS)
    quantity = cast(Quantity, head["quantity"])
    refuse_unknown(SceneError, f"unit of {quantity} is {{}}", head["unit"], UNITS[quantity])
    try:
        place = tuple(float(cell) for cell in head["place_m"].replace(",", " ").split())
    except ValueError:
        place = ()
    if len(place) != 3 or not np.all(np.abs(place) <= 10.0):
        raise SceneError(f"place_m is '{head['place_m']}'; give three finite numbers in metres, in the array's frame")
    if begin == len(lines) or [cell.strip() for cell in lines[begin].split(",")] != ["t", "value"]:
        raise SceneError(f"line {begin + 1} does not contain column names; give 't,value' after the head")
    rows = [
        numbers_in(f"line {number}", ("t", "value"), line.split(","))
        for number, line in enumerate(lines[begin + 1 :], begin + 2)
        if line.strip()
    ]
    table = np.array(rows).reshape(-1, 2)
    if len(table) < FEWEST:
        raise SceneError(f"{len(table)} rows; needed: {FEWEST} or more")
    late = np.flatnonzero(np.diff(table[:, 0]) <= 0.0)
    if len(late):
        n = int(late[0])
        raise SceneError(f"t = {table[n + 1, 0]:g} s comes after {table[n, 0]:g} s; allowed: rising times")
    values = UNITS[quantity][head["unit"]] * table[:, 1]
    return Recording(quantity, table[:, 0], values, place, name)


def compare(
    recording: Recording, moments: Sequence[TrialMoment], sound: TrueSound, drives: Drives, skin: SkinResponse | None
) -> Compared:
    """Compare a recording with the same quantity of a trial.

    Raises SceneError for skin motion if no skin was stepped.
    """
    if recording.quantity == "pressure":
        times = np.array([one.time_s for one in moments])
        values = _pressures(times, np.array(recording.place_m), sound, drives)
        power = 0.5
    else:
        if skin is None:
            raise SceneError(f"recording of {recording.quantity} needs the motion of the skin: remove --no-skin")
        times, values = skin.times, skin.motion[-1][0 if recording.quantity == "displacement" else 1]
        power = 1.0
    shift, overlap, rms, correlation, ratio = aligned(recording.times, recording.values, times, values)
    low, high = p0_band(sound.model, sound.number) or (1.0, 1.0)
    return Compared(
        recording.name, recording.quantity, shift, overlap, rms, correlation, ratio, (low**power, high**power)
    )


def _pressures(times: Float, place: Float, sound: TrueSound, drives: Drives) -> Float:
    """Return the pressure amplitude at a fixed position [Pa], shape (k,)."""
    values: Float = np.zeros(len(times))
    cached: tuple[object, float] = (None, 0.0)
    flight_s = sound.flight_s(place)
    for n, time_s in enumerate(times):
        found = drives.at(float(time_s) - flight_s)
        if found is None:
            continue
        amplitudes = found[0].amplitudes
        if cached[0] is not amplitudes:
            arrays = sound.true_arrays(sound.course.posed(float(time_s)).arrays)
            cached = amplitudes, float(np.abs(arrays.pressure64(place[None], amplitudes)[0]))
        values[n] = cached[1]
    return values


def aligned(
    times: Float, values: Float, computed_times: Float, computed: Float
) -> tuple[float, float, float, float, float]:
    """Return shift [s], overlap [s], relative rms difference, correlation and ratio of a recorded to a computed signal.

    The shift maximises the correlation without means. The largest shift is SHIFT times the length of the recording.
    Raises SceneError if they overlap too little, or if one of them is constant.
    """
    step = max(float(np.median(np.diff(computed_times))), float(np.median(np.diff(times)))) / 4.0
    most = SHIFT * (times[-1] - times[0])
    best: tuple[float, float] | None = None
    grid = np.arange(computed_times[0], computed_times[-1], step)
    ours = np.interp(grid, computed_times, computed)
    for shift in np.arange(-most, most + step, step):
        inside = (grid + shift >= times[0]) & (grid + shift <= times[-1])
        if inside.sum() < FEWEST or inside.sum() < 0.5 * min(len(grid), (times[-1] - times[0]) / step):
            continue
        theirs = np.interp(grid[inside] + shift, times, values)
        a, b = ours[inside] - ours[inside].mean(), theirs - theirs.mean()
        size = float(np.sqrt((a @ a) * (b @ b)))
        if size > 0.0 and (best is None or a @ b / size > best[1]):
            best = float(shift), float(a @ b / size)
    if best is None:
        raise SceneError("the recording cannot be aligned: it overlaps the trial by less than half, or is constant")
    shift, correlation = best
    inside = (grid + shift >= times[0]) & (grid + shift <= times[-1])
    theirs, own = np.interp(grid[inside] + shift, times, values), ours[inside]
    rms = float(np.sqrt(np.mean((theirs - own) ** 2) / np.mean(own**2)))
    ratio = float((own @ theirs) / (own @ own))
    return shift, float(inside.sum() * step), rms, correlation, ratio
