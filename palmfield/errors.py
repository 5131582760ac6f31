"""Errors that users see. Each message is one line: the value, what is allowed, and what to do."""

import difflib
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pydantic import ValidationError


class PalmfieldError(Exception):
    """Base of every error that a user can cause and correct; the command line prints it and exits with 2.

    about: names that precede the text, outermost first: a world, an element of a scene, a key
    setting: name of the setting with the invalid value, "" for none; mends: names of settings that can correct the
        error `palmfield.config.base.naming_keys` adds both to the text if they are keys of a scene.
    """

    def __init__(self, text: str = "", *about: str, setting: str = "", mends: Sequence[str] = ()):
        super().__init__(text)
        self.about, self.setting, self.mends = about, setting, mends

    def __str__(self) -> str:
        return ": ".join((*self.about, *map(str, self.args)))


class SceneError(PalmfieldError):
    """A scene, or a file that it names, is invalid."""


class DeviceError(PalmfieldError):
    """A board or GPU cannot do what is requested, or a board cannot be reached."""


class OutputError(PalmfieldError):
    """Results cannot be written or read back."""


class MeasurementError(PalmfieldError):
    """A signal does not contain what a metric or instrument needs."""


def unwritable(path: object, error: OSError) -> OutputError:
    """Return the OutputError for a file that cannot be written. error: error of the system"""
    return OutputError(f"cannot write {path}: {reason_of(error)}; choose a folder that exists and has room")


def reason_of(error: BaseException, longest: int | None = None) -> str:
    """Return a system or library error's message in one line of at most `longest` letters, or its type."""
    text = str(getattr(error, "strerror", None) or error)
    return " ".join(text.split())[:longest] or type(error).__name__


def fault_of(error: "ValidationError") -> str:
    """Return the first error that pydantic found in a file: position, error and value."""
    first = error.errors()[0]
    place = ".".join(map(str, first["loc"]))
    message = first["msg"].removeprefix("Value error, ")
    value = "" if first["type"] in ("value_error", "missing") else f", not {str(first['input'])[:60]}"
    return f"{place}{': ' if place else ''}{message}{value}"


LEAST_BEGINNING = 3
"""Smallest number of letters with which the beginning of a name identifies it in `did_you_mean`."""


def did_you_mean(word: str, known: Iterable[str], likeness: float = 0.6) -> str:
    """Return ` (did you mean 'x'?)` for the most similar known word, or for one that begins with `word`; "" if none.

    likeness: smallest fraction of common letters, 0 to 1
    """
    by_lower = {name.lower(): name for name in known}
    near = difflib.get_close_matches(word.lower(), by_lower, n=1, cutoff=likeness)
    if not near and len(word) >= LEAST_BEGINNING:
        near = sorted((name for name in by_lower if name.startswith(word.lower())), key=len)[:1]
    return f" (did you mean '{by_lower[near[0]]}'?)" if near else ""


def refuse_unknown(error: type[PalmfieldError], sentence: str, value: str, known: Iterable[str]) -> None:
    """Raise an error for a value that is not in `known`.

    sentence: text with {} for the value, such as "--by has value {}"
    """
    allowed = list(known)
    if value not in allowed:
        named = sentence.format(f"'{value}'{did_you_mean(value, allowed)}")
        raise error(f"{named}; allowed: {', '.join(allowed)}")


MEMORY_SIGNS = ("Failed to allocate", "out of memory", "CUDA error 2:")
"""Texts in messages of Warp that show that a GPU is out of memory."""


def explained(error: Exception) -> Exception:
    """Return the error. If Warp reports that a GPU is out of memory, return a DeviceError with a remedy instead."""
    text = " ".join(str(error).split())
    if not isinstance(error, RuntimeError) or not any(sign in text for sign in MEMORY_SIGNS):
        return error
    return DeviceError(
        f"the device of the scene is out of memory ({text}): close other programs there, set accuracy larger or "
        "patch_radius_m smaller, use fewer worlds, or another device, for example cpu"
    )


class explaining:
    """A context that replaces an error in the block by the result of `explained`."""

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, at: object) -> None:
        named = explained(error) if isinstance(error, Exception) else error
        if named is not None and named is not error:
            raise named from error


class naming:
    """Return a context that adds names and remedies to a PalmfieldError in the block, unless it has some already."""

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
    """Return a context that adds the number of the world to a PalmfieldError in the block."""
    return naming(f"world {world}")
