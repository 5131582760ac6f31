"""Messages between the caller and its player over a socket.

A message to the player is a kind, a length and that number of bytes. A message from it is a line with a JSON object.
"""

import json
import socket
import struct
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

from palmfield.drive.player.budget import WINDOW_S

HEAD = struct.Struct("<cI")
JOB, SCHEDULE, FRAME, MUTE, END = b"J", b"S", b"F", b"M", b"E"
"""Kinds: parameters to open; frames with their times; a live frame; fade-out of live frames; end."""
FRAME_HEAD = struct.Struct("<ddfH")
SCHEDULE_HEAD = struct.Struct("<dI")


@dataclass(frozen=True)
class Job:
    """Parameters of a player. Bytes are in hexadecimal digits, times in seconds.

    start, stop: byte sequences; both silence the board; realtime: whether the player requests the highest priority
    log: file to which lines of a log are added, empty for none; refresh_s: interval of repetition of constant frames
    lost_s: longest time in which a line accepts no bytes; replug_s: longest wait for a lost port, to silence the board
    patience_s: longest time to silence a board whose port exists but accepts no bytes; 0: no limit
    stale_s: time after which a live frame is old; ramp_s: time from silence to full drive and back, of live frames
    on_time_s: longest total of sound of live frames, 0: no limit; duty: largest share of time with sound, over
        duty_window_s; tells_frames: whether the player reports when the last byte of each live frame was on the line
    """

    port: str
    baud: int | None
    bytes_per_s: float
    start: str
    stop: str
    realtime: bool = True
    log: str = ""
    refresh_s: float = 0.1
    lost_s: float = 2.0
    replug_s: float = 5.0
    patience_s: float = 0.0
    stale_s: float = 0.1
    ramp_s: float = 0.0
    on_time_s: float = 0.0
    duty: float = 1.0
    duty_window_s: float = WINDOW_S
    tells_frames: bool = False

    def packed(self) -> bytes:
        return json.dumps(asdict(self)).encode()

    @classmethod
    def unpacked(cls, data: bytes) -> "Job":
        return cls(**json.loads(data))


class Schedule(NamedTuple):
    """Frames and their times of emission (last byte on the line) since the start [s], ascending.

    The last frame sounds until duration_s.
    """

    times_s: Sequence[float]
    frames: Sequence[bytes]
    duration_s: float

    def packed(self) -> bytes:
        sizes = array("I", map(len, self.frames))
        head = SCHEDULE_HEAD.pack(self.duration_s, len(sizes))
        return head + array("d", self.times_s).tobytes() + sizes.tobytes() + b"".join(self.frames)

    @classmethod
    def unpacked(cls, data: bytes) -> "Schedule":
        duration_s, count = SCHEDULE_HEAD.unpack_from(data)
        times, sizes = array("d"), array("I")
        at = SCHEDULE_HEAD.size
        times.frombytes(data[at : at + 8 * count])
        at += 8 * count
        sizes.frombytes(data[at : at + sizes.itemsize * count])
        at += sizes.itemsize * count
        frames = []
        for size in sizes:
            frames.append(data[at : at + size])
            at += size
        return cls(times, frames, duration_s)


class LiveFrame(NamedTuple):
    """A frame that is made during the play.

    made_s: time of the input data, on time.monotonic() [s]; level: level of the sound, 0 for silence
    steps: the same frame at rising levels up to its own, of equal length; one frame without levels
    due_s: target time of the last byte on the line, on the same clock, later than all before; 0: as soon as possible
    """

    made_s: float
    level: float
    steps: Sequence[bytes]
    due_s: float = 0.0

    def packed(self) -> bytes:
        return FRAME_HEAD.pack(self.made_s, self.due_s, self.level, len(self.steps)) + b"".join(self.steps)

    @classmethod
    def unpacked(cls, data: bytes) -> "LiveFrame":
        made_s, due_s, level, count = FRAME_HEAD.unpack_from(data)
        rest = data[FRAME_HEAD.size :]
        size = len(rest) // count
        return cls(made_s, level, [rest[at : at + size] for at in range(0, len(rest), size)], due_s)


def packed(kind: bytes, data: bytes = b"") -> bytes:
    """Return one message to the player."""
    return HEAD.pack(kind, len(data)) + data


class Inbox:
    """Messages from a socket that never blocks. closed: whether the other side has closed the socket"""

    def __init__(self, connection: socket.socket) -> None:
        self._socket = connection
        self._bytes = bytearray()
        self.closed = False

    def read(self) -> None:
        """Read all available data."""
        while not self.closed:
            try:
                data = self._socket.recv(1 << 20)
            except BlockingIOError:
                return
            except OSError:
                data = b""
            self.closed = not data
            self._bytes += data

    def messages(self) -> Iterator[tuple[bytes, bytes]]:
        """Yield kind and bytes of each complete message."""
        while len(self._bytes) >= HEAD.size:
            kind, size = HEAD.unpack_from(self._bytes)
            if len(self._bytes) < HEAD.size + size:
                return
            data = bytes(self._bytes[HEAD.size : HEAD.size + size])
            del self._bytes[: HEAD.size + size]
            yield kind, data

    def lines(self) -> Iterator[dict[str, Any]]:
        """Yield the JSON object of each complete line."""
        while (end := self._bytes.find(b"\n")) >= 0:
            line = bytes(self._bytes[:end])
            del self._bytes[: end + 1]
            yield json.loads(line)
