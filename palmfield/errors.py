"""Errors that users see. Each message is one line: what was found, what is allowed, how to mend it."""

import difflib
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pydantic import ValidationError


class PalmfieldError(Exception):
    """Base of every error that a user can cause and mend; the command line prints it and exits with 2.

    about: names of what it is about, outermost first: a world, an element of a scene, a key. They come before the text.
    setting: name of the setting with the refused value, "" for none. mends: names of settings whose change mends it.
        `palmfield.config.base.naming_keys` puts both in words, where they are keys of a scene.
    """

    def __init__(self, text: str = "", *about: str, setting: str = "", mends: Sequence[str] = ()):
        super().__init__(text)
        self.about, self.setting, self.mends = about, setting, mends

    def __str__(self) -> str:
        return ": ".join((*self.about, *map(str, self.args)))


class SceneError(PalmfieldError):
    """A scene, or a file that it names, says something that cannot be built."""


class DeviceError(PalmfieldError):
    """A board or a GPU cannot do what is asked of it, or a board cannot be reached."""


class OutputError(PalmfieldError):
    """Results cannot be written or read back."""


class MeasurementError(PalmfieldError):
    """A metric or an instrument is asked for what the signal that it is given cannot tell."""


def unwritable(path: object, error: OSError) -> OutputError:
    """What to raise where a file can't be written, from what the system said."""
    return OutputError(f"cannot write {path}: {reason_of(error)}; choose a folder that exists and has room")


def reason_of(error: BaseException, longest: int | None = None) -> str:
    """What an error of the system or of a library says, in one line of so many letters; its kind if it says nothing."""
    text = str(getattr(error, "strerror", None) or error)
    return " ".join(text.split())[:longest] or type(error).__name__


def fault_of(error: "ValidationError") -> str:
    """The first fault that pydantic finds in what a file holds: its place, what is wrong, and the value."""
    first = error.errors()[0]
    place = ".".join(map(str, first["loc"]))
    message = first["msg"].removeprefix("Value error, ")
    given = "" if first["type"] in ("value_error", "missing") else f", not {str(first['input'])[:60]}"
    return f"{place}{': ' if place else ''}{message}{given}"


LEAST_BEGINNING = 3
"""Letters from which a name's beginning stands for it in `did_you_mean`."""


def did_you_mean(word: str, known: Iterable[str], likeness: float = 0.6) -> str:
    """` (did you mean 'x'?)` for the known word that comes near, or begins so; empty where none does.

    likeness: least share of letters that they have in common, 0 to 1
    """
    by_lower = {name.lower(): name for name in known}
    near = difflib.get_close_matches(word.lower(), by_lower, n=1, cutoff=likeness)
    if not near and len(word) >= LEAST_BEGINNING:
        near = sorted((name for name in by_lower if name.startswith(word.lower())), key=len)[:1]
    return f" (did you mean '{by_lower[near[0]]}'?)" if near else ""


def refuse_unknown(error: type[PalmfieldError], sentence: str, value: str, known: Iterable[str]) -> None:
    """Raise an error for a value that is none of those known.

    sentence: has {} in place of the value: "--by has value {}"
    """
    allowed = list(known)
    if value not in allowed:
        named = sentence.format(f"'{value}'{did_you_mean(value, allowed)}")
        raise error(f"{named}; allowed: {', '.join(allowed)}")


MEMORY_SIGNS = ("Failed to allocate", "out of memory", "CUDA error 2:")
"""In messages of Warp, where memory has run out."""


def explained(error: Exception) -> Exception:
    """The error, or a DeviceError that says what to change where it is Warp's that a GPU has no memory left."""
    text = " ".join(str(error).split())
    if not isinstance(error, RuntimeError) or not any(sign in text for sign in MEMORY_SIGNS):
        return error
    return DeviceError(
        f"the device of the scene is out of memory ({text}): close other programs there, set accuracy larger or "
        "patch_radius_m smaller, use fewer worlds, or another device, for example cpu"
    )


class explaining:
    """An error that leaves the block is `explained`."""

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, at: object) -> None:
        known = explained(error) if isinstance(error, Exception) else error
        if known is not None and known is not error:
            raise known from error


class naming:
    """An error of palmfield's that leaves the block says what it is about, and what mends it, where it doesn't yet."""

    def __init__(self, *about: str, mends: Sequence[str] = ()):
        self.about, self.mends = about, mends

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, at: object) -> None:
        if isinstance(error, PalmfieldError):
            error.mends = error.mends or self.mends
            if error.about[: len(self.about)] != self.about:
                error.about = (*self.about, *error.about)


def naming_world(world: int) -> naming:
    """An error of palmfield's that leaves the block says in which of several worlds it was."""
    return naming(f"world {world}")
