from .mujoco_view import DataView as DataView
from .mujoco_view import ForceOutlet as ForceOutlet
from .mujoco_view import ModelView as ModelView
from .mujoco_view import PluginSensor as PluginSensor
