"""From force and motion to what is felt: level above threshold, by named observers.

from palmfield.perception import OBSERVERS, level_dB_SL, line_amplitude
amplitude = line_amplitude(times, displacement, 200.0)
print({name: level_dB_SL(observer, [200.0], [amplitude]) for name, observer in OBSERVERS.items()})
"""

from typing import TYPE_CHECKING

from palmfield.lazy_names import lazy_names

if TYPE_CHECKING:
    from palmfield.perception.detection import detection_probability, summed_gain
    from palmfield.perception.direction import direction_share, level_course, noise_for, separation
    from palmfield.perception.force_threshold import FORCE_OBSERVER, ForceObserver, force_level_dB_SL, force_near_peak_N
    from palmfield.perception.maps import level_map
    from palmfield.perception.observers import (
        OBSERVERS,
        AreaSummation,
        Observer,
        TemporalSummation,
        level_dB_SL,
        levels_dB_SL,
        line_amplitude,
        line_amplitudes,
        threshold_m,
    )
    from palmfield.perception.registry import ALL_OBSERVERS

_WHERE = {
    **dict.fromkeys(("detection_probability", "summed_gain"), "detection"),
    "level_map": "maps",
    **dict.fromkeys(("direction_share", "level_course", "noise_for", "separation"), "direction"),
    **dict.fromkeys(("FORCE_OBSERVER", "ForceObserver", "force_level_dB_SL", "force_near_peak_N"), "force_threshold"),
    **dict.fromkeys(
        (
            "OBSERVERS",
            "AreaSummation",
            "Observer",
            "TemporalSummation",
            "level_dB_SL",
            "levels_dB_SL",
            "line_amplitude",
            "line_amplitudes",
            "threshold_m",
        ),
        "observers",
    ),
    "ALL_OBSERVERS": "registry",
}
__all__ = [
    "ALL_OBSERVERS",
    "FORCE_OBSERVER",
    "OBSERVERS",
    "AreaSummation",
    "ForceObserver",
    "Observer",
    "TemporalSummation",
    "detection_probability",
    "direction_share",
    "force_level_dB_SL",
    "force_near_peak_N",
    "level_course",
    "level_dB_SL",
    "level_map",
    "levels_dB_SL",
    "line_amplitude",
    "line_amplitudes",
    "noise_for",
    "separation",
    "summed_gain",
    "threshold_m",
]
__getattr__, __dir__ = lazy_names(__name__, _WHERE)
