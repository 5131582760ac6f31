"""palmfield's physics as MuJoCo plugins.

`palmfield.engine.host.register` makes a plugin of a `Module`; `raise_errors` raises what went wrong inside one:

import mujoco
from palmfield.engine import raise_errors
mujoco.mj_step(model, data)
raise_errors(data)
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

# First of all: on import MuJoCo registers palmfield's plugins, which import this package's modules.
import mujoco as mujoco

if TYPE_CHECKING:
    from palmfield.engine.host import Module, World, raise_errors, world_of

_WHERE = dict.fromkeys(("Module", "World", "raise_errors", "world_of"), "host")
__all__ = ["Module", "World", "raise_errors", "world_of"]


def __getattr__(name: str) -> Any:
    if name not in _WHERE:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    return getattr(import_module(f"{__name__}.{_WHERE[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
