"""Compute the commanded and emitted drive of transducers for focal points, and play it on boards.

from palmfield.drive import solve_foci
drive = solve_foci([[0.0, 0.0, 0.15], [0.02, 0.0, 0.15]], array, air).drive
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
