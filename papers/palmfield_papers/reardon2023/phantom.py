"""Row R20: the gelatin plate on the grid of row R15, and the focus of the array of row R2."""

from collections.abc import Callable
from typing import Any

import numpy as np

from palmfield.metrics import amplitude_spectrum, spectral_centroid, wake_length
from palmfield.types import Float
from palmfield_papers.answer import Answer, Setting
from palmfield_papers.reardon2023.configuration import length_of, plate_of
from palmfield_papers.reardon2023.lines import LATERAL_m, run_of, wake_cm
from palmfield_papers.reardon2023.resolution import answered, level_of
from palmfield_papers.reardon2023.runs import Straight

SCAN_X_m = 5e-3 * np.arange(-20, 20)
SCAN_Y_m = 5e-3 * np.arange(-14, 16)
"""Rows of the scan grid, 40 by 30 points at 5 mm. One row is on the path."""
BAND_Hz = (10.0, 1000.0)
SPEEDS = (2.0, 4.0, 7.0, 11.0, 15.0)


def scanned(one: Straight) -> Float:
    """Return the snapshot at seven eighths of the path, on the scan grid, shape (40, 30)."""
    rows, columns = (np.abs(one.places_m[:, None] - scan).argmin(axis=0) for scan in (SCAN_X_m, SCAN_Y_m))
    return one.at_seven_eighths[np.ix_(rows, columns)]


def scanned_wake_cm(one: Straight) -> float:
    """Return the 10 % wake of [metrics.wake_length] on the scan grid [cm]."""
    return 100.0 * wake_length(
        scanned(one), SCAN_X_m, SCAN_Y_m, focus_x_m=one.focus_x(0.875), threshold=0.1, lateral_m=LATERAL_m
    )


def _tracks(one: Straight) -> Float:
    """Return velocities at the points of the scan on the middle half of the path, shape (k, t)."""
    inside = np.abs(one.places_m) <= 0.25 * one.length_m * (1.0 + 1e-9)
    places = one.places_m[inside]
    on_grid = np.abs(places / 5e-3 - np.round(places / 5e-3)) < 1e-6
    # A record with whole samples from the start to the end of the path
    return one.track[:, on_grid].T


def centroid_Hz(one: Straight) -> float:
    """Return [metrics.spectral_centroid], averaged over positions [Hz]."""
    return float(np.mean([spectral_centroid(one.times_s, track, BAND_Hz) for track in _tracks(one)]))


def width_Hz(one: Straight) -> float:
    """Return the power-weighted rms distance from the centroid, averaged over the positions of `centroid_Hz` [Hz]."""
    found = []
    for track in _tracks(one):
        frequency, amplitude = amplitude_spectrum(one.times_s, track, taper="none")
        inside = (frequency >= BAND_Hz[0]) & (frequency <= BAND_Hz[1])
        f, power = frequency[inside], amplitude[inside] ** 2
        found.append(np.sqrt(np.average((f - np.average(f, weights=power)) ** 2, weights=power)))
    return float(np.mean(found))


def _wakes(setting: Setting, level: int, speeds: tuple[float, ...], **changes: Any) -> dict[float, float]:
    return {v: scanned_wake_cm(run_of(setting, level, v, **changes)) for v in speeds}


def _long(**changes: Any) -> Callable[[Setting], Answer]:
    def number(setting: Setting, level: int) -> float:
        return min(_wakes(setting, level, (7.0, 10.0, 15.0), **changes).values())

    def answer(setting: Setting) -> Answer:
        found = _wakes(setting, level_of(setting), (7.0, 10.0, 15.0), **changes)
        shown = {f"{v:g} m/s [cm]": one for v, one in found.items()}
        note = f"the least of 7, 10 and 15 m/s, path of {100 * length_of(setting):g} cm, rim {plate_of(setting).rim}"
        return answered(number, setting, changes=changes, margin=lambda v: v - 12.0, note=note, shown=shown)

    return answer


def _short(**changes: Any) -> Callable[[Setting], Answer]:
    def number(setting: Setting, level: int) -> float:
        return scanned_wake_cm(run_of(setting, level, 2.0, **changes))

    def answer(setting: Setting) -> Answer:
        fine = wake_cm(run_of(setting, level_of(setting), 2.0, **changes), 0.1)
        # Less than 6, because equality is not sufficient
        return answered(
            number, setting, changes=changes, margin=lambda v: 6.0 - v - 1e-9, shown={"on a grid of 1 mm [cm]": fine}
        )

    return answer


def _rises(what: Callable[[Straight], float], **changes: Any) -> Callable[[Setting], Answer]:
    def by_speed(setting: Setting, level: int) -> list[float]:
        return [what(run_of(setting, level, v, **changes)) for v in SPEEDS]

    def number(setting: Setting, level: int) -> float:
        return float(np.diff(by_speed(setting, level)).min())

    def answer(setting: Setting) -> Answer:
        found = by_speed(setting, level_of(setting))
        shown = {f"{v:g} m/s [Hz]": one for v, one in zip(SPEEDS, found, strict=True)}
        note = "the least rise from one speed to the next [Hz]"
        return answered(number, setting, changes=changes, margin=lambda v: v - 1e-9, note=note, shown=shown)

    return answer


VARIED: dict[str, Callable[..., Callable[[Setting], Answer]]] = {
    "R20b": _long,
    "R20c": _short,
    "R20d": lambda **changes: _rises(centroid_Hz, **changes),
    "R20e": lambda **changes: _rises(width_Hz, **changes),
}
"""Answers for slabs with changed fields, to find causes."""
ANSWERS = {name: make() for name, make in VARIED.items()}
