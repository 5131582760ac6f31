"""Compute maps of the sensation level: levels above threshold at each vertex of a skin, from a result.

from palmfield.outputs import open_result
from palmfield.outputs.levels import level_maps
with open_result("out/palm") as result:
    level = level_maps(result)["level"].sel(observer="bolanowski_1988")
"""

import numpy as np
import xarray as xr

from palmfield.errors import OutputError, refuse_unknown
from palmfield.hand.triangles import vertex_areas
from palmfield.outputs.motion import PIECE_BYTES, normal_component
from palmfield.outputs.recorded_keys import keys_of
from palmfield.outputs.schema import has_records, instances
from palmfield.perception.maps import felt_lines, level_map, lines_in, lines_of, too_little_skin, wanted_s
from palmfield.perception.observers import OBSERVERS, levels_dB_SL
from palmfield.stimulus.resolved_keys import ResolvedStimulus
from palmfield.stimulus.schedule import main_frequencies, repeat_rate_Hz, steady_stretch_s, turn_rate_Hz
from palmfield.types import Float32


def level_maps(result: xr.DataTree, skin: str | None = None, stimulus: str | None = None) -> xr.Dataset:
    """Return levels above threshold of each contact observer at each vertex, in the steady part of a run.

    result: as returned by `open_result` or `tree`, of a run that began at 0 s; skin, stimulus: instances, the only
    ones by default. The level includes all lines (`palmfield.perception.maps.felt_lines`), whose frequencies are an
    attribute. Returns `level` [dB SL], dimensions (observer, vertex); attributes skin, stimulus and frequencies_Hz.
    The level is NaN if the table of an observer has none of the lines, or if more skin moved in its study; it is -inf
    for a vertex at rest. Each vertex is treated separately, without summation over area. The force observer has no
    map, because it does not depend on the motion of the skin.
    Raises OutputError for an unknown instance, several instances without a name, a result without displacement, and a
    result shorter than two periods of the main frequency.
    """
    chosen, sounding = _one(result, "skin", skin), _one(result, "stimulus", stimulus)
    data = instances(result, "skin")[chosen]
    if not has_records(data, "displacement"):
        raise OutputError(f"skin '{chosen}' contains no displacement; run at least one step with the skin first")
    config = keys_of(ResolvedStimulus, sounding, instances(result, "stimulus")[sounding])
    times = data["time"].values.astype(float)
    begin, end = steady_stretch_s(config)
    steady = (times >= begin) & (times <= end)
    frequencies = felt_lines(times[steady], config)
    if not frequencies:
        lines = main_frequencies(config)
        needed = f"{wanted_s(config)[1]} with 3 samples in each" if lines else "a stimulus that repeats"
        raise OutputError(f"the record of skin '{chosen}' has no line; a map needs {needed}: run for longer")
    normal = np.asarray(normal_component(data))[steady]
    areas = vertex_areas(data["rest_position"].values, data["face"].values)
    amplitudes = lines_of(times[steady], normal, frequencies)
    levels = np.stack(
        [
            np.full(len(areas), np.nan)
            if too_little_skin(one, amplitudes, areas)
            else levels_dB_SL(one, frequencies, amplitudes)
            for one in OBSERVERS.values()
        ]
    )
    return xr.Dataset(
        {"level": (("observer", "vertex"), levels, {"units": "dB", "long_name": "level above threshold"})},
        {"observer": list(OBSERVERS)},
        {"skin": chosen, "stimulus": sounding, "frequencies_Hz": frequencies},
    )


FLOOR_DB = -40.0
"""Lower limit of levels over time [dB SL]. Lower levels, and rest, are set to this value."""
WINDOW_PERIODS = 2


class LevelCourse:
    """Level above threshold at each vertex of a skin, for one observer, in successive windows of a run.

    frequencies_Hz: evaluated lines
    window_s: length of a window, WINDOW_PERIODS periods of the lowest line
    The motion in each window is assumed to be periodic, and each vertex is treated separately. The motion of only one
    window is in memory.
    """

    def __init__(self, skin: xr.Dataset, observer: str, frequencies_Hz: list[float]):
        """skin: as returned by `instances(result, "skin")`

        Raises OutputError for a skin whose record has no usable line.
        """
        self._skin, self._observer = skin, OBSERVERS[observer]
        times = skin["time"].values.astype(float)
        self.frequencies_Hz = lines_in(times, frequencies_Hz)
        if not self.frequencies_Hz:
            raise OutputError("the record has no line; levels need two periods of the repeating load: run for longer")
        self.window_s = WINDOW_PERIODS / self.frequencies_Hz[0]
        step = float(times[1] - times[0])
        self.count = max(1, int((times[-1] - times[0] + step) / self.window_s + 1e-6))
        self._begin = float(times[0])
        begins = self._begin + self.window_s * np.arange(self.count)
        self._starts = np.searchsorted(times, begins - 0.5 * step)
        self._ends = np.searchsorted(times, begins + self.window_s - 0.5 * step)
        self._cached: dict[int, Float32] = {}

    def window_at(self, time_s: float) -> int:
        """Return the window that contains a time [s].

        For the incomplete rest at the end, return the last complete window.
        """
        return min(self.count - 1, max(0, int((time_s - self._begin) / self.window_s + 1e-9)))

    def levels(self, window: int) -> Float32:
        """Return levels [dB SL] in a window, shape (vertices,), at least FLOOR_DB."""
        if window in self._cached:
            return self._cached[window]
        chosen = slice(int(self._starts[window]), int(self._ends[window]))
        normal = normal_component(self._skin, times=chosen)
        times = self._skin["time"].values[chosen].astype(float)
        found = level_map(self._observer, times, np.asarray(normal), self.frequencies_Hz)
        levels = np.maximum(found, FLOOR_DB).astype(np.float32)
        if self.count * levels.nbytes <= PIECE_BYTES:
            self._cached[window] = levels
        return levels


def level_course(result: xr.DataTree, skin: str, observer: str) -> LevelCourse:
    """Return the level on a skin over time, from the spectral lines of all stimuli.

    Raises OutputError for an unknown observer, and if the stimuli or the record have no usable lines.
    """
    refuse_unknown(OutputError, "observer {} is unknown", observer, OBSERVERS)
    data = instances(result, "skin")[skin]
    if not has_records(data, "displacement"):
        raise OutputError(f"skin '{skin}' contains no displacement")
    lines, times = set[float](), data["time"].values.astype(float)
    for name, stimulus in instances(result, "stimulus").items():
        config = keys_of(ResolvedStimulus, name, stimulus)
        own = felt_lines(times, config)
        # A path with varying level has lines that a short record cannot separate; they are not used
        lines |= {*own, *(main_frequencies(config) if own or repeat_rate_Hz(config) == turn_rate_Hz(config) else ())}
    return LevelCourse(data, observer, sorted(lines))


def _one(result: xr.DataTree, kind: str, name: str | None) -> str:
    names = list(instances(result, kind))
    if name is None and len(names) == 1:
        return names[0]
    if name is None:
        raise OutputError(f"the result contains {len(names)} instances of {kind}: {', '.join(names)}; name one of them")
    refuse_unknown(OutputError, f"{kind} {{}} is unknown", name, names)
    return name
