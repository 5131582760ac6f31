"""From force and motion to what is felt: level above threshold, by named observers.

from palmfield.perception import OBSERVERS, level_dB_SL, line_amplitude
amplitude = line_amplitude(times, displacement, 200.0)
print({name: level_dB_SL(observer, [200.0], [amplitude]) for name, observer in OBSERVERS.items()})
"""

from typing import TYPE_CHECKING

from palmfield.lazy_names import lazy_names

if TYPE_CHECKING:
    from palmfield.perception.force_threshold import FORCE_OBSERVER, ForceObserver, force_level_dB_SL, force_near_peak_N
    from palmfield.perception.observers import (
        OBSERVERS,
        AreaSummation,
        Observer,
        level_dB_SL,
        line_amplitude,
        line_amplitudes,
        share_left_out,
        threshold_m,
    )
    from palmfield.perception.registry import ALL_OBSERVERS

_WHERE = {
    **dict.fromkeys(("FORCE_OBSERVER", "ForceObserver", "force_level_dB_SL", "force_near_peak_N"), "force_threshold"),
    **dict.fromkeys(
        (
            "OBSERVERS",
            "AreaSummation",
            "Observer",
            "level_dB_SL",
            "line_amplitude",
            "line_amplitudes",
            "share_left_out",
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
    "force_level_dB_SL",
    "force_near_peak_N",
    "level_dB_SL",
    "line_amplitude",
    "line_amplitudes",
    "share_left_out",
    "threshold_m",
]
__getattr__, __dir__ = lazy_names(__name__, _WHERE)
