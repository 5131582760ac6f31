"""Keys of palmfield.afferents."""

from typing import ClassVar

from pydantic import Field

from palmfield.config.base import Config, Positive


class AfferentsConfig(Config):
    plugin: ClassVar[str] = "palmfield.afferents"
    about: ClassVar[str] = "A region of a skin with key receptors, whose rates of spikes sensors of MuJoCo read."

    skin: str | None = Field(None, description="instance of the skin (default: the only one)")
    body: str | None = Field(
        None, description="body of the skin, or a bone of the hand, that carries the region (default: all of the skin)"
    )
    site: str | None = Field(None, description="site of type sphere that contains the region (default: no sphere)")
    window_s: Positive = Field(0.1, description="time up to the present over which spikes are counted")
