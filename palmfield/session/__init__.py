"""A scene as a user has it: opened, stepped, looked at, recorded.

import palmfield
sim = palmfield.Simulation("mjcf/scenes/palm_am200.xml")
sim.run(0.01)
print(sim.skin().displacement)

`palmfield.load` and `palmfield.recover` are public there; here are the objects that they give and take.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
