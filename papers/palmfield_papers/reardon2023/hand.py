"""Rows R16 to R19: the zigzag along the hand, on a slab of tissue, and the observer of its direction."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from scipy.integrate import cumulative_trapezoid

from palmfield.metrics import amplitude_spectrum, wake_length
from palmfield.perception import OBSERVERS, direction_share, level_course, noise_for, separation
from palmfield.types import Float
from palmfield_papers.answer import Answer, Setting
from palmfield_papers.reardon2023.configuration import Course, Plate, tissue_of
from palmfield_papers.reardon2023.figures import zigzag_corners
from palmfield_papers.reardon2023.lines import LATERAL_m
from palmfield_papers.reardon2023.phantom import BAND_Hz
from palmfield_papers.reardon2023.resolution import answered, level_of
from palmfield_papers.reardon2023.runs import FULL, QUICK, line_run, sampled

PATH_m, WIDTH_m, ACROSS_m_s = 0.16, 0.02, 2.5
SPEEDS = (1.0, 2.0, 4.0, 7.0, 11.0)
FELT = (0.5, *SPEEDS)
FITTED = (0.5, 1.0)
"""Speeds at which the noise of the observer is fitted [m/s]."""
EASY = 0.95
"""Mean fraction of right answers at these speeds. The text has no value: 0.5 m/s "could be easily perceived"."""
OTHER_EASY = (0.75, 0.99)
INTEGRATION_s = 0.2
"""Integration time of the Pacinian channel [s]. It is the only value in the notes on perception."""
OTHER_INTEGRATION_s = (0.0, 0.02)
SILENCE_s = 0.04
"""Silence after a pass [s]. At its end the slab is at rest."""
RECEPTORS_m = 5e-3 * np.arange(-16, 17)
"""Positions of receptors along the path [m]."""
CROSSINGS_Hz = ACROSS_m_s / WIDTH_m
"""Frequency at which the focus crosses the axis of the zigzag [Hz]."""
CHANCE = 6.3
"""Distance from 50 % [percentage points] that contains 95 % of the results of 240 trials by chance."""


@dataclass(frozen=True)
class Pass:
    """One pass along the hand.

    snapshot: velocity at seven eighths of the path, at places_m along both axes
    displacement_m, velocity_m_s: at RECEPTORS_m and times_s, including the silence after the pass, shape (t, 33)
    end_s: end of the path [s]
    """

    places_m: Float
    snapshot: Float
    times_s: Float
    displacement_m: Float
    velocity_m_s: Float
    end_s: float


def hand_course(along: float, level: int, *, back: bool = False) -> Course:
    """Return 16 cm of a zigzag 2 cm wide, with samples at most 0.5 ms apart. back: whether the path is reversed"""
    corners = zigzag_corners(PATH_m, WIDTH_m, along, ACROSS_m_s)
    corners = corners[::-1] if back else corners
    seconds = PATH_m / along
    most = 5e-4 if level <= QUICK else 2.5e-4 if level == FULL else 1.6e-4
    return Course(corners, math.hypot(along, ACROSS_m_s), 8 * math.ceil(seconds / most / 8.0), still_after_s=SILENCE_s)


def own_mirror(along: float) -> bool:
    """Return whether the reversed path is the path mirrored in x, and possibly in y; receptors then get the same."""
    ahead = np.array(hand_course(along, QUICK).corners)
    return any(np.allclose(ahead[::-1], ahead * (-1.0, sign), atol=1e-9) for sign in (1.0, -1.0))


@cache
def passed(plate: Plate, along: float, level: int, device: str, *, back: bool = False) -> Pass:
    """Return a pass at a speed along the path. With `back`, its snapshot must not be used."""
    if back and own_mirror(along):
        ahead = passed(plate, along, level, device)
        return replace(ahead, displacement_m=ahead.displacement_m[:, ::-1], velocity_m_s=ahead.velocity_m_s[:, ::-1])
    course = hand_course(along, level, back=back)
    motion, line = line_run(plate, course, level, device, course.steps * 7 // 8 - 1)
    columns = np.abs(motion.places_m[:, None] - RECEPTORS_m).argmin(axis=0)
    velocity = line[:, columns].astype(float)
    moved = cumulative_trapezoid(velocity, motion.times_s, axis=0, initial=0.0)
    return Pass(motion.places_m, motion.velocity[0].astype(float), motion.times_s, moved, velocity, PATH_m / along)


def wake_cm(one: Pass) -> float:
    """Return the 10 % wake of [metrics.wake_length] on the hand [cm]."""
    return 100.0 * wake_length(
        one.snapshot, one.places_m, one.places_m, focus_x_m=PATH_m * 0.375, threshold=0.1, lateral_m=LATERAL_m
    )


def wakes_cm(setting: Setting, level: int, speeds: tuple[float, ...] = SPEEDS, **changes: Any) -> dict[float, float]:
    """Return wakes by speed [cm]."""
    return {v: wake_cm(passed(tissue_of(setting, **changes), v, level, setting.device)) for v in speeds}


def _shown_wakes(setting: Setting, **changes: Any) -> dict[str, float]:
    return {f"{v:g} m/s [cm]": one for v, one in wakes_cm(setting, level_of(setting), FELT, **changes).items()}


def _grows(**changes: Any) -> Callable[[Setting], Answer]:
    def number(setting: Setting, level: int) -> float:
        return float(np.diff(list(wakes_cm(setting, level, **changes).values())).min())

    def answer(setting: Setting) -> Answer:
        note = "the least rise from one speed to the next [cm]"
        return answered(
            number,
            setting,
            changes=changes,
            margin=lambda v: v + 0.5,
            note=note,
            shown=_shown_wakes(setting, **changes),
        )

    return answer


def _long(**changes: Any) -> Callable[[Setting], Answer]:
    def number(setting: Setting, level: int) -> float:
        return min(wakes_cm(setting, level, (7.0, 11.0), **changes).values())

    def answer(setting: Setting) -> Answer:
        return answered(
            number, setting, changes=changes, margin=lambda v: v - 10.0, shown=_shown_wakes(setting, **changes)
        )

    return answer


def near_lines(one: Pass) -> float:
    """Return the fraction of power near multiples of CROSSINGS_Hz, within a quarter of it.

    The power is that of the normal velocity on the axis, 10 to 1000 Hz, mean over positions.
    """
    spectra = [amplitude_spectrum(one.times_s, place, taper="none") for place in one.velocity_m_s.T]
    f, power = spectra[0][0], np.sum([amplitude**2 for _, amplitude in spectra], axis=0)
    power = np.where((f >= BAND_Hz[0]) & (f <= BAND_Hz[1]), power, 0.0)
    order = np.rint(f / CROSSINGS_Hz)
    near = (order >= 1.0) & (np.abs(f - order * CROSSINGS_Hz) <= 0.25 * CROSSINGS_Hz)
    return float(power[near].sum() / power.sum())


def _concentrated(**changes: Any) -> Callable[[Setting], Answer]:
    def number(setting: Setting, level: int) -> float:
        return near_lines(passed(tissue_of(setting, **changes), 1.0, level, setting.device))

    def answer(setting: Setting) -> Answer:
        plate = tissue_of(setting, **changes)
        shown = {f"{v:g} m/s": near_lines(passed(plate, v, level_of(setting), setting.device)) for v in SPEEDS}
        return answered(number, setting, changes=changes, margin=lambda v: v - 0.75, shown=shown)

    return answer


# R19


def local_displacement(along: float, level: int, *, back: bool = False) -> tuple[Float, Float]:
    """Return times [s] and motion (t, 33) of skin without waves. Receptors move as the pressure, in any unit."""
    course = hand_course(along, level, back=back)
    times, spot, end = sampled(course)
    places = np.stack([np.interp(times, spot.times_s, spot.centres()[:, n]) for n in range(2)], axis=1)
    squared = (places[:, :1] - RECEPTORS_m) ** 2 + places[:, 1:] ** 2
    fwhm = Plate().fwhm_m
    return times, np.where(times[:, None] <= end * (1.0 + 1e-9), np.exp(-4.0 * math.log(2.0) * squared / fwhm**2), 0.0)


def repeated(times: Float, motion: Float, end_s: float) -> tuple[Float, Float]:
    """Repeat passes for the duration of a pass at the slowest speed. Their motions add, because the skin is linear."""
    step = float(times[1] - times[0])
    count, shift = max(1, round(PATH_m / FELT[0] / end_s)), round(end_s / step)
    result = np.zeros(((count - 1) * shift + len(times), motion.shape[1]))
    for n in range(count):
        result[n * shift : n * shift + len(times)] += motion
    return np.asarray(step * np.arange(1, len(result) + 1), dtype=float), result


def apart(times: Float, motions: tuple[Float, Float], integration_s: float) -> float:
    """Return the separation of the two directions on one path.

    On one path, positions alone do not distinguish the directions; with mirrored zigzags they would.
    """
    there, back = (
        level_course(times, motion, OBSERVERS["afferent_human"], integration_s=integration_s) for motion in motions
    )
    return separation(there, back, float(times[1] - times[0]), float(np.diff(RECEPTORS_m)[0]))


@cache
def separations(
    plate: Plate | None, level: int, device: str, *, same_duration: bool, integration_s: float
) -> dict[float, float]:
    """Return the separations by speed. plate: None for skin without waves"""
    found = {}
    for v in FELT:
        if plate is None:
            both = [local_displacement(v, level, back=back) for back in (False, True)]
        else:
            passes = [passed(plate, v, level, device, back=back) for back in (False, True)]
            both = [(one.times_s, one.displacement_m) for one in passes]
        if same_duration:
            both = [repeated(times, motion, PATH_m / v) for times, motion in both]
        (times, there), (_, back) = both
        found[v] = apart(times, (there, back), integration_s)
    return found


def accuracies(
    plate: Plate | None,
    level: int,
    device: str,
    *,
    same_duration: bool = False,
    integration_s: float = INTEGRATION_s,
    easy: float = EASY,
) -> dict[float, float]:
    """Return the expected fraction of right answers by speed [%].

    The noise is fitted on the same skin with single passes at 0.5 and 1 m/s. The same noise is used for repeated
    passes.
    """
    single = separations(plate, level, device, same_duration=False, integration_s=integration_s)
    noise = noise_for([single[v] for v in FITTED], easy)
    of = separations(plate, level, device, same_duration=same_duration, integration_s=integration_s)
    return {v: 100.0 * direction_share(one, noise) for v, one in of.items()}


def conditions(setting: Setting, level: int, **changes: Any) -> dict[str, dict[float, float]]:
    """Return accuracy by speed on skin with and without waves, for single and repeated passes."""
    plate = tissue_of(setting, **changes)
    return {
        f"{skin}, {duration}": accuracies(one, level, setting.device, same_duration=same)
        for skin, one in (("waves", plate), ("no propagation", None))
        for duration, same in (("one pass", False), ("repeated for 320 ms", True))
    }


def observer_counts(of: dict[str, dict[float, float]]) -> bool:
    """Return whether the observer depends on waves.

    With waves it must be at chance at 4, 7 and 11 m/s. Without waves it must not be at chance there, for constant
    duration.
    """
    fast = (4.0, 7.0, 11.0)
    on_waves = all(abs(of["waves, one pass"][v] - 50.0) <= CHANCE for v in fast)
    without = all(abs(of["no propagation, repeated for 320 ms"][v] - 50.0) > CHANCE for v in fast)
    return on_waves and without


def _chance(speed: float, **changes: Any) -> Callable[[Setting], Answer]:
    def number(setting: Setting, level: int) -> float:
        return accuracies(tissue_of(setting, **changes), level, setting.device)[speed]

    def answer(setting: Setting) -> Answer:
        level = level_of(setting)
        of = conditions(setting, level, **changes)
        shown = {f"{what} [%]": one[speed] for what, one in of.items()}
        plate = tissue_of(setting, **changes)
        for memory in OTHER_INTEGRATION_s:
            other = accuracies(plate, level, setting.device, integration_s=memory)
            shown[f"waves, memory of {1e3 * memory:g} ms [%]"] = other[speed]
        for easy in OTHER_EASY:
            shown[f"waves, {100 * easy:g} % right at 0.5 and 1 m/s [%]"] = accuracies(
                plate, level, setting.device, easy=easy
            )[speed]
        note = (
            f"noise fitted to {100 * EASY:g} % at 0.5 and 1 m/s, memory {1e3 * INTEGRATION_s:g} ms; the observer "
            f"{'counts' if observer_counts(of) else 'does not count: see the controls in the notes'}"
        )
        return answered(
            number, setting, changes=changes, margin=lambda v: CHANCE - abs(v - 50.0), note=note, shown=shown
        )

    return answer


def _falls(**changes: Any) -> Callable[[Setting], Answer]:
    def number(setting: Setting, level: int) -> float:
        plate = tissue_of(setting, **changes)
        of = accuracies(plate, level, setting.device)
        wakes = wakes_cm(setting, level, FELT, **changes)
        order = sorted(FELT, key=lambda v: wakes[v])
        return float(np.diff([of[v] for v in order]).max())

    def answer(setting: Setting) -> Answer:
        level = level_of(setting)
        of = accuracies(tissue_of(setting, **changes), level, setting.device)
        wakes = wakes_cm(setting, level, FELT, **changes)
        shown = {f"{v:g} m/s, wake {wakes[v]:.1f} cm [%]": of[v] for v in sorted(FELT, key=lambda v: wakes[v])}
        note = "the largest rise from one wake length to the next [points]"
        return answered(number, setting, changes=changes, margin=lambda v: 2.0 - v, note=note, shown=shown)

    return answer


def _duration(speed: float) -> Callable[[Setting], Answer]:
    return lambda setting: Answer(1e3 * PATH_m / speed, 0.0, note="16 cm over the speed along the path")


VARIED: dict[str, Callable[..., Callable[[Setting], Answer]]] = {
    "R16-R18l": _grows,
    "R16-R18m": _long,
    "R16-R18p": _concentrated,
    "R19a": lambda **changes: _chance(4.0, **changes),
    "R19b": lambda **changes: _chance(7.0, **changes),
    "R19c": lambda **changes: _chance(11.0, **changes),
    "R19d": _falls,
}
"""Answers for slabs with changed fields, to find causes."""
ANSWERS = {**{name: make() for name, make in VARIED.items()}, "R19k": _duration(0.5), "R19l": _duration(11.0)}
