"""Compute levels above threshold of a run, by observer, from the force on the palm and from the motion of the skin.

Each observer has a level, a reason why it applies or is refused, and a spread.
"""

import math
from typing import Any

import numpy as np

from palmfield.estimate.array_inputs import stimulus_of
from palmfield.hand.labels import PALM_AREAS
from palmfield.hand.regions import region_at
from palmfield.hand.triangles import vertex_areas
from palmfield.perception.force_threshold import FORCE_OBSERVER, force_level_dB_SL, force_near_peak_N, why_refused
from palmfield.perception.maps import MOVED_SHARE, felt_lines, lines_in, lines_of, too_little_skin, wanted_s
from palmfield.perception.observers import OBSERVERS, Observer, level_dB_SL, line_amplitudes, threshold_m
from palmfield.session.loudest_moment import LoudestMoment
from palmfield.simulation.model import HapticModel
from palmfield.simulation.posed_scene import PosedScene
from palmfield.simulation.radiation import Radiation
from palmfield.stimulus.schedule import main_frequencies, steady_stretch_s
from palmfield.types import Float

CLOCK_S = 1e-9
"""Tolerance of times of records relative to the schedule [s]."""
STILL_m = 1e-3
"""Largest distance of a point from its reference pose at which a skin counts as at rest [m]."""


def felt_levels(
    model: HapticModel,
    skin: int,
    loudest: LoudestMoment | None,
    radiation: Radiation,
    reference: PosedScene,
    times: Float,
    normal: Float,
    arp_peaks: Float,
    *,
    begun_s: float = 0.0,
) -> dict[str, Any]:
    """Return the levels of one skin by all observers, units in the names: contact (`contact_levels`) and force.

    loudest: loudest moment on the skin, None in silence; radiation: radiation of the model; reference: scene in its
    reference pose; times: times from the start of the run, evenly spaced [s], shape (t,).
    normal: displacement along the outward normal [m], shape (t, S); arp_peaks: highest ARP on the skin [Pa], shape
        (t,).
    begun_s: MuJoCo time at the start of the run [s], which is added to `times` for start and stop of stimuli.
    Lines are those of the interval between ramp and silence (`steady_stretch_s`), since silent parts have no level.
    The force observer has only `level_NAME_why` if it is refused; otherwise also force_line_N (peak amplitude at the
    main frequency) and force_mean_N, both on force_area_m2 around the highest ARP. All observers are refused if no
    sound acts on the skin, if the interval is shorter than two periods of the main frequency, and if the load is not
    periodic and so has no main frequency.
    """
    config = model.stimuli[stimulus_of(model, skin)].config
    main = main_frequencies(config)
    if not main:
        return _all_refused(None, "the load does not repeat, but levels need a periodic motion")
    if loudest is None:
        return _all_refused(main[0], "no sound acts on this skin")
    loudest_Pa = float(arp_peaks.max())
    begin, end = steady_stretch_s(config)
    steady = slice(*np.searchsorted(begun_s + times, [begin - CLOCK_S, end + CLOCK_S]))
    times, normal, arp_peaks = times[steady], normal[steady], arp_peaks[steady]
    frequencies = felt_lines(times, config)
    vertices, faces = model.skins[skin].nodes[0], model.skins[skin].faces
    motion = contact_levels(times, normal, frequencies, vertex_areas(vertices, faces))
    name = FORCE_OBSERVER.name
    refusal = _refused(model, skin, loudest, radiation, reference)
    if not motion:
        lasts_ms = 1e3 * float(np.ptp(times)) if len(times) else 0.0
        needed_s, of_what = wanted_s(config)
        reason = (
            f"this run has {lasts_ms:.3g} ms between ramp and silence; a level needs {of_what}, "
            f"{1e3 * needed_s:.4g} ms: run for longer"
        )
        return _all_refused(main[0], reason) | _refusal(name, refusal or reason)
    if refusal is not None:
        return motion | _refusal(name, refusal)
    unit = radiation.on(loudest.posed, skin, "nodes", loudest.drive).arp
    force = loudest.factor * force_near_peak_N(vertices, faces, unit, FORCE_OBSERVER.area_m2)
    course = force * arp_peaks / loudest_Pa
    line = float(line_amplitudes(times, course[:, None], frequencies[0])[0])
    level = force_level_dB_SL(FORCE_OBSERVER, line)
    return motion | {
        "force_line_N": line,
        "force_mean_N": float(course.mean()),
        "force_area_m2": FORCE_OBSERVER.area_m2,
        f"level_{name}_dB_SL": level if math.isfinite(level) else None,
        f"level_all_lines_{name}_dB_SL": None,
        f"level_{name}_spread_dB": FORCE_OBSERVER.spread_dB,
        f"level_{name}_spread_of": FORCE_OBSERVER.spread_of,
        f"level_{name}_why": f"applies: {FORCE_OBSERVER.why}; mean force {1e3 * course.mean():.2g} mN here, "
        f"{1e3 * FORCE_OBSERVER.mean_N:g} mN in the measurement",
    }


def contact_levels(times: Float, normal: Float, frequencies: list[float], areas: Float) -> dict[str, Any]:
    """Return the level above threshold by contact observer, of all lines, of the strongest, and at the main frequency.

    times: [s], shape (t,), evenly spaced. normal: displacement [m], shape (t, S).
    frequencies: evaluated lines, main one first [Hz]. areas: areas of the vertices [m^2], shape (S,).
    Levels are those of the vertex that moves most. If the thresholds of an observer depend on area, also
    `level_area_NAME_dB_SL`, for all lines, with the area `level_area_NAME_m2` on which the weighted amplitude
    exceeds MOVED_SHARE of its largest.
    None outside the table of an observer; empty for less than two periods of the main frequency.
    """
    frequencies = lines_in(times, frequencies)
    if not frequencies:
        return {}
    lines = lines_of(times, normal, frequencies)
    most = lines[:, int(np.maximum(normal.max(axis=0), -normal.min(axis=0)).argmax())]
    result: dict[str, Any] = {"main_frequency_Hz": frequencies[0], "main_line_amplitude_m": float(most[0])}
    result["line_frequencies_Hz"] = frequencies
    for name, observer in OBSERVERS.items():
        if refusal := too_little_skin(observer, lines, areas):
            result |= _refusal(name, refusal)
            continue
        for key, count in (("level", 1), ("level_all_lines", len(frequencies))):
            result[f"{key}_{name}_dB_SL"] = _finite(level_dB_SL(observer, frequencies[:count], most[:count]))
        each = np.nan_to_num(most / threshold_m(observer, frequencies), nan=0.0)
        if len(frequencies) > 1 and (strongest := float(each.max())) > 0.0:
            result[f"strongest_line_{name}_Hz"] = frequencies[int(each.argmax())]
            result[f"level_strongest_line_{name}_dB_SL"] = 20.0 * math.log10(strongest)
        if observer.summation is not None:
            area = moved_area_m2(observer, frequencies, lines, areas)
            summed = _finite(level_dB_SL(observer, frequencies, most, area)) if area > 0.0 else None
            result |= {f"level_area_{name}_dB_SL": summed, f"level_area_{name}_m2": area}
        result[f"level_{name}_spread_dB"] = observer.spread_dB
        result[f"level_{name}_spread_of"] = observer.spread_of
        result[f"level_{name}_why"] = _why(observer, frequencies, most)
    return result


def _refusal(name: str, reason: str) -> dict[str, Any]:
    """Return the entries of a refused observer."""
    return {
        f"level_{name}_dB_SL": None,
        f"level_all_lines_{name}_dB_SL": None,
        f"level_{name}_why": f"refused: {reason}",
    }


def _all_refused(frequency: float | None, reason: str) -> dict[str, Any]:
    """Return the entries if all observers are refused. frequency: main one [Hz], None for an aperiodic load."""
    refusals: dict[str, Any] = {"main_frequency_Hz": frequency}
    for name in (FORCE_OBSERVER.name, *OBSERVERS):
        refusals |= _refusal(name, reason)
    return refusals


def moved_area_m2(observer: Observer, frequencies: list[float], lines: Float, areas: Float) -> float:
    """Return the area on which motion weighted by thresholds exceeds MOVED_SHARE of its maximum [m^2].

    Only lines whose thresholds depend on area are used; 0 if there are none.
    frequencies: frequencies of the lines [Hz], (n,). lines: peak amplitudes at the vertices [m], (n, S). areas: areas
    of the vertices
        [m^2], (S,).
    """
    assert observer.summation is not None
    low, high = observer.summation.low_Hz, observer.summation.high_Hz
    summed = [number for number, f in enumerate(frequencies) if low <= f <= high]
    if not summed:
        return 0.0
    thresholds = threshold_m(observer, np.array(frequencies)[summed])
    weighted = np.sqrt(((lines[summed] / thresholds[:, None]) ** 2).sum(axis=0))
    return float(areas[weighted > MOVED_SHARE * weighted.max()].sum())


def _why(observer: Observer, frequencies: list[float], amplitudes: Float) -> str:
    inside = np.isfinite(threshold_m(observer, frequencies))
    if not inside.any():
        low, high = observer.frequency_Hz[[0, -1]]
        return f"refused: its table covers {low:g} to {high:g} Hz, but the main line is at {frequencies[0]:g} Hz"
    moves = bool((amplitudes[inside] > 0.0).any())
    return f"applies: {observer.why}" if moves else "refused: the skin does not move at any frequency of its table"


def _finite(level: float) -> float | None:
    return float(level) if math.isfinite(level) else None


def _refused(
    model: HapticModel, skin: int, loudest: LoudestMoment, radiation: Radiation, reference: PosedScene
) -> str | None:
    """Return why the measurement of the force observer does not cover this sound and skin; None if it does."""
    sounding = [stimulus for stimulus in model.stimuli if not stimulus.silent]
    if len(sounding) > 1:
        return f"it was measured with one focus, but {len(sounding)} stimuli are active"
    config = model.skins[skin].spec.config
    if config.shape not in ("hand", "articulated"):
        return f"it was measured on palms, but shape '{config.shape}' has no known palm"
    arp = radiation.on(loudest.posed, skin, "nodes", loudest.drive).arp
    region = region_at(config.hand, model.skins[skin].nodes[0][int(arp.argmax())])
    if region not in PALM_AREAS:
        return f"it was measured on palms, but the loudest point lies on '{region}'"
    now, at_rest = (scene.skins[skin].nodes[0] for scene in (loudest.posed, reference))
    moved_m = np.linalg.norm(now - at_rest, axis=1).max()
    if model.spec.skins[skin].moves or sounding[0].spec.frame_moves or moved_m > STILL_m:
        return "it was measured with hand and focus at rest, but in this scene one of them moves"
    return why_refused(sounding[0].config)
