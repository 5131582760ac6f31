"""Foci that another program tells of over a socket while they sound: a line of JSON each."""

import json
import threading
from collections import Counter
from typing import Any, NamedTuple, Self

import numpy as np

from palmfield.motion.line_listener import By, LineListener
from palmfield.transforms import rotation_matrix
from palmfield.types import Float

KEYS = "focus_m", "level", "position_m", "quaternion"
TOLD = 5
"""Bad lines of a kind that are told in words."""
UNIT = 0.01
"""A quaternion's length may differ from 1 by so much."""


class LiveFocus(NamedTuple):
    """place: array frame [m], shape (3,); level: of its sound, 0..1"""

    place: Float
    level: float


class Came(NamedTuple):
    """A focus that came. number: from 1 on; time_s: when, on time.monotonic() [s]"""

    number: int
    focus: LiveFocus
    time_s: float


class BadLine(ValueError):
    """A line that tells no focus. kind: for counting"""

    def __init__(self, kind: str, text: str) -> None:
        super().__init__(text)
        self.kind = kind


def read_focus(line: bytes, offset: Float) -> LiveFocus:
    """The focus of a line of JSON with one object.

    focus_m: three numbers, in the array's frame; or, beside position_m and quaternion (w first), which say where
    something is in the array's frame, in the frame of that. level: 0 to 1, 1 where it isn't told.
    offset: focus_m where there is a position without one [m], shape (3,)
    Raises BadLine for anything else.
    """
    try:
        told = json.loads(line)
    except ValueError:
        told = None
    if not isinstance(told, dict):
        raise BadLine("garbled", f'{line[:60]!r} is no JSON object; give for example {{"focus_m": [0, 0, 0.15]}}')
    stray = sorted(set(told) - set(KEYS))
    if stray:
        raise BadLine("keys", f"key '{stray[0]}' is not known; allowed: {', '.join(KEYS)}")
    level = _numbers(told, "level", 1)[0] if "level" in told else 1.0
    if not 0.0 <= level <= 1.0:
        raise BadLine("level", f"level has value {level:g}; allowed: 0 to 1")
    place = _numbers(told, "focus_m", 3) if "focus_m" in told else offset
    if "position_m" in told:
        turn = _numbers(told, "quaternion", 4) if "quaternion" in told else np.array([1.0, 0.0, 0.0, 0.0])
        length = float(np.linalg.norm(turn))
        if not abs(length - 1.0) <= UNIT:
            raise BadLine("numbers", f"quaternion has length {length:g}; allowed: 1, w first")
        place = rotation_matrix(turn / length) @ place + _numbers(told, "position_m", 3)
    elif "quaternion" in told:
        raise BadLine("keys", "a quaternion is told without position_m; allowed: both, or position_m alone")
    elif "focus_m" not in told:
        raise BadLine("keys", "neither focus_m nor position_m is told; allowed: one of them, or both")
    return LiveFocus(place, level)


def _numbers(told: dict[str, Any], key: str, count: int) -> Float:
    value = told[key] if count > 1 else [told[key]]
    good = isinstance(value, list) and len(value) == count
    if not good or not all(isinstance(one, int | float) and not isinstance(one, bool) for one in value):
        raise BadLine("numbers", f"{key} has value {json.dumps(told[key])[:60]}; allowed: {count} finite numbers")
    numbers = np.array(value, float)
    if not np.isfinite(numbers).all():
        raise BadLine("numbers", f"{key} has value {json.dumps(told[key])[:60]}; allowed: {count} finite numbers")
    return numbers


class FocusListener:
    """Takes foci from a socket and keeps the newest. A context manager.

    host, port: where it listens; taken: good lines so far; bad: how many of each kind were skipped; told: the first of
    them in words
    """

    def __init__(self, offset: Float, host: str = "127.0.0.1", port: int = 0, by: By = "udp") -> None:
        """offset: as of `read_focus`; port: 0 for any that is free. Raises DeviceError for a foreign address"""
        self.taken = 0
        self.bad: Counter[str] = Counter()
        self.told: list[str] = []
        self._offset = offset
        self._newest: Came | None = None
        self._lock = threading.Condition()
        self._lines = LineListener(self._take, host, port, by)
        self.host, self.port = self._lines.host, self._lines.port

    def next(self, after: int, timeout_s: float) -> Came | None:
        """The newest focus, if that isn't the one of a number; waits for one so long [s], and is None then."""
        with self._lock:
            self._lock.wait_for(lambda: self.taken > after, timeout_s)
            return self._newest if self.taken > after else None

    def skip(self, kind: str, text: str) -> None:
        """Count a line that can't be played."""
        self.bad[kind] += 1
        if self.bad[kind] <= TOLD:
            self.told.append(text)

    def report(self) -> str:
        """How many lines were taken and skipped, in words."""
        skipped = ", ".join(f"{count} {kind}" for kind, count in sorted(self.bad.items()))
        return f"{self.taken} foci came, {sum(self.bad.values())} lines skipped{f' ({skipped})' if skipped else ''}"

    def close(self) -> None:
        self._lines.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def _take(self, line: bytes, now: float) -> None:
        try:
            focus = read_focus(line, self._offset)
        except BadLine as error:
            self.skip(error.kind, str(error))
            return
        with self._lock:
            self.taken += 1
            self._newest = Came(self.taken, focus, now)
            self._lock.notify_all()
