"""Levels above threshold of one vibration for every observer that has a table there."""

import numpy as np

from palmfield.perception.observers import OBSERVERS, level_dB_SL

frequencies, amplitude = (20.0, 80.0, 200.0, 400.0), 1e-6
print(f"{1e6 * amplitude:g} um of sinusoidal motion [dB above threshold]")
for observer in OBSERVERS.values():
    told = []
    for f in frequencies:
        level = level_dB_SL(observer, [f], [amplitude])
        told.append(f"{f:g} Hz: {level:.0f}" if np.isfinite(level) else f"{f:g} Hz: no value")
    print(f"{observer.name:24}", ", ".join(told))
