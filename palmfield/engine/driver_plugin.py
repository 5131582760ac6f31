"""The plugin of the board that plays the drive: its keys."""

from typing import ClassVar

from palmfield.config import Config, DriverConfig
from palmfield.engine.host import Module


class DriverModule(Module):
    """Holds the keys of the board."""

    name: ClassVar[str] = DriverConfig.plugin
    config: ClassVar[type[Config]] = DriverConfig
