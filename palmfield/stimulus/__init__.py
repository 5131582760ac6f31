"""Position and level of the focus over time, independent of scenes: schedules, shapes, surface paths, bursts.

from palmfield.stimulus import circle, drawn
path = drawn(hand.surface, hand.landmarks["palm_centre"], [1.0, 0.0, 0.0], circle(0.03))
positions, normals = path.at(speed_m_s * times, hand.surface.vertices, hand.surface.faces)
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
