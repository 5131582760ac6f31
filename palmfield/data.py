"""Where the scenes and hand presets lie: inside an installed wheel, or beside the package in a clone."""

from pathlib import Path
from typing import Literal

from palmfield.errors import SceneError

PACKAGE = Path(__file__).resolve().parent


def folder(name: Literal["mjcf", "hand_models"]) -> Path:
    """Folder of data files that ship with palmfield.

    name: "mjcf" (arrays, hands and scenes) or "hand_models" (hand presets)
    Returns an absolute path that exists.
    Raises SceneError for another name, and where the folder is in neither place.
    """
    if name not in ("mjcf", "hand_models"):
        raise SceneError(f"data folder {name!r} does not exist: ask for 'mjcf' or 'hand_models'")
    places = (PACKAGE / "_data" / name, PACKAGE.parent / name)
    for place in places:
        if place.is_dir():
            return place
    raise SceneError(
        f"data folder {name!r} is missing: looked for {places[0]} and {places[1]}; "
        "reinstall palmfield, or restore the folder in the clone"
    )
