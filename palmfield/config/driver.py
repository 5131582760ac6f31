"""Keys of palmfield.driver."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from palmfield.config.base import Config


class DriverConfig(Config):
    plugin: ClassVar[str] = "palmfield.driver"
    about: ClassVar[str] = "The board that plays the drive; what it can't play is not simulated either."
    renamed: ClassVar[dict[str, str]] = {"device": "board"}

    board: Literal["ideal", "sonicsurface"] = Field(
        "ideal", description="ideal: continuous phase and amplitude at any rate; sonicsurface: decoded from its bytes"
    )
    duty_exponent: Annotated[float, Field(ge=0.5, le=4)] = Field(
        2.0,
        description="g of the pulses' law p/p_M = sin(pi duty)^(g/2), for am_quantity duty: 2 is that of rectangular "
        "pulses; 1.5 was measured on a device (Hasegawa and Shinoda 2018)",
    )
