"""Maps of the perceived level: levels above threshold at each vertex of a skin, from the result of a run.

from palmfield.outputs import open_result
from palmfield.outputs.levels import level_maps
with open_result("out/palm") as result:
    level = level_maps(result)["level"].sel(observer="bolanowski_1988")
"""

import numpy as np
import xarray as xr

from palmfield.errors import OutputError, refuse_unknown
from palmfield.outputs.motion import normal_component
from palmfield.outputs.recorded_keys import keys_of
from palmfield.outputs.schema import has_records, instances
from palmfield.perception.maps import felt_lines, level_map, lines_in, wanted_s
from palmfield.perception.observers import OBSERVERS
from palmfield.stimulus.resolved import ResolvedStimulus
from palmfield.stimulus.schedule import main_frequencies, repeat_rate_Hz, steady_stretch_s, turn_rate_Hz
from palmfield.types import Float32


def level_maps(result: xr.DataTree, skin: str | None = None, stimulus: str | None = None) -> xr.Dataset:
    """Return levels above threshold of each contact observer at each vertex, in the steady part of a run.

    result: of `open_result` or `tree`, of a run that began at 0 s; skin, stimulus: instances, the only ones by default.
    The level is of all lines (`palmfield.perception.maps.felt_lines`), whose frequencies are an attribute. Returns
    `level` [dB SL], dimensions (observer, vertex), NaN if an observer's table has none of the lines, -inf for a vertex
    at rest; attributes skin, stimulus and frequencies_Hz. Each vertex is treated separately, without summation over
    area. The observer based on force has no map: it does not depend on the motion of the skin.
    Raises OutputError for an unknown instance, several without a name given, a result without displacement, and one
    shorter than two periods of the main frequency.
    """
    chosen, sounding = _one(result, "skin", skin), _one(result, "stimulus", stimulus)
    data = instances(result, "skin")[chosen]
    if not has_records(data, "displacement"):
        raise OutputError(f"skin '{chosen}' holds no displacement; run at least one step with the skin first")
    config = keys_of(ResolvedStimulus, sounding, instances(result, "stimulus")[sounding])
    times = data["time"].values.astype(float)
    begin, end = steady_stretch_s(config)
    steady = (times >= begin) & (times <= end)
    frequencies = felt_lines(times[steady], config)
    if not frequencies:
        wanted = main_frequencies(config)
        told = f"{wanted_s(config)[1]} with 3 samples in each" if wanted else "a stimulus that repeats"
        raise OutputError(f"the record of skin '{chosen}' has no line; a map needs {told}: run for longer")
    normal = np.asarray(normal_component(data))[steady]
    levels = np.stack([level_map(one, times[steady], normal, frequencies) for one in OBSERVERS.values()])
    return xr.Dataset(
        {"level": (("observer", "vertex"), levels, {"units": "dB", "long_name": "level above threshold"})},
        {"observer": list(OBSERVERS)},
        {"skin": chosen, "stimulus": sounding, "frequencies_Hz": frequencies},
    )


FLOOR_DB = -40.0
"""Lower limit of levels over time: lower ones, and rest, are set to this [dB SL]."""
WINDOW_PERIODS = 2


class LevelCourse:
    """Level above threshold at each vertex of a skin, by one observer, in successive windows of a run.

    frequencies_Hz: lines that count; window_s: length of each window, WINDOW_PERIODS of the lowest of them. Each window
    is assumed to repeat, and each vertex is treated separately. A run is read one window at a time.
    """

    def __init__(self, skin: xr.Dataset, observer: str, frequencies_Hz: list[float]):
        """skin: of `instances(result, "skin")`. Raises OutputError for a skin whose record has no usable line."""
        self._skin, self._observer = skin, OBSERVERS[observer]
        times = skin["time"].values.astype(float)
        self.frequencies_Hz = lines_in(times, frequencies_Hz)
        if not self.frequencies_Hz:
            raise OutputError("the record has no line; levels need two periods of the repeating load: run for longer")
        self.window_s = WINDOW_PERIODS / self.frequencies_Hz[0]
        step = float(times[1] - times[0])
        self.count = max(1, int((times[-1] - times[0] + step) / self.window_s + 1e-6))
        begins = times[0] + self.window_s * np.arange(self.count)
        self._starts = np.searchsorted(times, begins - 0.5 * step)
        self._ends = np.searchsorted(times, begins + self.window_s - 0.5 * step)

    def window_at(self, time_s: float) -> int:
        """Return the window that contains a time [s]; the last whole one for the rest at the end."""
        begin = float(self._skin["time"].values[0])
        return min(self.count - 1, max(0, int((time_s - begin) / self.window_s + 1e-9)))

    def levels(self, window: int) -> Float32:
        """Levels [dB SL] in a window, shape (vertices,), FLOOR_DB at least."""
        chosen = slice(int(self._starts[window]), int(self._ends[window]))
        normal = normal_component(self._skin, times=chosen)
        times = self._skin["time"].values[chosen].astype(float)
        found = level_map(self._observer, times, np.asarray(normal), self.frequencies_Hz)
        return np.maximum(found, FLOOR_DB).astype(np.float32)


def level_course(result: xr.DataTree, skin: str, observer: str) -> LevelCourse:
    """Return the course of the level on a skin, by the lines of all stimuli.

    Raises OutputError for an unknown observer, and for a run without usable lines of its stimuli or record.
    """
    refuse_unknown(OutputError, "observer {} is unknown", observer, OBSERVERS)
    data = instances(result, "skin")[skin]
    if not has_records(data, "displacement"):
        raise OutputError(f"skin '{skin}' holds no displacement")
    lines, times = set[float](), data["time"].values.astype(float)
    for name, stimulus in instances(result, "stimulus").items():
        config = keys_of(ResolvedStimulus, name, stimulus)
        felt = felt_lines(times, config)
        # A path with varying level has lines that a short record cannot separate: none of them is used
        lines |= {*felt, *(main_frequencies(config) if felt or repeat_rate_Hz(config) == turn_rate_Hz(config) else ())}
    return LevelCourse(data, observer, sorted(lines))


def _one(result: xr.DataTree, kind: str, name: str | None) -> str:
    known = list(instances(result, kind))
    if name is None and len(known) == 1:
        return known[0]
    if name is None:
        raise OutputError(f"the result holds {len(known)} instances of {kind}: {', '.join(known)}; name one of them")
    refuse_unknown(OutputError, f"{kind} {{}} is unknown", name, known)
    return name
