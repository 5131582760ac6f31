"""Levels of populations of afferents in a finished run, from the recorded motion at their endings."""

import math
from typing import Any

import numpy as np
import xarray as xr

from palmfield.config import StimulusConfig
from palmfield.estimate.sensation_levels import CLOCK_S
from palmfield.outputs.schema import has_records
from palmfield.perception.afferents import AFFERENTS
from palmfield.perception.populations import POPULATIONS, class_level_dB, spread_of, unit_levels
from palmfield.stimulus.schedule import steady_stretch_s
from palmfield.types import Float


def population_levels(skin: xr.Dataset, config: StimulusConfig, times: Float, begun_s: float = 0.0) -> dict[str, Any]:
    """Return the levels of a skin by the observers that read afferents; empty for a skin without them.

    skin: as returned by `palmfield.outputs.schema.instances`. times: times from the start of the run [s], shape (t,),
    evenly spaced; begun_s: MuJoCo time at the start of the run [s]. Levels are those between ramp and silence.
    By class: number of units, how many of them fire, and the largest level of a unit over its threshold.
    """
    if not has_records(skin, "afferent_motion") or len(times) < 2:
        return {}
    steady = steady_stretch_s(config)
    begin, end = np.searchsorted(begun_s + times, [steady[0] - CLOCK_S, steady[1] + CLOCK_S])
    step_s, classes = float(times[1] - times[0]), skin["afferent_class"].values
    levels, numbers = dict[str, Float](), dict[str, Any]()
    for name, afferent in AFFERENTS.items():
        motion = skin["afferent_motion"].values[:, classes == name]
        if motion.shape[1] and end > begin:
            own = levels[name] = unit_levels(afferent, motion, step_s, slice(int(begin), int(end)))
            numbers |= {f"afferents_{name}": len(own), f"afferents_{name}_firing": int((own >= 1.0).sum())}
            numbers[f"afferents_{name}_highest_level"] = float(own.max())
    for name, population in POPULATIONS.items():
        by_class = {one: class_level_dB(one, levels[one]) for one in population.classes if one in levels}
        decides = max(by_class, key=lambda one: by_class[one], default=None)
        level = -math.inf if decides is None else by_class[decides]
        numbers[f"level_{name}_dB_SL"] = level if math.isfinite(level) else None
        numbers[f"level_{name}_spread_dB"], numbers[f"level_{name}_spread_of"] = spread_of(decides or "pc")
        numbers[f"level_{name}_class"] = decides
        why = f"applies: {population.why}" if math.isfinite(level) else "refused: no afferent of its classes moves"
        numbers[f"level_{name}_why"] = why
    return numbers
