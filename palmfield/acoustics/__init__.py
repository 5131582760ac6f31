"""Sound of an array in air: its pressure, and the acoustic radiation pressure (ARP) on skin.

from palmfield.acoustics import FieldEvaluator, layout
from palmfield.acoustics.arp import arp
from palmfield.acoustics.focus import focus
array, air = layout("uhev1"), Air()
field = FieldEvaluator(array, air).pressure(points, focus(array, air, [0.0, 0.0, 0.2]), gradient=True)
load_Pa = arp(field, normals, air, array.frequency_Hz)
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
