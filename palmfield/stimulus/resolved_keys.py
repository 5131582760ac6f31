"""Keys of a stimulus with the data of its files and of the scene, as a configuration model."""

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
