"""A line of a serial port that triggers other equipment."""

import threading
import time
from typing import Any, Literal

import serial

from palmfield.errors import DeviceError


class TriggerLine:
    """Raises a line at a moment and lowers it again, or sends a byte at this moment.

    late_s: delay of the last pulse or byte, by the clock of the host [s]
    """

    def __init__(
        self, port: str, line: Literal["dtr", "rts", "byte"], byte: int = 1, pulse_s: float = 0.005, opened: Any = None
    ) -> None:
        """port: device or pyserial URL; pulse_s: duration of the pulse; opened: an open pyserial port

        Raises DeviceError if the port cannot be opened.
        """
        self.line, self.byte, self.pulse_s, self.late_s = line, byte, pulse_s, 0.0
        self._timers: list[threading.Timer] = []
        try:
            self._port = serial.serial_for_url(port) if opened is None else opened
            if line != "byte":
                setattr(self._port, line, False)
        except (serial.SerialException, ValueError, OSError) as error:
            raise DeviceError(f"trigger.port '{port}' cannot be opened: {error}; give a serial port") from None

    def mark(self, text: str, when: float) -> None:
        """Raise the line at a moment of time.monotonic, now if it is past; return without waiting. text: not sent"""
        timer = threading.Timer(max(0.0, when - time.monotonic()), self._pulse, (when,))
        timer.daemon = True
        self._timers = [*(one for one in self._timers if one.is_alive()), timer]
        timer.start()

    def _pulse(self, when: float) -> None:
        if self.line == "byte":
            self._port.write(bytes([self.byte]))
            self.late_s = time.monotonic() - when
            return
        setattr(self._port, self.line, True)
        self.late_s = time.monotonic() - when
        time.sleep(self.pulse_s)
        setattr(self._port, self.line, False)

    def close(self) -> None:
        """Wait for pending pulses, and free the port."""
        for timer in self._timers:
            timer.join(timeout=1.0)
        self._port.close()
