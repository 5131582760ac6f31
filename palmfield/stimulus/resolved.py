"""Keys of a stimulus, completed with data of the scene or of a file."""

from functools import lru_cache
from typing import Any

from pydantic import ConfigDict, Field

from palmfield.config import StimulusConfig
from palmfield.config.base import Positive
from palmfield.stimulus.am_table import AmTable
from palmfield.stimulus.focus_table import FocusTable


class ResolvedStimulus(StimulusConfig):
    """A stimulus with all data from files and surfaces."""

    model_config = ConfigDict(ser_json_bytes="base64")

    sites_length_m: Positive | None = Field(None, description="length of a path through sites, along the surface")
    am_table: AmTable | None = Field(None, description="waveform of the file am_file")
    focus_table: FocusTable | None = Field(None, description="foci over time of the file path_file")
    duty_exponent: Positive = Field(2.0, description="exponent of the board that plays it")


@lru_cache(maxsize=64)
def resolved(
    config: StimulusConfig,
    sites_length_m: float | None = None,
    am_table: AmTable | None = None,
    duty_exponent: float = 2.0,
    focus_table: FocusTable | None = None,
) -> StimulusConfig:
    """Return the keys with the length of a path through sites [m], waveform or foci of a file, and duty exponent.

    If none of these applies, `config` is returned.
    """
    additions: dict[str, Any] = {"sites_length_m": sites_length_m, "am_table": am_table, "focus_table": focus_table}
    pulses = focus_table is not None and focus_table.quantity == "duty"
    if pulses or (config.modulation == "am" and config.am_quantity == "duty"):
        additions["duty_exponent"] = duty_exponent
    additions = {key: value for key, value in additions.items() if value is not None}
    if not additions:
        return config
    present = {key: getattr(config, key) for key in config.model_fields_set}
    return ResolvedStimulus.model_validate(present | additions)
