"""Open, step, inspect and record a scene.

import palmfield
sim = palmfield.Simulation("mjcf/scenes/palm_am200.xml")
sim.run(0.01)
print(sim.skin().displacement)

`palmfield.load` and `palmfield.recover` are public; this package contains the objects that they use.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
