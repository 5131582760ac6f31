"""Standard stimuli of published mid-air experiments, with source and outcome, one file each.

from palmfield.stimulus.standard import standard
print(standard("lm_small_steps").published)
palmfield.load(scene, keys=standard("lm_small_steps").keys_for("stimulus"))
"""

from functools import cache
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from palmfield.config import StimulusConfig
from palmfield.config.base import Positive
from palmfield.data import folder
from palmfield.errors import SceneError, fault_of, refuse_unknown
from palmfield.files import read_toml


class StandardStimulus(BaseModel):
    """One stimulus. keys: keys of palmfield.stimulus, as Python values

    source: publication; published: outcome; read: part of the source that was read for this file
    assumed: choices of this file that the source does not specify; duration_s: sufficient duration [s]
    """

    model_config = ConfigDict(extra="forbid", frozen=True)
    name: str
    about: str = Field(min_length=1)
    source: str = Field(min_length=1)
    published: str = Field(min_length=1)
    read: Literal["whole text", "abstract"]
    assumed: str = ""
    duration_s: Positive
    keys: dict[str, Any]

    @model_validator(mode="after")
    def _plays(self) -> "StandardStimulus":
        StimulusConfig(**self.keys)
        return self

    @property
    def config(self) -> StimulusConfig:
        """Checked keys."""
        return StimulusConfig(**self.keys)

    def keys_for(self, instance: str) -> dict[str, object]:
        """Return the keys for an instance of palmfield.stimulus, with the names of `palmfield.load` and `--set`."""
        return {f"{instance}.{key}": value for key, value in self.keys.items()}

    def texts(self) -> dict[str, str]:
        """Return the keys as MJCF text, with lists separated by blanks."""
        return {
            key: " ".join(f"{x:g}" for x in value) if isinstance(value, list) else str(value)
            for key, value in self.keys.items()
        }


@cache
def names() -> tuple[str, ...]:
    """Return the sorted names of all standard stimuli."""
    return tuple(sorted(path.stem for path in (folder("mjcf") / "stimuli").glob("*.toml")))


def standard(name: str) -> StandardStimulus:
    """Return the stimulus of this name. Raises SceneError for an unknown name."""
    refuse_unknown(SceneError, "stimulus {} is unknown", name, names())
    return read_stimulus(folder("mjcf") / "stimuli" / f"{name}.toml")


def read_stimulus(path: Path) -> StandardStimulus:
    """Read a file of one stimulus. Raises SceneError if it cannot be read, and for invalid keys."""
    try:
        return StandardStimulus(name=path.stem, **read_toml(path))
    except (OSError, ValueError, TypeError) as error:
        fault = fault_of(error) if isinstance(error, ValidationError) else str(error)
        raise SceneError(f"{path}: {fault}; give about, source, published, read, duration_s and [keys]") from None
