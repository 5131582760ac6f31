"""Real AUTD3 units as a transport: the AUTD3 client (autd3 0.12) sends the frames of board `autd3`."""

import asyncio
import contextlib
import importlib
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np

from palmfield.drive.transport import PortLost
from palmfield.errors import DeviceError

TRANSDUCERS = 249
FRAME_BYTES = 2 * TRANSDUCERS
MOST_UNITS = 8
NUMBERED = ("server", "simulator", "emulator")
WAYS = (
    "autd3:auto, autd3:INTERFACE (a network interface's name), autd3:ADDRESS (its IPv6 address), autd3:server[:PORT], "
    "autd3:simulator[:PORT] or autd3:emulator[:UNITS]"
)


class Autd3Units:
    """AUTD3 units in one row of the network. Each whole frame becomes one pattern, without silencer or modulation.

    A frame is sent when all units have acknowledged the previous frame, so no frame waits here.
    name: as in `open_units`
    """

    def __init__(self, name: str, target: str) -> None:
        self.name = name
        self._target = target
        self._loop = asyncio.new_event_loop()
        self._client: Any = None
        self._emulator: Any = None
        self._package = _package()
        self._units = 0
        self._rest = b""

    def write(self, data: bytes) -> bool:
        """Send all whole frames in `data`; return True when all units have acknowledged them.

        The number of units follows from the first bytes. Raises DeviceError if units cannot be opened, PortLost if they
        are lost.
        """
        if self._client is None:
            if len(data) % FRAME_BYTES:
                raise DeviceError(
                    f"{self.name} takes frames of {FRAME_BYTES} bytes per unit, but the first frame has "
                    f"{len(data)} bytes: give board autd3, or another port"
                )
            self._open(len(data) // FRAME_BYTES)
        data = self._rest + data
        size = self._units * FRAME_BYTES
        whole = len(data) // size * size
        self._rest = data[whole:]
        for begin in range(0, whole, size):
            self._called(self._client.send, self.pattern(data[begin : begin + size]))
        return True

    def pattern(self, frame: bytes) -> Any:
        """Return the command of the client for one frame: for each unit 249 phases, then 249 intensities."""
        both = np.frombuffer(frame, np.uint8).reshape(-1, 2, TRANSDUCERS)
        package = self._package
        phases = package.pattern.PhaseBuffer.from_array(np.ascontiguousarray(both[:, 0]))
        intensities = package.pattern.IntensityBuffer.from_array(np.ascontiguousarray(both[:, 1]))
        return package.commands.Pattern(phases, intensities)

    def waiting(self) -> int:
        return len(self._rest)

    def flush(self) -> None:
        return None

    def close(self) -> None:
        """Silence the units by a command of the client, and free the link; a lost link is only freed."""
        if self._loop.is_closed():
            return
        if self._client is not None:
            with contextlib.suppress(self._package.autd3.Autd3Error):
                self._run(self._client.silent_stop)
            with contextlib.suppress(self._package.autd3.Autd3Error):
                self._run(self._client.close)
        self._loop.close()

    def _open(self, units: int) -> None:
        package = self._package
        if not 1 <= units <= MOST_UNITS:
            raise DeviceError(
                f"{units} AUTD3 units; allowed: 1 to {MOST_UNITS}, with {FRAME_BYTES} bytes per frame each"
            )
        geometry = package.geometry.Geometry([package.geometry.Autd3() for _ in range(units)])
        self._units = units
        try:
            config = package.autd3.ClientConfig()
            self._client = self._run(package.autd3.Client.open, geometry, self._link(units), config)
            self._run(self._client.send, package.commands.SetSilencer.disable())
        except package.autd3.Autd3Error as error:
            raise DeviceError(
                f"cannot open {self.name} with {units} AUTD3 units: {error}; check power and cables, and that the "
                f"scene has as many arrays, or give another port: {WAYS}"
            ) from error

    def _link(self, units: int) -> Any:
        autd3, (way, number) = self._package.autd3, _parts(self._target)
        if way == "emulator":
            self._emulator = autd3.UdpEmulator(int(number or units))
            return self._emulator.option()
        if way == "server":
            return autd3.ServerLink(int(number)) if number else autd3.ServerLink()
        if way == "simulator":
            return autd3.UdpOption(iface=autd3.Interface.Simulator(int(number or self._package.inner.SIMULATOR_PORT)))
        if way == "auto":
            return autd3.UdpOption(iface=autd3.Interface.Auto)
        interface = autd3.Interface
        return autd3.UdpOption(iface=interface.Addr(way) if ":" in way else interface.Name(way))

    def _called(self, call: Callable[..., Any], *arguments: object) -> None:
        try:
            self._run(call, *arguments)
        except self._package.autd3.Autd3Error as error:
            raise PortLost(f"connection to {self.name} lost: {error}") from error

    def _run(self, call: Callable[..., Any], *arguments: object) -> Any:
        # Calls of the client need a running event loop
        async def answer() -> Any:
            return await call(*arguments)

        return self._loop.run_until_complete(answer())


def open_units(name: str, target: str) -> Autd3Units:
    """Open AUTD3 units on a link listed in WAYS; the search begins with the first bytes, which give their number.

    name: name for messages; target: text after autd3: in WAYS ("emulator": units emulated by the AUTD3 software in this
    process). Raises DeviceError for another link, and if the extra is not installed.
    """
    way, number = _parts(target)
    if not way or (way in NUMBERED and number and not number.isdigit()):
        raise DeviceError(f"port '{name}' is not a port of AUTD3 units; allowed: {WAYS}")
    return Autd3Units(name, target)


def _parts(target: str) -> tuple[str, str]:
    """Return a link and its number, which only some links have."""
    way, _, number = target.partition(":")
    return (way, number) if way in NUMBERED else (target, "")


def _package() -> SimpleNamespace:
    try:
        return SimpleNamespace(
            autd3=importlib.import_module("autd3"),
            inner=importlib.import_module("autd3._autd3"),
            commands=importlib.import_module("autd3.commands"),
            geometry=importlib.import_module("autd3.geometry"),
            pattern=importlib.import_module("autd3_pattern"),
        )
    except ImportError:
        raise DeviceError(
            "AUTD3 units need their own client, which is not installed; install the extra: pip install "
            "'palmfield[autd3]'"
        ) from None
