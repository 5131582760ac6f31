"""Names under which `palmfield.drive.boards` went until it was a package."""

from palmfield.drive.boards import BOARDS as DEVICES
from palmfield.drive.boards import Board as Device
from palmfield.drive.boards import check, play

__all__ = ["DEVICES", "Device", "check", "play"]
