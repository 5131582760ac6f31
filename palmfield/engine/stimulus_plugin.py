"""The plugin of one stimulus: its keys."""

from typing import ClassVar

from palmfield.config import Config, StimulusConfig
from palmfield.engine.host import Module


class StimulusModule(Module):
    """Holds the stimulus's keys."""

    name: ClassVar[str] = StimulusConfig.plugin
    config: ClassVar[type[Config]] = StimulusConfig
