"""MuJoCo's model and data as plugins see them: structs, names, poses, states and forces."""

from typing import TYPE_CHECKING

# First of all: on import MuJoCo registers palmfield's plugins, which import this package's modules.
import mujoco as mujoco

from palmfield.lazy_names import lazy_names

if TYPE_CHECKING:
    from palmfield.mujoco_host.mujoco_view import DataView, ForceOutlet, ModelView, PluginSensor

_WHERE = {
    **dict.fromkeys(("DataView", "ForceOutlet", "ModelView", "PluginSensor"), "mujoco_view"),
}
__all__ = [
    "DataView",
    "ForceOutlet",
    "ModelView",
    "PluginSensor",
]
__getattr__, __dir__ = lazy_names(__name__, _WHERE)
