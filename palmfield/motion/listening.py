"""A tracked hand received over a socket: lines of JSON by UDP or TCP; bad ones are counted and skipped."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from palmfield.motion.line_listener import BadLine, By, LineListener
from palmfield.motion.tracking import Stream
from palmfield.motion.wire import Sample, read_sample

JUMP_S, SURE = 1.0, 10
"""Largest difference between the tracker's clock and this machine's from one sample to another. Beyond it the clock was
set if this many in a row agree: one sample with a time far ahead would make all later ones late."""


class Arrived(NamedTuple):
    """A good sample. time_s: of arrival, on the monotonic clock of this machine [s]"""

    time_s: float
    sample: Sample


class Listener(LineListener):
    """Reads samples from a socket. Use as a context manager.

    samples: good ones in the order of arrival, by rising times of the tracker
    offset_s: from the tracker's clock to this machine's [s], by the sample with the shortest transport
    """

    def __init__(
        self, host: str = "127.0.0.1", port: int = 0, by: By = "udp", on_sample: Callable[[Arrived], None] | None = None
    ) -> None:
        """port: 0 for any free one; on_sample: called in the listening thread with each good sample.

        Raises DeviceError for an address at which it cannot listen.
        """
        self._on_sample = on_sample
        self.samples: list[Arrived] = []
        self._before: Arrived | None = None
        self._agreeing = 0
        self._joints: tuple[int, ...] | None = None
        self.offset_s = math.inf
        super().__init__(host, port, by)

    def stream(self) -> Stream:
        """All good samples so far."""
        taken = [arrived.sample for arrived in list(self.samples)]
        return Stream(
            np.array([one.time_s for one in taken]),
            *(np.array(part) for part in zip(*(one[1:] for one in taken), strict=True)),
        )

    def report(self) -> str:
        """Return the numbers of used and skipped samples, in words."""
        return f"{self.taken} samples taken, {sum(self.bad.values())} skipped{self.skipped()}"

    def take(self, line: bytes, came_s: float) -> None:
        sample = read_sample(line)
        before, self._before = self._before, Arrived(came_s, sample)
        self._agreeing = self._agreeing + 1 if before is not None and _agree(before, self._before) else 0
        if self.samples and not _agree(self.samples[-1], self._before) and self._agreeing < SURE:
            last = self.samples[-1].sample.time_s
            raise BadLine("clock", f"its time {sample.time_s:g} s is {sample.time_s - last:.3g} s after {last:g} s")
        joints = tuple(np.flatnonzero(sample.flags).tolist())
        if self.samples and sample.time_s <= self.samples[-1].sample.time_s:
            last = self.samples[-1].sample.time_s
            raise BadLine("late", f"its time {sample.time_s:g} s is not after {last:g} s")
        if self._joints is not None and len(set(self._joints) - set(joints)) > len(self._joints) // 2:
            raise BadLine("joints", f"{len(joints)} joints, where there were {len(self._joints)}")
        self._joints = self._joints or joints
        arrived = self._before
        self.offset_s = min(self.offset_s, came_s - sample.time_s)
        self.samples.append(arrived)
        self.taken += 1
        if self._on_sample is not None:
            self._on_sample(arrived)


def _agree(one: Arrived, other: Arrived) -> bool:
    """Whether the times between two samples by the tracker's clock and by this machine's agree to JUMP_S."""
    return abs(other.sample.time_s - one.sample.time_s - (other.time_s - one.time_s)) < JUMP_S
