"""Keys of palmfield.driver."""

from typing import ClassVar, Literal

from pydantic import Field

from palmfield.config.base import Config


class DriverConfig(Config):
    plugin: ClassVar[str] = "palmfield.driver"
    about: ClassVar[str] = "The device that plays the drive; what it can't play is not simulated either."

    device: Literal["ideal", "sonicsurface"] = Field(
        "ideal", description="ideal: continuous phase and amplitude at any rate; sonicsurface: decoded from its bytes"
    )
