"""The receiving end of a line as a process: `python player_line.py FILE` opens a pseudo-terminal.

It prints the name of the terminal, stores all received bytes until its standard input ends, and writes them to FILE. It
stores no times, because the system transfers bytes across a pseudo-terminal at normal priority, with delays under load.
It requests priority, since a real board receives bytes at any load of the host, and it does not load NumPy.
"""

import contextlib
import os
import select
import subprocess
import sys
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

PRIORITY = 70


@dataclass
class LineBytes:
    """Received bytes. data: all of them, once the line has ended"""

    port: str
    data: bytes = b""

    def frames(self, size: int, before: int = 0) -> list[bytes]:
        """Return whole frames of this number of bytes. before: number of preceding bytes"""
        return [self.data[at : at + size] for at in range(before, len(self.data) - size + 1, size)]


@contextmanager
def listened() -> Iterator[LineBytes]:
    """Return a pseudo-terminal with a listening process; its received bytes are available after the block."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "heard"
        process = subprocess.Popen(
            [sys.executable, str(Path(__file__)), str(file)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert process.stdin is not None and process.stdout is not None
        try:
            line_bytes = LineBytes(process.stdout.readline().strip())
            yield line_bytes
        finally:
            process.stdin.close()
            process.wait()
            process.stdout.close()
        line_bytes.data = file.read_bytes()


def main() -> None:
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    master, slave = os.openpty()
    tty.setraw(slave)
    print(os.ttyname(slave), flush=True)
    data = bytearray()
    while True:
        ready = select.select([master, 0], [], [])[0]
        if master in ready:
            data += os.read(master, 65536)
        elif 0 in ready:
            break
    Path(sys.argv[1]).write_bytes(data)


if __name__ == "__main__":
    main()
