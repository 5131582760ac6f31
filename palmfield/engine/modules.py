"""The plugins that palmfield registers."""

from palmfield.engine.array_plugin import ArrayModule
from palmfield.engine.host import Module
from palmfield.engine.motion_plugin import MotionModule
from palmfield.engine.skin_plugin import SkinModule
from palmfield.engine.stimulus_plugin import DriverModule, StimulusModule

MODULES: tuple[type[Module], ...] = (ArrayModule, StimulusModule, DriverModule, SkinModule, MotionModule)
