"""What carries bytes: serial ports and their URLs, pseudo-terminals, TCP sockets, and files. It knows no board."""

import errno
import os
from pathlib import Path
from typing import Protocol

import serial
from serial.tools.list_ports import comports

from palmfield.errors import DeviceError, OutputError

WRITE_TIMEOUT_S = 0.25
TIMEOUTS_BEFORE_LOST = 8
VIRTUAL_BAUD = 115200
"""Of a port whose board has no baud rate: sockets and pseudo-terminals take any."""

# pyserial lets termios.error through, which is neither a SerialException nor an OSError and exists on POSIX only.
LOST: tuple[type[Exception], ...] = (serial.SerialException, OSError)
if os.name == "posix":
    import termios

    LOST = (*LOST, termios.error)
CANNOT_OPEN: tuple[type[Exception], ...] = (*LOST, ValueError)


class PortLost(DeviceError):
    """A port that was open is gone, or takes no bytes any more."""


class Transport(Protocol):
    """Where bytes go. name: for messages"""

    name: str

    def write(self, data: bytes) -> bool:
        """Send all of some bytes; False when they did not get through in time, or not all of them.

        Raises PortLost when the other end is gone, OutputError where a file takes no more.
        """
        ...

    def waiting(self) -> int:
        """Bytes that were written and are known not to be on the line yet: the board may hold more back.

        A pseudo-terminal reports 0 with bytes unread. Raises PortLost when the other end is gone.
        """
        ...

    def flush(self) -> None:
        """Return when all bytes are out. Raises PortLost when the other end is gone."""
        ...

    def close(self) -> None:
        """Free it; sends nothing. A file gets its name now."""
        ...


class SerialTransport:
    """A serial port, a pseudo-terminal or a URL of pyserial's (socket://HOST:PORT, loop://), open."""

    def __init__(self, name: str, stream: serial.SerialBase) -> None:
        self.name = name
        self._stream = stream
        self._timeouts = 0

    def write(self, data: bytes) -> bool:
        """False after a write timeout: part of the bytes may be on the line, so never send the rest of them."""
        try:
            if self._stream.in_waiting:  # fails after an unplug, when a write may still seem to work
                self._stream.reset_input_buffer()  # what boards answer says nothing of frames
            self._stream.write(data)
        except serial.SerialTimeoutException as error:
            self._timeouts += 1
            if self._timeouts >= TIMEOUTS_BEFORE_LOST:
                raise PortLost(f"{self.name} takes no bytes") from error
            return False
        except LOST as error:
            raise PortLost(f"{self.name} is gone: {reason(error)}") from error
        self._timeouts = 0
        return True

    def waiting(self) -> int:
        try:
            return int(getattr(self._stream, "out_waiting", 0))
        except (NotImplementedError, AttributeError):
            return 0
        except LOST as error:
            raise PortLost(f"{self.name} is gone: {reason(error)}") from error

    def flush(self) -> None:
        try:
            self._stream.flush()
        except LOST as error:
            raise PortLost(f"{self.name} is gone: {reason(error)}") from error

    def close(self) -> None:
        self._stream.close()


class FileTransport:
    """A file that gets the bytes which a board would: in `<path>.part` while open, in `path` after close."""

    def __init__(self, path: str | Path) -> None:
        """Raises OutputError where the file can't be made."""
        self.path = Path(path)
        self.name = str(path)
        self.part = self.path.with_name(self.path.name + ".part")
        try:
            self._file = self.part.open("wb", buffering=0)
        except OSError as error:
            raise self._unwritable(error) from error

    def write(self, data: bytes) -> bool:
        """Always True; raises OutputError when the disk does not take it, or did not before."""
        if self._file.closed:
            raise OutputError(f"cannot write {self.path}: it is closed, or the disk took no more; choose another file")
        try:
            while data:
                data = data[self._file.write(data) :]
        except OSError as error:
            self._file.close()  # what lacks bytes keeps the name .part
            raise self._unwritable(error) from error
        return True

    def waiting(self) -> int:
        return 0

    def flush(self) -> None:
        return None

    def close(self) -> None:
        if self._file.closed:
            return
        try:
            os.fsync(self._file.fileno())
            self._file.close()
            os.replace(self.part, self.path)
        except OSError as error:
            raise self._unwritable(error) from error
        finally:
            self._file.close()

    def _unwritable(self, error: OSError) -> OutputError:
        return OutputError(f"cannot write {self.path}: {error.strerror}; choose a folder that exists and has room")


def open_port(port: str, baud: int | None) -> SerialTransport:
    """Open a port, for this process alone where the system supports that.

    port: device (/dev/ttyUSB0, COM3) or pyserial URL (loop://, socket://host:port); baud: None where the board has none
    Raises DeviceError when it cannot be opened; the message names the ports there are.
    """
    try:
        stream = serial.serial_for_url(
            port, baudrate=baud or VIRTUAL_BAUD, write_timeout=WRITE_TIMEOUT_S, exclusive=True
        )
    except CANNOT_OPEN as error:
        raise DeviceError(f"cannot open {port}: {reason(error)}; {_choices()}") from error
    return SerialTransport(port, stream)


def reason(error: Exception) -> str:
    """Why a port can't be opened or is lost, in words."""
    number = getattr(error, "errno", None)
    if number == errno.EACCES:
        return "permission denied (on Linux, add yourself to the group 'dialout' and log in again)"
    if "exclusively lock" in str(error):
        return "another program holds it"
    return os.strerror(number) if number else str(error).splitlines()[0] if str(error) else type(error).__name__


def _choices() -> str:
    ports = sorted(port.device for port in comports())
    return (
        f"ports found: {', '.join(ports)}" if ports else "no serial port found: connect the board, or check its cable"
    )
