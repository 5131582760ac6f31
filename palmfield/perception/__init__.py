"""From the skin's motion to what is felt: level above threshold, by named observers.

from palmfield.perception import OBSERVERS, level_dB_SL, line_amplitude
amplitude = line_amplitude(times, displacement, 200.0)
print({name: level_dB_SL(observer, [200.0], [amplitude]) for name, observer in OBSERVERS.items()})
"""

from typing import TYPE_CHECKING

from palmfield.lazy_names import lazy_names

if TYPE_CHECKING:
    from palmfield.perception.observers import (
        OBSERVERS,
        Observer,
        level_dB_SL,
        line_amplitude,
        share_left_out,
        threshold_m,
    )

_WHERE = {
    **dict.fromkeys(
        ("OBSERVERS", "Observer", "level_dB_SL", "line_amplitude", "share_left_out", "threshold_m"), "observers"
    ),
}
__all__ = [
    "OBSERVERS",
    "Observer",
    "level_dB_SL",
    "line_amplitude",
    "share_left_out",
    "threshold_m",
]
__getattr__, __dir__ = lazy_names(__name__, _WHERE)
