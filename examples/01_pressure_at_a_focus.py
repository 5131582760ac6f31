"""The field of an array focused on one point: pressure, radiation pressure, and what shading costs."""

import numpy as np

from palmfield.acoustics import layout, pressure
from palmfield.acoustics.arp import arp
from palmfield.acoustics.focus import focus
from palmfield.types import Air

array, air = layout("uhev1"), Air(temperature_C=22.0)
target = np.array([0.0, 0.0, 0.2])
drive = focus(array, air, target)

along = np.linspace(0.15, 0.25, 101)
points = np.column_stack([np.zeros((101, 2)), along])
amplitude = np.abs(pressure(points, array, drive, air).pressure)
print(f"{amplitude.max():.0f} Pa at z = {1e3 * along[amplitude.argmax()]:.0f} mm for a focus at 200 mm")

there = pressure(target[None], array, drive, air, gradient=True)
push = arp(there, np.array([[0.0, 0.0, -1.0]]), air, array.frequency_Hz)
print(f"ARP on skin that faces the array: {push[0]:.2f} Pa")
