"""How long a user may ask a scene to run, and how many steps that is."""

import numpy as np

from palmfield.errors import SceneError


def check_duration(duration_s: float) -> None:
    """Raises SceneError for a duration that is not a number of seconds > 0."""
    try:
        allowed = 0.0 < duration_s < np.inf
    except TypeError:
        raise SceneError(f"duration_s is {duration_s!r}; allowed: a number of seconds > 0") from None
    if not allowed:
        raise SceneError(f"duration_s is {duration_s}; allowed: seconds > 0")


def step_count(duration_s: float, timestep_s: float) -> int:
    """As many steps as come nearest to a duration, at least one."""
    return max(1, round(duration_s / timestep_s))
