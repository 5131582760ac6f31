"""The coupled scene: its spec, the model built from it, its state, and one step of the pipeline.

SceneSpec -> build -> HapticModel -> step(model, state, posed, t0, t1) -> observers.

The functions are `palmfield.simulation.build.build` and `palmfield.simulation.step.step`; the types are defined here.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
