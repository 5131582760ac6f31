"""What a modulation of 200 Hz makes of the radiation pressure: its mean and its lines at f and 2f."""

import numpy as np

from palmfield.config.stimulus import StimulusConfig
from palmfield.stimulus.schedule import frames_at

times = np.arange(0.0, 0.1, 1e-4)
for quantity in ("amplitude", "arp"):
    keys = StimulusConfig(modulation="am", am_quantity=quantity, am_frequency_Hz=200.0, am_depth=1.0)
    _, course = frames_at(keys, times)
    lines = [2.0 * abs(np.mean(course * np.exp(2j * np.pi * f * times))) for f in (200.0, 400.0)]
    print(f"AM of the {quantity}: mean {course.mean():.3f}, {lines[0]:.3f} at f, {lines[1]:.3f} at 2f")
