"""An array from single transducers on a bowl, its focus, and what a dead element does."""

import numpy as np

from palmfield.acoustics import pressure
from palmfield.acoustics.arrays import from_poses, with_faults
from palmfield.acoustics.focus import focus
from palmfield.types import Air

angle = 2.0 * np.pi * np.arange(24) / 24
radius, depth = 0.05, 0.12
places = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(24)])
middle = np.array([0.0, 0.0, depth])
bowl = from_poses("bowl", places, middle - places, p0_Pa_m=1.27)
air = Air()
drive = focus(bowl, air, middle)
for name, array in (("whole", bowl), ("three dead", with_faults(bowl, dead=(0, 8, 16)))):
    print(f"{name}: {abs(pressure(middle[None], array, drive, air).pressure[0]):.0f} Pa")
