"""Send a recorded hand motion in real time, as a tracker would."""

import socket
import time

import numpy as np

from palmfield.errors import DeviceError
from palmfield.motion.line_listener import By
from palmfield.motion.tracking import Stream, ordered
from palmfield.motion.wire import Convention, Sample, write_sample

CONNECT_S = 5.0


def address(text: str) -> tuple[str, int]:
    """Parse HOST:PORT, or a PORT of this machine. Raises DeviceError for any other text."""
    host, colon, port = text.rpartition(":")
    if not port.isdigit() or int(port) > 65535 or (colon and not host):
        raise DeviceError(f"'{text}' is not an address; give HOST:PORT, or PORT for this machine")
    return host or "127.0.0.1", int(port)


def address_by(text: str) -> tuple[str, int, By]:
    """Parse an `address` after `tcp:` or `udp:`; the default is udp. Raises DeviceError for any other text."""
    kind, colon, rest = text.partition(":")
    named = kind in ("tcp", "udp") and colon
    host, port = address(rest if named else text)
    return host, port, "tcp" if named and kind == "tcp" else "udp"


def replay(
    stream: Stream,
    to: tuple[str, int],
    *,
    by: By = "udp",
    convention: Convention = "openxr",
    speed: float = 1.0,
    repeat: int = 1,
    stamp: bool = False,
) -> int:
    """Send each packet at its time; return the number of sent packets.

    speed: factor of the playback speed; repeat: number of times that the recording is sent
    stamp: whether to replace the times of samples by the sending times on the monotonic clock of this machine
    Raises DeviceError if there is no receiver, and for a speed or number out of range.
    """
    if not 0.01 <= speed <= 100.0:
        raise DeviceError(f"speed has value {speed:g}; allowed: 0.01 to 100")
    if repeat < 1:
        raise DeviceError(f"repeat has value {repeat}; allowed: 1 or more")
    packets = ordered(stream)
    spacing = float(np.median(np.diff(packets.times_s)))
    span = float(packets.times_s[-1] - packets.times_s[0]) + spacing
    sent = 0
    try:
        with _connected(to, by) as line:
            begin = time.monotonic()
            for turn in range(repeat):
                for n, time_s in enumerate(packets.times_s):
                    due = begin + (turn * span + float(time_s - packets.times_s[0])) / speed
                    time.sleep(max(0.0, due - time.monotonic()))
                    own = time.monotonic() if stamp else float(time_s) + turn * span
                    parts = packets.positions[n], packets.quaternions[n], packets.radii[n], packets.flags[n]
                    text = write_sample(Sample(own, *parts), convention)
                    line.sendall(text.encode() + b"\n")
                    sent += 1
    except OSError as error:
        raise DeviceError(
            f"{to[0]}:{to[1]} accepts no samples by {by} after {sent}: {error}; start the receiver first"
        ) from None
    return sent


def _connected(to: tuple[str, int], by: By) -> socket.socket:
    if by == "tcp":
        peer = socket.create_connection(to, CONNECT_S)
        # Send a sample without waiting for the acknowledgement of the last one
        peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return peer
    line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    line.connect(to)
    return line
