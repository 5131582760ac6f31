"""Locate scenes and hand presets: inside an installed wheel, or next to the package in a clone."""

from pathlib import Path
from typing import Literal

from palmfield.errors import SceneError

PACKAGE = Path(__file__).resolve().parent

FOLDERS = ("mjcf", "hand_models")


def folder(name: Literal["mjcf", "hand_models"]) -> Path:
    """Return the folder of data files that ship with palmfield.

    name: "mjcf" (arrays, hands and scenes) or "hand_models" (hand presets)
    Returns an absolute path that exists.
    Raises SceneError for another name, and if the folder is not found.
    """
    if name not in FOLDERS:
        raise SceneError(f"data folder {name!r} does not exist; allowed: {', '.join(map(repr, FOLDERS))}")
    places = (PACKAGE / "_data" / name, PACKAGE.parent / name)
    for place in places:
        if place.is_dir():
            return place
    raise SceneError(
        f"data folder {name!r} is missing: looked for {places[0]} and {places[1]}; "
        "reinstall palmfield, or restore the folder in the clone"
    )


def find_file(name: str) -> Path:
    """Return the file that a key of a scene names.

    name: absolute path, or path relative to the working directory or to the folder of palmfield's scenes. The folder of
        the scene is not used, because a compiled model does not store it
    Returns an absolute path; an absolute `name` is not checked.
    Raises SceneError for a relative name that is in neither folder.
    """
    path = Path(name)
    if path.is_absolute():
        return path
    for place in (Path.cwd(), folder("mjcf") / "scenes"):
        if (place / path).is_file():
            return (place / path).resolve()
    raise SceneError(
        f"file '{name}' is neither in the working directory {Path.cwd()} nor among the scenes of palmfield: load "
        "the scene by palmfield.load, which looks up names relative to the scene, or run from the scene's folder, "
        "or give an absolute path"
    )
