"""Receive a tracked hand as lines of JSON over UDP or TCP; invalid lines are counted and skipped."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from palmfield.motion.line_listener import BadLine, By, LineListener
from palmfield.motion.tracking import Stream
from palmfield.motion.wire import Sample, read_sample

JUMP_S, SURE = 1.0, 10
"""Largest jump between the clocks of tracker and machine [s], and number of samples that confirm a larger jump.

If so many consecutive samples agree on a larger jump, the tracker's clock was set, and the jump is accepted. A single
sample far ahead is skipped.
"""


class Arrived(NamedTuple):
    """A valid sample. time_s: arrival time on the monotonic clock of this machine [s]"""

    time_s: float
    sample: Sample


class Listener(LineListener):
    """Context manager that reads samples from a socket.

    samples: valid samples in the order of arrival, with rising times of the tracker
    offset_s: offset from the clock of the tracker to the clock of this machine [s], from the sample with the shortest
    transport time
    """

    def __init__(
        self, host: str = "127.0.0.1", port: int = 0, by: By = "udp", on_sample: Callable[[Arrived], None] | None = None
    ) -> None:
        """port: 0 for any free port; on_sample: called in the listening thread with each valid sample.

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
        """Return all valid samples so far."""
        samples = [arrived.sample for arrived in list(self.samples)]
        return Stream(
            np.array([one.time_s for one in samples]),
            *(np.array(part) for part in zip(*(one[1:] for one in samples), strict=True)),
        )

    def report(self) -> str:
        """Return the numbers of used and skipped samples as text."""
        return f"{self.received} samples taken, {sum(self.bad.values())} skipped{self.skipped()}"

    def read_line(self, line: bytes, came_s: float) -> None:
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
            raise BadLine("joints", f"{len(joints)} joints, but the samples before had {len(self._joints)}")
        self._joints = self._joints or joints
        arrived = self._before
        self.offset_s = min(self.offset_s, came_s - sample.time_s)
        self.samples.append(arrived)
        self.received += 1
        if self._on_sample is not None:
            self._on_sample(arrived)


def _agree(one: Arrived, other: Arrived) -> bool:
    """Return whether the interval between two samples agrees, within JUMP_S, on the clocks of tracker and machine."""
    return abs(other.sample.time_s - one.sample.time_s - (other.time_s - one.time_s)) < JUMP_S
