"""palmfield's physics as MuJoCo plugins.

`palmfield.engine.host.register` makes a plugin of a `Module`; `raise_errors` raises what went wrong inside one:

import mujoco
from palmfield.engine import raise_errors
mujoco.mj_step(model, data)
raise_errors(data)
"""

from typing import TYPE_CHECKING

# First of all: on import MuJoCo registers palmfield's plugins, which import this package's modules.
import mujoco as mujoco

from palmfield.lazy_names import lazy_names

if TYPE_CHECKING:
    from palmfield.engine.host import Module, World, raise_errors, world_of
    from palmfield.engine.motion_plugin import place

_WHERE = {
    **dict.fromkeys(("Module", "World", "raise_errors", "world_of"), "host"),
    "place": "motion_plugin",
}
__all__ = [
    "Module",
    "World",
    "place",
    "raise_errors",
    "world_of",
]
__getattr__, __dir__ = lazy_names(__name__, _WHERE)
