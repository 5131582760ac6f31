"""Skin as a viscoelastic solid: materials, bodies, loads, and solvers with a known error.

from palmfield.skin import Sheet, Slab, Spot, preset, solve
body = Slab((Sheet(preset("ecoflex_00-10"), 0.02),))
load = Spot(fwhm_m=0.0103, times_s=[0.0, 1e-3], peak_Pa=[0.0, 12.0])
motion = solve(body, load, times=[0.01, 0.05], at=[[0.0, 0.0]])
print(motion.displacement_m[:, 0, 2], motion.error)

`solve` computes a whole history. Scenes use the same SkinSteppers, on a SceneLayer.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
