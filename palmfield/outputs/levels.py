"""Where on a skin how much is felt: levels above threshold at each vertex, of a run's result.

from palmfield.outputs import open_result
from palmfield.outputs.levels import level_maps
with open_result("out/palm") as result:
    level = level_maps(result)["level"].sel(observer="bolanowski_1988")
"""

import numpy as np
import xarray as xr

from palmfield.errors import OutputError, did_you_mean
from palmfield.outputs.motion import normal_component
from palmfield.outputs.recorded_keys import keys_of
from palmfield.outputs.schema import has_records, instances
from palmfield.perception.maps import level_map, lines_in
from palmfield.perception.observers import OBSERVERS
from palmfield.stimulus.resolved import ResolvedStimulus
from palmfield.stimulus.schedule import main_frequencies, steady_stretch_s


def level_maps(result: xr.DataTree, skin: str | None = None, stimulus: str | None = None) -> xr.Dataset:
    """Level above threshold by each contact observer at each vertex, of the steady part of a run.

    result: of `open_result` or `tree`, of a run that began at 0 s; skin, stimulus: instances, the only ones by default.
    Lines are the stimulus's main frequencies that the record can tell.
    Returns `level` [dB SL], dimensions (observer, vertex), NaN where an observer's table has none of the lines, -inf
    where the vertex is at rest; attributes skin, stimulus and frequencies_Hz. Each vertex is taken by itself, without
    summation over area. The observer that goes by force has no map: it knows nothing of the skin's motion.
    Raises OutputError for an unknown instance, several of which none is named, a result without displacement, and one
    that is shorter than two periods of the main frequency.
    """
    chosen, sounding = _one(result, "skin", skin), _one(result, "stimulus", stimulus)
    data = instances(result, "skin")[chosen]
    if not has_records(data, "displacement"):
        raise OutputError(f"skin '{chosen}' holds no displacement; run at least one step with the skin first")
    config = keys_of(ResolvedStimulus, sounding, instances(result, "stimulus")[sounding])
    times = data["time"].values.astype(float)
    begin, end = steady_stretch_s(config)
    steady = (times >= begin) & (times <= end)
    frequencies = lines_in(times[steady], main_frequencies(config))
    if not frequencies:
        wanted = main_frequencies(config)
        told = f"two periods of {wanted[0]:g} Hz, 3 samples in each" if wanted else "a stimulus that repeats itself"
        raise OutputError(f"the record of skin '{chosen}' has no line to go by; a map needs {told}: run for longer")
    normal = np.asarray(normal_component(data))[steady]
    levels = np.stack([level_map(one, times[steady], normal, frequencies) for one in OBSERVERS.values()])
    return xr.Dataset(
        {"level": (("observer", "vertex"), levels, {"units": "dB", "long_name": "level above threshold"})},
        {"observer": list(OBSERVERS)},
        {"skin": chosen, "stimulus": sounding, "frequencies_Hz": frequencies},
    )


def _one(result: xr.DataTree, kind: str, name: str | None) -> str:
    known = list(instances(result, kind))
    if name is None and len(known) == 1:
        return known[0]
    if name is None:
        raise OutputError(f"the result holds {len(known)} instances of {kind}: {', '.join(known)}; name one of them")
    if name not in known:
        raise OutputError(f"{kind} '{name}'{did_you_mean(name, known)} is unknown; allowed: {', '.join(known)}")
    return name
