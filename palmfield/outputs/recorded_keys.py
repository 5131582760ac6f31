"""Read the keys of the instances of a scene from a result."""

from typing import TypeVar

import xarray as xr

from palmfield.config.base import Config, recorded
from palmfield.errors import OutputError, SceneError

T = TypeVar("T", bound=Config)


def keys_of(model: type[T], name: str, group: xr.Dataset) -> T:
    """Return the keys of an instance in a result. Raises OutputError if they are missing or cannot be read."""
    try:
        return recorded(model, str(group.attrs.get("config", "")))
    except SceneError as error:
        raise OutputError(f"instance '{name}' of the result: {error}") from None
