"""A hand that a tracker tells of over a socket: lines of JSON by UDP or TCP, the bad ones counted and skipped."""

import contextlib
import math
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import Literal, NamedTuple, Self

import numpy as np

from palmfield.errors import DeviceError
from palmfield.motion.tracking import Stream
from palmfield.motion.wire import BadSample, Sample, read_sample
from palmfield.realtime import follower

By = Literal["udp", "tcp"]
LONGEST_LINE = 65536
LOOK_S = 0.1
"""So often it is looked whether to stop."""
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
        if by not in ("udp", "tcp"):
            raise DeviceError(f"a tracker is listened to by '{by}'; allowed: udp, tcp")
        self.by, self._on_sample = by, on_sample
        self.taken: list[Arrived] = []
        self.bad: Counter[str] = Counter()
        self.told: list[str] = []
        self._joints: tuple[int, ...] | None = None
        self._offset_s = math.inf
        self._ended = threading.Event()
        self._came = threading.Event()
        try:
            if by == "udp":
                self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
                self._socket.bind((host, port))
            else:
                self._socket = socket.create_server((host, port))
        except (OSError, OverflowError) as error:
            raise DeviceError(f"{host}:{port} can't be listened at: {error}; give an address of this machine") from None
        self._socket.settimeout(LOOK_S)
        self.host, self.port = self._socket.getsockname()[:2]
        self._thread = follower(self._listen)
        self._thread.start()

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
        self._ended.set()
        self._thread.join()
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def _listen(self) -> None:
        while not self._ended.is_set():
            with contextlib.suppress(TimeoutError):
                if self.by == "udp":
                    data = self._socket.recv(LONGEST_LINE)
                    now = time.monotonic()
                    for line in data.splitlines():
                        self._take(line, now)
                else:
                    peer, _ = self._socket.accept()
                    with peer:
                        self._serve(peer)

    def _serve(self, peer: socket.socket) -> None:
        """Lines of one connection, until it ends; what was cut off at its end is garbled."""
        peer.settimeout(LOOK_S)
        rest = b""
        while not self._ended.is_set():
            try:
                data = peer.recv(LONGEST_LINE)
            except TimeoutError:
                continue
            except OSError:
                data = b""
            now = time.monotonic()
            *lines, rest = (rest + data).split(b"\n")
            for line in lines:
                self._take(line, now)
            if not data or len(rest) > LONGEST_LINE:
                if rest:
                    self._take(rest, now)
                return

    def _take(self, line: bytes, now: float) -> None:
        if not line.strip():
            return
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
