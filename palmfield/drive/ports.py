"""Ports by their names: which transport is behind one."""

from palmfield.drive.transport import Transport, open_serial

AUTD3 = "autd3:"


def open_port(port: str, baud: int | None) -> Transport:
    """Open a port, for this process alone where the system supports that.

    port: device (/dev/ttyUSB0, COM3), pyserial URL (loop://, socket://host:port), or a way to AUTD3 units (autd3:auto,
        `palmfield.drive.autd3_units.WAYS`); baud: None where the board has none
    Raises DeviceError when it cannot be opened; the message names the ports, or ways, that there are.
    """
    if not port.startswith(AUTD3):
        return open_serial(port, baud)
    # NumPy and AUTD3's client are loaded for its units only
    from palmfield.drive.autd3_units import open_units

    return open_units(port, port.removeprefix(AUTD3))
