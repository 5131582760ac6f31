"""Perception of force and motion: level above threshold, by named observers.

from palmfield.perception import OBSERVERS, level_dB_SL, line_amplitude
amplitude = line_amplitude(times, displacement, 200.0)
print({name: level_dB_SL(observer, [200.0], [amplitude]) for name, observer in OBSERVERS.items()})
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
