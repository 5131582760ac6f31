"""Typed configuration of the modules. These models are the only source of keys, units and defaults of a scene."""

from palmfield.config.afferents import AfferentsConfig
from palmfield.config.array import ArrayConfig
from palmfield.config.base import Config, allowed, known_keys, parse, renamed_table, table, unit, unknown_key
from palmfield.config.driver import DriverConfig
from palmfield.config.motion import MotionConfig
from palmfield.config.skin import ArpLaw, Base, Side, SkinConfig
from palmfield.config.stimulus import StimulusConfig

CONFIGS: tuple[type[Config], ...] = (
    ArrayConfig, StimulusConfig, SkinConfig, DriverConfig, MotionConfig, AfferentsConfig,
)  # fmt: skip
FILE_KEYS = {key for config in CONFIGS for key in config.files}

__all__ = [
    "CONFIGS", "FILE_KEYS", "AfferentsConfig", "ArpLaw", "ArrayConfig", "Base", "Config", "DriverConfig",
    "MotionConfig", "Side", "SkinConfig", "StimulusConfig", "allowed", "known_keys", "parse", "renamed_table", "table",
    "unit", "unknown_key",
]  # fmt: skip
