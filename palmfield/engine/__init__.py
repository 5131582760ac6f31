"""The physics of palmfield as MuJoCo plugins.

`palmfield.engine.host.register` makes a plugin of a `Module`; `raise_errors` raises an error that occurred inside one:

import mujoco
from palmfield.engine import raise_errors
mujoco.mj_step(model, data)
raise_errors(data)
"""

import lazy_loader
import mujoco as mujoco

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
