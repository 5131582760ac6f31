"""The wire to a SonicSurface: a serial port, or a file that takes what the wire would.

The board never answers and has no watchdog: it goes on emitting its last frame. So a link sends the off frame when
playing ends in any way that leaves the host alive.
"""

import errno
import os
import time
from pathlib import Path
from typing import Protocol, Self

import serial
from serial.tools.list_ports import comports

from palmfield.drive.boards.sonicsurface import BAUD, BITS_PER_BYTE, OFF_FRAME
from palmfield.errors import DeviceError, OutputError

WRITE_TIMEOUT_S = 0.25
TIMEOUTS_BEFORE_LOST = 8
OFF_COPIES = 2  # a swap exchanges the board's two buffers: both must hold the off frame

# pyserial lets termios.error through, which is neither a SerialException nor an OSError and exists on POSIX only.
LOST: tuple[type[Exception], ...] = (serial.SerialException, OSError)
if os.name == "posix":
    import termios

    LOST = (*LOST, termios.error)
CANNOT_OPEN: tuple[type[Exception], ...] = (*LOST, ValueError)


def line_time_s(data: bytes) -> float:
    """Time that bytes take on the line [s]."""
    return len(data) * BITS_PER_BYTE / BAUD


class FrameSink(Protocol):
    """What `palmfield.drive.playback.play_frames` needs: a clock and a place for frames."""

    def now(self) -> float:
        """Seconds on this sink's clock."""

    def wait_until(self, when: float) -> None:
        """Return when the clock shows `when`."""

    def write(self, frame: bytes) -> bool:
        """Send one whole frame; False when it did not get through in time and must be sent again from its start."""

    def off(self) -> None:
        """Silence the board, unless nothing was sent since it was last silenced."""


class Link:
    """An open serial port with a SonicSurface at the other end. Use as a context manager, or close it."""

    def __init__(self, port: str, stream: serial.SerialBase) -> None:
        self.port = port
        self.frames = 0
        self._stream = stream
        self._sounding = True  # all emitters sound from power-up on
        self._timeouts = 0
        self._lost = False

    def now(self) -> float:
        return time.monotonic()

    def wait_until(self, when: float) -> None:
        time.sleep(max(0.0, when - self.now()))

    def write(self, frame: bytes) -> bool:
        """Send one whole frame.

        Returns False after a write timeout: part of the frame may be on the line, so send a frame from its start (254).
        Raises DeviceError when the port is gone, or takes no bytes for 2 s.
        """
        self._sounding = True
        through = self._send(frame)
        self.frames += through
        return through

    def off(self) -> None:
        """Send the off frame twice and wait until it is out. Raises DeviceError when the port is gone."""
        if self._lost or not self._sounding:
            return
        for _ in range(OFF_COPIES):
            while not self._send(OFF_FRAME):
                pass
        try:
            self._stream.flush()
        except LOST as error:
            raise self._gone() from error
        self._sounding = False

    def _send(self, data: bytes) -> bool:
        try:
            if self._stream.in_waiting:  # fails after an unplug, when a write may still seem to work
                self._stream.reset_input_buffer()  # the board sends nothing: this is an echo
            self._stream.write(data)
        except serial.SerialTimeoutException as error:
            self._timeouts += 1
            if self._timeouts >= TIMEOUTS_BEFORE_LOST:
                raise self._gone() from error
            return False
        except LOST as error:
            raise self._gone() from error
        self._timeouts = 0
        return True

    def close(self) -> None:
        """Silence the board and free the port. Raises DeviceError when the port is gone and nobody was told yet."""
        if not self._stream.is_open:
            return
        try:
            self.off()
        finally:
            self._stream.close()

    def _gone(self) -> DeviceError:
        self._lost = True
        return DeviceError(
            f"lost the board on {self.port} after {self.frames} frames; the SonicSurface keeps emitting its last frame "
            "until power is cut"
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


class RecordLink:
    """A file that gets the bytes which a board would, off frames at the end included.

    The bytes are in `<path>.part` while running and in `path` after close. Its clock is not the wall's: a record of
    frames that span a minute takes no minute, and holds the frames which the line would have carried.
    Raises OutputError when the file cannot be written.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.part = self.path.with_name(self.path.name + ".part")
        self.frames = 0
        self._clock = 0.0
        self._sounding = True
        try:
            self._file = self.part.open("wb", buffering=0)
        except OSError as error:
            raise self._unwritable(error) from error

    def now(self) -> float:
        return self._clock

    def wait_until(self, when: float) -> None:
        self._clock = max(self._clock, when)

    def write(self, frame: bytes) -> bool:
        """Append one frame. Always True; raises OutputError when the disk does not take it."""
        self._sounding = True
        self._append(frame)
        self.frames += 1
        return True

    def off(self) -> None:
        """Append the off frame twice."""
        if self._sounding:
            self._append(OFF_FRAME * OFF_COPIES)
            self._sounding = False

    def close(self) -> None:
        """Append the off frame and put the file in its place."""
        if self._file.closed:
            return
        try:
            self.off()
            os.fsync(self._file.fileno())
            self._file.close()
            os.replace(self.part, self.path)
        except OSError as error:
            raise self._unwritable(error) from error
        finally:
            self._file.close()

    def _append(self, data: bytes) -> None:
        try:
            while data:
                data = data[self._file.write(data) :]
        except OSError as error:
            raise self._unwritable(error) from error

    def _unwritable(self, error: OSError) -> OutputError:
        return OutputError(f"cannot write {self.path}: {error.strerror}; choose a folder that exists and has room")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


def open_link(port: str) -> Link:
    """Open the port of a SonicSurface at 230400 baud, for this process alone where the system supports that.

    port: device (/dev/ttyUSB0, COM3) or pyserial URL (loop://, socket://host:port)
    Raises DeviceError when it cannot be opened; the message names the ports there are.
    """
    try:
        stream = serial.serial_for_url(port, baudrate=BAUD, write_timeout=WRITE_TIMEOUT_S, exclusive=True)
    except CANNOT_OPEN as error:
        raise DeviceError(f"cannot open {port}: {_reason(error)}; {_choices()}") from error
    return Link(port, stream)


def _reason(error: Exception) -> str:
    number = getattr(error, "errno", None)
    if number == errno.EACCES:
        return "permission denied (on Linux, add yourself to the group 'dialout' and log in again)"
    if "exclusively lock" in str(error):
        return "another program holds it"
    return os.strerror(number) if number else str(error).splitlines()[0]


def _choices() -> str:
    ports = sorted(port.device for port in comports())
    return (
        f"ports found: {', '.join(ports)}" if ports else "no serial port found: connect the board, or check its cable"
    )
