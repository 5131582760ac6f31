"""Complete the keys of a stimulus with data of the scene or of a file."""

from functools import lru_cache
from typing import TYPE_CHECKING, Any

from palmfield.config import StimulusConfig

if TYPE_CHECKING:  # imported at first use: few stimuli have data in files
    from palmfield.stimulus.am_table import AmTable
    from palmfield.stimulus.focus_table import FocusTable


@lru_cache(maxsize=64)
def resolved(
    config: StimulusConfig,
    sites_length_m: float | None = None,
    am_table: "AmTable | None" = None,
    duty_exponent: float = 2.0,
    focus_table: "FocusTable | None" = None,
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
    from palmfield.stimulus.resolved_keys import ResolvedStimulus

    present = {key: getattr(config, key) for key in config.model_fields_set}
    return ResolvedStimulus.model_validate(present | additions)
