"""Write a stimulus as a pattern of Adaptics: with its AM, circle or corners if they are exact, else from samples."""

import json
import math
from pathlib import Path

import numpy as np

from palmfield.config.stimulus import StimulusConfig
from palmfield.errors import SceneError
from palmfield.files import write_text
from palmfield.stimulus.adaptics import FORMAT, REVISIONS
from palmfield.stimulus.autd3_stm import MM
from palmfield.stimulus.focus_table import FocusTable
from palmfield.stimulus.schedule import frame_rates, frames_at, plane_path, turn_m, turn_rate_Hz
from palmfield.types import Float

WIDEST_MM = 100.0
"""Largest |x| and |y| of a keyframe in the format, and largest z above the lowest keyframe."""
EXACT, EXACT_MM, POLYGON = 1e-9, 1e-6, 1e-4
"""Largest deviation of AM; of positions [mm]; of a circle, which palmfield draws as a polygon, by its radius."""


def write_adaptics(file: Path, table: FocusTable, config: StimulusConfig) -> tuple[str, ...]:
    """Write a table as a pattern, and return notes about it. config: the stimulus of which the table has samples

    Raises SceneError for several foci, another frame, and positions out of the range of the format; OutputError if the
    file cannot be written.
    """
    if table.foci > 1 or table.frame != "array":
        raise SceneError(f"{file}: foci {table.foci}, frame {table.frame}; allowed in Adaptics: foci 1, frame array")
    loud, am_Hz, notes = table.intensities[:, 0], config.am_frequency_Hz or 0.0, list[str]()
    wave = 0.5 + 0.5 * np.sin(2.0 * np.pi * am_Hz * table.times)
    if config.modulation == "am" and not config.control_rate_Hz and np.abs(loud - wave).max() < EXACT:
        loud = np.ones(1)
        notes += ["the AM of Adaptics begins at its loudest moment, a quarter of a period earlier than here"]
    else:
        am_Hz = 0.0
    exact = _exact(table, config)
    times, places, brush = exact or (table.times, MM * table.positions[:, 0], {"radius": 0.0})
    held = bool(frame_rates(config))
    if np.ptp(loud) > 0.0 or exact is None:
        every = np.arange(table.length_samples + (table.between == "linear")) / table.rate_Hz
        sampled = table.times if held else every
        places = np.repeat(places, len(sampled), 0) if len(times) == 1 else MM * table.positions_at(sampled)[:, 0]
        loud = np.ones(len(sampled)) if am_Hz else table.intensities_at(sampled)[:, 0]
        change = np.any(np.diff(np.column_stack([places, loud]), axis=0) != 0.0, axis=1)
        kept = np.append(True, change) | np.append(change, True)
        times, places, loud = sampled[kept], places[kept], loud[kept]
    lowest = float(places[:, 2].min())
    places = np.round(places - [0.0, 0.0, lowest], 9)
    if np.abs(places).max() > WIDEST_MM:
        row, axis = np.unravel_index(np.abs(places).argmax(), places.shape)
        raise SceneError(
            f"{file}: {'xyz'[axis]} is {places[row, axis]:g} mm at {times[row]:g} s; allowed in Adaptics: x and y from "
            f"-{WIDEST_MM:g} to {WIDEST_MM:g} mm, z up to {WIDEST_MM:g} mm above the lowest point"
        )
    course: dict[str, object] = {"name": "step" if held else "linear", "params": {}}
    points = [{"coords": dict(zip("xyz", place, strict=True)), "transition": course} for place in places.tolist()]
    frames: list[dict[str, object]] = [
        {"type": "standard", "time": time, "coords": point, "cjumps": []}
        for time, point in zip((1e3 * times).tolist(), points, strict=True)
    ]
    for frame, level in zip(frames, loud.tolist() if np.ptp(loud) > 0.0 else loud[:1].tolist(), strict=False):
        intensity = {"name": "constant", "params": _numbers(value=level)}
        frame["intensity"] = {"intensity": intensity, "transition": course}
    name = "circle" if "radius" in brush else "lissajous"
    shape = {"name": name, "params": _numbers(am_freq=am_Hz, **brush)}
    frames[0]["brush"] = {"brush": shape, "transition": course}
    frames.append({"type": "stop", "time": 1e3 * table.length_s})
    shift, scale = _numbers(x=0.0, y=0.0, z=lowest), _numbers(x=1.0, y=1.0, z=1.0)
    moves = {"translate": shift, **_numbers(rotation=0.0), "scale": scale}
    whole = {"geometric_transforms": moves, **_numbers(intensity_factor=1.0, playback_speed=1.0)}
    content = {"$DATA_FORMAT": FORMAT, "$REVISION": REVISIONS[0], "name": file.stem, "keyframes": frames,
               "pattern_transform": whole, "user_parameter_definitions": {}}  # fmt: skip
    write_text(file, json.dumps(content, indent=1) + "\n")
    return (f"{len(frames)} keyframes with {course['name']} transitions, brush {name}", *notes)


def _numbers(**values: float) -> dict[str, object]:
    return {name: {"type": "f64", "value": value} for name, value in values.items()}


def _exact(table: FocusTable, config: StimulusConfig) -> tuple[Float, Float, dict[str, float]] | None:
    """Return times [s] and positions [mm] of the ends of straight lines, and a brush, that give the path exactly."""
    times, places = table.times, MM * table.positions[:, 0]
    if np.ptp(places, axis=0).max() < EXACT_MM:
        return np.zeros(1), places[:1], {"radius": 0.0}
    rate, shape = turn_rate_Hz(config), plane_path(config)
    if rate is None or shape is None or frame_rates(config):
        return None
    if config.path == "circle":
        radius, turn = 0.5 * MM * (config.path_diameter_m or 0.0), 2.0 * np.pi * rate * times
        for x, y in ((radius, radius), (radius, -radius), (-radius, radius), (-radius, -radius)):
            centres = places - np.stack([x * np.cos(turn), y * np.sin(turn), 0.0 * turn], axis=1)
            if np.ptp(centres, axis=0).max() < 2.0 * POLYGON * radius + EXACT_MM:
                other = {"x_scale": x, "y_scale": y, "rotation": 0.0, "a": 1.0, "b": 1.0, "d": 0.5 * math.pi}
                return np.zeros(1), centres.mean(0)[None], {"stm_freq": rate} | ({"radius": x} if x == y > 0 else other)
        return None
    arcs, length = shape.corner_arcs, turn_m(config)
    arcs = np.union1d(arcs, length - arcs) if length > 1.5 * shape.length_m else arcs
    turns = np.arange(math.ceil(table.length_s * rate))[:, None]
    corners = np.unique(np.minimum((turns + arcs / length) / rate, table.length_s))
    if len(corners) > len(times):
        return None
    # The frame of the stimulus in that of the array, if it rests
    given, ends = (np.column_stack([np.ones(len(t)), frames_at(config, t)[0]]) for t in (times, corners))
    ends = ends @ np.linalg.lstsq(given, places, rcond=None)[0]
    drawn = np.stack([np.interp(times, corners, axis) for axis in ends.T], axis=1)
    return None if np.abs(drawn - places).max() > EXACT_MM else (corners, ends, {"radius": 0.0})
