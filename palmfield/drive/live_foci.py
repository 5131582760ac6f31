"""Receive foci from another program over a socket during a play, one line of JSON each."""

import json
import math
from typing import Any, NamedTuple

import numpy as np

from palmfield.motion.line_listener import BadLine, By, LineListener, read_object
from palmfield.motion.quaternions import matrices
from palmfield.types import Float

KEYS = "focus_m", "level", "position_m", "quaternion"
UNIT = 0.01
"""Allowed deviation of the length of a quaternion from 1."""


class LiveFocus(NamedTuple):
    """A focus. place: array frame [m], shape (3,); level: level of the sound, 0..1"""

    place: Float
    level: float


class ReceivedFocus(NamedTuple):
    """A received focus. number: number from 1 on; time_s: time of arrival, on time.monotonic() [s]"""

    number: int
    focus: LiveFocus
    time_s: float


def read_focus(line: bytes, offset: Float) -> LiveFocus:
    """Read the focus from a line of JSON with one object.

    focus_m: three numbers [m], in the frame of the array, or in the moving frame that the next two define in it
    position_m, quaternion (w first): origin and orientation of that frame. level: 0 to 1, default 1
    offset: focus_m for an object without it [m], shape (3,)
    Raises BadLine for other content.
    """
    fields = read_object(line)
    stray = sorted(set(fields) - set(KEYS))
    if stray:
        raise BadLine("keys", f"field '{stray[0][:40]}' is unknown; allowed: {', '.join(KEYS)}")
    level = _numbers(fields, "level", 1)[0] if "level" in fields else 1.0
    if not 0.0 <= level <= 1.0:
        raise BadLine("level", f"level has value {level:g}; allowed: 0 to 1")
    place = _numbers(fields, "focus_m", 3) if "focus_m" in fields else offset
    if "position_m" in fields:
        turn = _numbers(fields, "quaternion", 4) if "quaternion" in fields else np.array([1.0, 0.0, 0.0, 0.0])
        length = math.hypot(*turn)
        if not abs(length - 1.0) <= UNIT:
            raise BadLine("numbers", f"quaternion has length {length:g}; allowed: 1, w first")
        place = matrices(turn[None] / length)[0] @ place + _numbers(fields, "position_m", 3)
    elif "quaternion" in fields:
        raise BadLine("keys", "a quaternion is given without position_m; allowed: both, or position_m alone")
    elif "focus_m" not in fields:
        raise BadLine("keys", "neither focus_m nor position_m is given; allowed: one of them, or both")
    return LiveFocus(place, level)


def _numbers(fields: dict[str, Any], key: str, count: int) -> Float:
    value = fields[key] if count > 1 else [fields[key]]
    good = isinstance(value, list) and len(value) == count
    if not good or not all(isinstance(one, float) for one in value):
        raise BadLine("numbers", f"{key} has value {json.dumps(fields[key])[:60]}; allowed: {count} finite numbers")
    numbers = np.array(value, float)
    if not np.isfinite(numbers).all():
        raise BadLine("numbers", f"{key} has value {json.dumps(fields[key])[:60]}; allowed: {count} finite numbers")
    return numbers


class FocusListener(LineListener):
    """Reads foci from a socket and stores the newest. Use as a context manager."""

    def __init__(self, offset: Float, host: str = "127.0.0.1", port: int = 0, by: By = "udp") -> None:
        """offset: as in `read_focus`; port: 0 for any free port. Raises DeviceError for a foreign address."""
        self._offset = offset
        self._newest: ReceivedFocus | None = None
        super().__init__(host, port, by)

    def next(self, after: int, timeout_s: float) -> ReceivedFocus | None:
        """Return the newest focus if its number is not `after`; wait for it at most timeout_s [s], else return None.

        Raises DeviceError if no focus can arrive any more.
        """
        return self._newest if self.wait(after, timeout_s) else None

    def report(self) -> str:
        """Return the number of used and skipped lines, in words."""
        return f"{self.received} foci received, {sum(self.bad.values())} lines skipped{self.skipped()}"

    def read_line(self, line: bytes, came_s: float) -> None:
        focus = read_focus(line, self._offset)
        self._newest = ReceivedFocus(self.received + 1, focus, came_s)
        self.received += 1
