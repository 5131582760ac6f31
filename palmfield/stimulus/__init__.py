"""What a focus does on the skin, without scenes: plane shapes, paths along the surface, bursts.

from palmfield.stimulus.curves import circle
from palmfield.stimulus.surface_path import drawn
path = drawn(hand.surface, hand.landmarks["palm_centre"], [1.0, 0.0, 0.0], circle(0.03))
positions, normals = path.at(speed_m_s * times, hand.surface.vertices, hand.surface.faces)
"""
