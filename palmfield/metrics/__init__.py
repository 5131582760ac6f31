"""Metrics of signals, maps and snapshots in SI units; each choice in a definition is an argument.

from palmfield.metrics import overshoot, settling_time, steady_value
steady = steady_value(times, trace, (0.18, 0.2))
print(overshoot(times, trace, steady), settling_time(times, trace, steady, band=0.05, end_s=0.2))
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
