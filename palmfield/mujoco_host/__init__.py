"""Access MuJoCo's model and data from plugins: structs, names, poses, states and forces."""

import lazy_loader
import mujoco as mujoco

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
