"""The coupled scene: what it says, the model made of it, its state, and one step of the pipeline.

SceneSpec -> build -> HapticModel -> step(model, state, posed, t0, t1) -> what observers see.

`palmfield.simulation.build.build` and `palmfield.simulation.step.step` are the two verbs; here are their nouns.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
