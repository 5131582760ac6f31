"""Check durations, and convert them to numbers of steps."""

import numpy as np

from palmfield.errors import SceneError


def check_duration(duration_s: float) -> None:
    """Raise SceneError for a duration that is not a number of seconds > 0."""
    try:
        allowed = 0.0 < duration_s < np.inf
    except TypeError:
        raise SceneError(f"duration_s is {duration_s!r}; allowed: a number of seconds above 0") from None
    if not allowed:
        raise SceneError(f"duration_s is {duration_s}; allowed: seconds > 0")


def step_count(duration_s: float, timestep_s: float) -> int:
    """Return the number of steps closest to a duration, at least one."""
    return max(1, round(duration_s / timestep_s))


def check_steps(count: object) -> None:
    """Raise SceneError for a count that is not a whole number >= 0."""
    if not isinstance(count, int | np.integer) or isinstance(count, bool) or count < 0:
        raise SceneError(f"count of steps is {count!r}; allowed: a whole number, 0 or more")


def check_time(time_s: object) -> None:
    """Raise SceneError for a time that is not a number of seconds >= 0."""
    number = isinstance(time_s, int | float | np.number) and not isinstance(time_s, bool | np.complexfloating)
    if not number or not 0.0 <= float(time_s) < np.inf:  # type: ignore[arg-type]
        raise SceneError(f"time_s is {time_s!r}; allowed: seconds, 0 or more")
