"""Transports of bytes, independent of boards: serial ports and their URLs, pseudo-terminals, TCP sockets, and files."""

import contextlib
import errno
import io
import os
import socket
import time
from pathlib import Path
from typing import Protocol

import serial
from serial.tools.list_ports import comports

from palmfield.errors import DeviceError, OutputError, unwritable
from palmfield.files import writing

WRITE_TIMEOUT_S = 0.25
TIMEOUTS_BEFORE_LOST = 8
VIRTUAL_BAUD = 115200
"""Baud rate of a port if the board has none; sockets and pseudo-terminals accept any rate."""
COUNT_MARK = b"\x00pfVB\xff"
"""Mark before each number from a virtual board: count of bytes read so far, 8 bytes, lowest first."""
COUNT_BYTES = len(COUNT_MARK) + 8
REPORT_LIMIT_S = 0.06
"""Upper limit of the interval between reports of a virtual board [s]."""
FIRST_LOOKS, FIRST_PATIENCE = 50, 4.0
"""Number of tries to read the first report, and their total time in units of `REPORT_LIMIT_S`."""

# pyserial does not catch termios.error, which is neither a SerialException nor an OSError and exists only on POSIX.
LOST: tuple[type[Exception], ...] = (serial.SerialException, OSError)
if os.name == "posix":
    import termios

    LOST = (*LOST, termios.error)
CANNOT_OPEN: tuple[type[Exception], ...] = (*LOST, ValueError)


class PortLost(DeviceError):
    """An open port was lost, or accepts no more bytes."""


class Transport(Protocol):
    """Destination of bytes. name: name of the port or file, for messages"""

    name: str

    def write(self, data: bytes) -> bool:
        """Send bytes; return False if they were not all sent in time.

        Raises PortLost if the other end is lost, OutputError if a file accepts no more bytes.
        """
        ...

    def waiting(self) -> int:
        """Return the number of written bytes that are certainly not on the line yet; more bytes may be waiting.

        A pseudo-terminal reports 0 also with unread bytes, unless a virtual board at its other end reports its count of
        bytes. Raises PortLost if the other end is lost.
        """
        ...

    def flush(self) -> None:
        """Return when all bytes are sent. Raises PortLost if the other end is lost."""
        ...

    def close(self) -> None:
        """Close the port or file without sending bytes. A file is renamed to its final name."""
        ...


class SerialTransport:
    """An open serial port, pseudo-terminal or pyserial URL (socket://HOST:PORT, loop://)."""

    def __init__(self, name: str, stream: serial.SerialBase) -> None:
        self.name = name
        self._stream = stream
        self._timeouts = 0
        self._is_socket = hasattr(stream, "_socket")
        try:
            self._fd: int | None = stream.fileno()
        except (AttributeError, io.UnsupportedOperation):
            self._fd = None
        self._offered, self._reported, self._first_reported, self._received = 0, 0, -1, b""

    def write(self, data: bytes) -> bool:
        """Send bytes; return False after a write timeout. A part may be on the line: do not send the rest later."""
        try:
            self._listen()
            self._stream.write(data)
        except serial.SerialTimeoutException as error:
            self._timeouts += 1
            if self._timeouts >= TIMEOUTS_BEFORE_LOST:
                raise PortLost(f"{self.name} accepts no bytes") from error
            return False
        except LOST as error:
            raise PortLost(f"connection to {self.name} lost: {reason(error)}") from error
        self._timeouts = 0
        self._offered += len(data)
        return True

    def offer(self, data: bytes) -> int:
        """Write bytes without waiting (except for ports without a descriptor); return the number of accepted bytes.

        After a partly accepted frame, pass a whole frame, never the rest. Raises PortLost if the other end is lost."""
        if self._fd is None:
            return len(data) if self.write(data) else 0
        try:
            self._listen()
            written = os.write(self._fd, data)
        except BlockingIOError:
            return 0
        except LOST as error:
            raise PortLost(f"connection to {self.name} lost: {reason(error)}") from error
        self._offered += written
        return written

    @property
    def is_virtual(self) -> bool:
        """Whether a virtual board at the other end reports its bytes, so that `waiting` counts all waiting bytes."""
        return self._first_reported >= 0

    def waiting(self) -> int:
        try:
            if self._fd is not None:
                self._listen()
            if self.is_virtual:
                return max(0, self._offered - (self._reported - self._first_reported))
            return int(getattr(self._stream, "out_waiting", 0))
        except (NotImplementedError, AttributeError):
            return 0
        except LOST as error:
            raise PortLost(f"connection to {self.name} lost: {reason(error)}") from error

    def await_report(self) -> None:
        """Wait for the first report of a virtual board, if there is one, before any byte is written.

        There are several tries, because the board is late too if the machine pauses.
        """
        for _ in range(FIRST_LOOKS):
            if self.is_virtual:
                return
            time.sleep(REPORT_LIMIT_S / FIRST_LOOKS * FIRST_PATIENCE)
            self.waiting()

    def _listen(self) -> None:
        """Read reports of a virtual board, and discard answers of real boards. Raises an error after an unplug."""
        if not self._stream.in_waiting:
            return
        if self._fd is None:
            self._stream.reset_input_buffer()
            return
        data = os.read(self._fd, 65536)
        if not data and self._is_socket:
            raise OSError(errno.EPIPE, os.strerror(errno.EPIPE))
        self._received = (self._received + data)[-4 * COUNT_BYTES :]
        at = self._received.rfind(COUNT_MARK)
        if at > len(self._received) - COUNT_BYTES:
            at = self._received.rfind(COUNT_MARK, 0, at)
        if at >= 0:
            number = self._received[at + len(COUNT_MARK) : at + COUNT_BYTES]
            self._reported = int.from_bytes(number, "little")
            if self._first_reported < 0 and self._offered == 0:
                self._first_reported = self._reported

    def flush(self) -> None:
        try:
            self._stream.flush()
        except LOST as error:
            raise PortLost(f"connection to {self.name} lost: {reason(error)}") from error

    def close(self) -> None:
        if self._is_socket and self._received:
            self._end_socket()
        self._stream.close()

    def _end_socket(self) -> None:
        """Read all reports before closing a socket; otherwise bytes that the board has not read would be discarded."""
        connection = self._stream._socket
        if connection is None:
            return
        with contextlib.suppress(*LOST):
            connection.shutdown(socket.SHUT_WR)
            connection.settimeout(WRITE_TIMEOUT_S)
            ends = time.monotonic() + 2.0 * WRITE_TIMEOUT_S
            while time.monotonic() < ends and connection.recv(65536):
                pass


class FileTransport:
    """A file with the bytes for a board: `<path>.part` while it is open, `path` after close."""

    def __init__(self, path: str | Path) -> None:
        """Raises OutputError if the file cannot be made."""
        self.path = Path(path)
        self.name = str(path)
        self.part = self.path.with_name(self.path.name + ".part")
        with writing(self.path):
            self._file = self.part.open("wb", buffering=0)

    def write(self, data: bytes) -> bool:
        """Write bytes and return True. Raises OutputError if writing fails or has failed before."""
        if self._file.closed:
            raise OutputError(f"cannot write {self.path}: the file is closed, or the disk is full; choose another file")
        try:
            while data:
                data = data[self._file.write(data) :]
        except OSError as error:
            self._file.close()  # an incomplete file keeps the name .part
            raise unwritable(self.path, error) from error
        return True

    def waiting(self) -> int:
        return 0

    def flush(self) -> None:
        return None

    def close(self) -> None:
        if self._file.closed:
            return
        with writing(self.path), self._file:
            os.fsync(self._file.fileno())
            self._file.close()
            os.replace(self.part, self.path)


def open_serial(port: str, baud: int | None) -> SerialTransport:
    """Open a serial port or URL, exclusively if the system supports that.

    port: device (/dev/ttyUSB0, COM3) or pyserial URL (loop://, socket://host:port); baud: None for a board without one
    Raises DeviceError, with the available ports, if it cannot be opened.
    """
    try:
        stream = serial.serial_for_url(
            port, baudrate=baud or VIRTUAL_BAUD, write_timeout=WRITE_TIMEOUT_S, exclusive=True
        )
    except CANNOT_OPEN as error:
        raise DeviceError(f"cannot open {port}: {reason(error)}; {choices()}") from error
    return SerialTransport(port, stream)


def may_be_virtual(port: str) -> bool:
    """Return whether a virtual board may be at the other end of a port: pseudo-terminals, their links, sockets."""
    return port.startswith("socket://") or os.path.realpath(port).startswith("/dev/pts/")


def reason(error: Exception) -> str:
    """Return the reason why a port cannot be opened or is lost, in words."""
    number = getattr(error, "errno", None)
    if number == errno.EACCES:
        return "permission denied (on Linux, add yourself to the group 'dialout' and log in again)"
    if "exclusively lock" in str(error):
        return "another program uses it"
    return os.strerror(number) if number else str(error).splitlines()[0] if str(error) else type(error).__name__


def choices() -> str:
    """Return a list of the available serial ports, in words."""
    ports = sorted(port.device for port in comports())
    return (
        f"ports found: {', '.join(ports)}" if ports else "no serial port found: connect the board, or check its cable"
    )
