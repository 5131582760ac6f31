"""A hand that a tracker tells of over a socket: lines of JSON by UDP or TCP, the bad ones counted and skipped."""

import math
import threading
from collections import Counter
from collections.abc import Callable
from typing import NamedTuple, Self

import numpy as np

from palmfield.motion.line_listener import By, LineListener
from palmfield.motion.tracking import Stream
from palmfield.motion.wire import BadSample, Sample, read_sample

TOLD = 5
"""Bad samples of a kind that are told in words."""


class Arrived(NamedTuple):
    """A good sample. time_s: when it arrived, on the monotonic clock of this machine [s]"""

    time_s: float
    sample: Sample


class Listener:
    """Takes samples from a socket. Use as a context manager.

    host, port: where it listens; taken: good samples in the order in which they came, by rising times of the tracker
    bad: how many of each kind were skipped; told: the first of them in words
    """

    def __init__(
        self, host: str = "127.0.0.1", port: int = 0, by: By = "udp", on_sample: Callable[[Arrived], None] | None = None
    ) -> None:
        """port: 0 for any that is free; on_sample: called in the listening thread with each good sample.

        Raises DeviceError for an address that can't be listened at.
        """
        self._on_sample = on_sample
        self.taken: list[Arrived] = []
        self.bad: Counter[str] = Counter()
        self.told: list[str] = []
        self._joints: tuple[int, ...] | None = None
        self._offset_s = math.inf
        self._came = threading.Event()
        self._lines = LineListener(self._take, host, port, by)
        self.host, self.port, self.by = self._lines.host, self._lines.port, by

    def wait(self, timeout_s: float) -> bool:
        """Wait for the first good sample; whether there is one."""
        return self._came.wait(timeout_s)

    def stream(self) -> Stream:
        """All good samples so far."""
        taken = [arrived.sample for arrived in list(self.taken)]
        return Stream(
            np.array([one.time_s for one in taken]),
            *(np.array(part) for part in zip(*(one[1:] for one in taken), strict=True)),
        )

    def offset_s(self) -> float:
        """From the tracker's clock to this machine's [s]: by the samples that were under way the shortest."""
        return self._offset_s

    def report(self) -> str:
        """How many samples were taken and skipped, in words."""
        skipped = ", ".join(f"{count} {kind}" for kind, count in sorted(self.bad.items()))
        return f"{len(self.taken)} samples taken, {sum(self.bad.values())} skipped{f' ({skipped})' if skipped else ''}"

    def close(self) -> None:
        self._lines.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def _take(self, line: bytes, now: float) -> None:
        try:
            sample = read_sample(line)
            joints = tuple(np.flatnonzero(sample.flags).tolist())
            if self.taken and sample.time_s <= self.taken[-1].sample.time_s:
                last = self.taken[-1].sample.time_s
                raise BadSample("late", f"its time {sample.time_s:g} s is not after {last:g} s")
            if self._joints is not None and len(set(self._joints) - set(joints)) > len(self._joints) // 2:
                raise BadSample("joints", f"{len(joints)} joints, where there were {len(self._joints)}")
        except BadSample as error:
            self.bad[error.kind] += 1
            if self.bad[error.kind] <= TOLD:
                self.told.append(str(error))
            return
        self._joints = self._joints or joints
        arrived = Arrived(now, sample)
        self._offset_s = min(self._offset_s, now - sample.time_s)
        self.taken.append(arrived)
        if self._on_sample is not None:
            self._on_sample(arrived)
        self._came.set()
