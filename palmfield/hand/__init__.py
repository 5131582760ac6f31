"""Hands and other bodies: presets, checked and repaired meshes, their skin layers, and bones that move them.

from palmfield.hand import hand_surface, load_preset
hand = hand_surface(load_preset("open_men_p50"))
print(hand.surface.vertices.shape, hand.landmarks["palm_centre"])
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
