"""Open a port by its name with the right transport."""

import os
import re

from palmfield.drive.transport import Transport, choices, open_serial
from palmfield.errors import DeviceError

AUTD3 = "autd3:"


def check_port(port: str) -> None:
    """Raise DeviceError for a device that does not exist. It is not opened, because opening would reset some boards.

    URLs, links to AUTD3 units and ports of Windows cannot be checked without opening them.
    """
    if os.name == "posix" and re.fullmatch(r"COM\d+", port, re.IGNORECASE):
        raise DeviceError(
            f"cannot open {port}: this is a Windows port, and ports of this system look like /dev/ttyUSB0; in WSL "
            f"attach the board by usbipd first; {choices()}"
        )
    if os.name == "posix" and "://" not in port and not port.startswith(AUTD3) and not os.path.exists(port):
        raise DeviceError(f"cannot open {port}: there is no such port; {choices()}")


def open_port(port: str, baud: int | None) -> Transport:
    """Open a port, exclusively if the system supports that.

    port: device (/dev/ttyUSB0, COM3), pyserial URL (loop://, socket://host:port), or a link to AUTD3 units (autd3:auto,
        `palmfield.drive.autd3_units.WAYS`); baud: None for a board without one
    Raises DeviceError, with the available ports or links, if the port cannot be opened.
    """
    if not port.startswith(AUTD3):
        return open_serial(port, baud)
    # NumPy and the client of AUTD3 are loaded only for AUTD3 units
    from palmfield.drive.autd3_units import open_units

    return open_units(port, port.removeprefix(AUTD3))
