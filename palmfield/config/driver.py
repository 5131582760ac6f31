"""Keys of palmfield.driver."""

from typing import ClassVar, Literal

from pydantic import Field

from palmfield.config.base import Config


class DriverConfig(Config):
    plugin: ClassVar[str] = "palmfield.driver"
    about: ClassVar[str] = "The board that plays the drive; what it can't play is not simulated either."
    renamed: ClassVar[dict[str, str]] = {"device": "board"}

    board: Literal["ideal", "sonicsurface"] = Field(
        "ideal", description="ideal: continuous phase and amplitude at any rate; sonicsurface: decoded from its bytes"
    )
