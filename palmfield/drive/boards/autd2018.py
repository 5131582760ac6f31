"""Packets of the units of Hasegawa & Shinoda 2018: place of the focus and pulse width, every 500 us.

Units compute the phases themselves. A packet contains x, y, z (16 bits each, signed) and the pulse width (9 bits, 0 to
320 of the 640 ticks of a period). Values that the paper does not give are keys of the scene, with defaults in
`Autd2018`: header, footer, the order of bits and the lowest bit of a coordinate.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from palmfield.acoustics.arrays import layout
from palmfield.drive.board import GOLDEN, Board, Emitted, REFERENCE_SPEED_m_s, Twin, serial_line
from palmfield.drive.pulse_width import HASEGAWA_TICKS, Edge, edge_phase, widths
from palmfield.errors import DeviceError
from palmfield.stimulus.duty_law import relative_pressure
from palmfield.types import Complex, Float

TRANSDUCERS = 249
PACKET_RATE_HZ = 2000.0
PERIOD_S = 1.0 / PACKET_RATE_HZ
CARRIER_HZ = 40e3
COORDINATE_BITS, WIDTH_BITS = 16, 9
FIELDS = (COORDINATE_BITS, COORDINATE_BITS, COORDINATE_BITS, WIDTH_BITS)
PAYLOAD_BITS = sum(FIELDS)
MOST = 2 ** (COORDINATE_BITS - 1) - 1
CHILDREN = 3
"""Number of units to which each unit passes packets."""
LAYOUT_OF_UNITS = {1: "autd2018", 4: "autd2018_2x2"}


@dataclass(frozen=True)
class Autd2018(Board):
    """The board of the paper. packet_header, packet_footer: bits, as text; packet_bit_order: bit order of each field.

    packet_lsb_m: value of the lowest bit of a coordinate [m]. packet_baud: baud rate of the serial line to the first
        unit, not given in the paper; default: the lowest usual rate for 2,000 packets per second
    duty_exponent, pwm_edge: see `palmfield.drive.pulse_width`
    hop_delay_s: delay by each unit that a packet passes [s]; skew_s: largest difference between units after the sync
    clock_drift_ppm: largest difference between clocks of units; sync: whether clocks are set every 500 us
    board_sound_speed_m_s: speed of sound with which units compute phases [m/s]
    """

    packet_header: str = "10100101"
    packet_footer: str = "1011010"
    packet_bit_order: Literal["msb_first", "lsb_first"] = "msb_first"
    packet_lsb_m: float = 0.025e-3
    packet_baud: int = 230400
    duty_exponent: float = 2.0
    pwm_edge: Edge = "centre"
    hop_delay_s: float = 40e-9
    skew_s: float = 0.0
    clock_drift_ppm: float = 0.0
    sync: Literal["on", "off"] = "on"
    board_sound_speed_m_s: float = REFERENCE_SPEED_m_s

    def sized(self, transducers: int) -> "Autd2018":
        sized = super().sized(transducers)
        if sized.units not in LAYOUT_OF_UNITS:
            raise DeviceError(
                f"board '{self.name}' cannot drive {transducers} transducers; allowed: "
                + " or ".join(f"{TRANSDUCERS * units} ({name})" for units, name in LAYOUT_OF_UNITS.items())
            )
        return sized.ready()

    def with_keys(self, keys: Mapping[str, Any]) -> "Autd2018":
        return super().with_keys(keys).ready()

    def ready(self) -> "Autd2018":
        """Return this board with the line and silence bytes for its keys. Raises DeviceError for a line too slow."""
        off = self.packet((0, 0, 0, 0))
        line = serial_line(self.packet_baud)
        if line.bytes_per_s < PACKET_RATE_HZ * len(off):
            raise DeviceError(
                f"packet_baud has value {self.packet_baud}; allowed: at least "
                f"{10.0 * PACKET_RATE_HZ * len(off):g}, for {PACKET_RATE_HZ:g} packets of {len(off)} bytes per "
                "second"
            )
        return replace(self, line=line, start=off, stop=off)

    def packet(self, numbers: tuple[int, ...]) -> bytes:
        """Return the bytes of one packet: header, fields and footer, padded with 0 to whole bytes."""
        bits = self.packet_header
        for number, size in zip(numbers, FIELDS, strict=True):
            field = format(number & (2**size - 1), f"0{size}b")
            bits += field if self.packet_bit_order == "msb_first" else field[::-1]
        bits += self.packet_footer
        bits += "0" * (-len(bits) % 8)
        return int(bits, 2).to_bytes(len(bits) // 8, "big")

    def numbers(self, packet: bytes) -> tuple[int, ...] | None:
        """Return x, y, z and pulse width of a packet, as whole numbers; None for an invalid packet."""
        bits = format(int.from_bytes(packet, "big"), f"0{8 * len(packet)}b")
        begin, end = len(self.packet_header), len(self.packet_header) + PAYLOAD_BITS
        if not bits.startswith(self.packet_header) or not bits[end:].startswith(self.packet_footer):
            return None
        numbers = []
        for size in FIELDS:
            field = bits[begin : begin + size]
            value = int(field if self.packet_bit_order == "msb_first" else field[::-1], 2)
            signed = size == COORDINATE_BITS and value > MOST
            numbers.append(value - 2**size if signed else value)
            begin += size
        return tuple(numbers)

    def encode_focus(self, focus: ArrayLike, level: float) -> bytes:
        """Return 9 bytes with the default header and footer: 57 payload bits."""
        steps = np.rint(np.asarray(focus, float) / self.packet_lsb_m)
        if steps.shape != (3,) or not np.all(np.abs(steps) <= MOST):
            raise DeviceError(
                f"focus {np.asarray(focus).tolist()} m is outside the range of a packet of {self.name}; allowed: "
                f"three numbers within +-{MOST * self.packet_lsb_m:.4g} m (packet_lsb_m)"
            )
        width = int(widths(level, HASEGAWA_TICKS, self.duty_exponent))
        x, y, z = (int(step) for step in steps)
        return self.packet((x, y, z, width))

    def rounded(self, levels: Float) -> Float:
        duty = widths(np.minimum(levels, 1.0), HASEGAWA_TICKS, self.duty_exponent) / HASEGAWA_TICKS
        return relative_pressure(duty, self.duty_exponent)

    def twin(self) -> "Autd2018Twin":
        return Autd2018Twin(self)

    @cached_property
    def positions(self) -> Float:
        """Positions of all transducers in the array frame [m], shape (n, 3)."""
        return layout(LAYOUT_OF_UNITS[self.units]).positions

    def unit_delays(self, since_sync_s: float) -> Float:
        """Return the delay of each unit [s], shape (units,): hops, skew, and clock drift."""
        unit = np.arange(self.units)
        depth = np.array([_depth(number) for number in range(self.units)])
        spread = np.modf(GOLDEN * unit)[0]
        drift = 1e-6 * self.clock_drift_ppm * (2.0 * spread - 1.0) * (unit > 0)
        return self.hop_delay_s * depth + self.skew_s * spread + drift * since_sync_s

    def focused(self, focus: Float, width: int, since_sync_s: float = 0.0) -> Complex:
        """Return the emission for a focus [m] and a pulse width in ticks, relative to full drive, shape (n,)."""
        ticks = np.rint(
            -HASEGAWA_TICKS * CARRIER_HZ * np.linalg.norm(focus - self.positions, axis=1) / self.board_sound_speed_m_s
        )
        duty = width / HASEGAWA_TICKS
        late = np.repeat(self.unit_delays(since_sync_s), TRANSDUCERS)
        phase = 2.0 * np.pi * (ticks / HASEGAWA_TICKS + CARRIER_HZ * late)
        # With a fixed edge the phase changes with the duty; the reference is the phase at a duty of 1/2
        phase = phase + edge_phase(duty, self.pwm_edge) - edge_phase(0.5, self.pwm_edge)
        return relative_pressure(duty, self.duty_exponent) * np.exp(1j * phase)


def _depth(unit: int) -> int:
    """Return the number of hops to a unit in a tree in which each unit passes packets to CHILDREN others."""
    depth = 0
    while unit > 0:
        unit, depth = (unit - 1) // CHILDREN, depth + 1
    return depth


class Autd2018Twin(Twin):
    """Units that change at the sync after a packet. Silent at power-up; after a lost packet the last focus stays."""

    def __init__(self, board: Autd2018) -> None:
        self._size = len(board.packet((0, 0, 0, 0)))
        super().__init__(board.transducers, serial_line(board.packet_baud).time_s(1))
        self.board = board
        self._bytes = bytearray()
        self._state = np.array([0.0, 0.0, 0.0]), 0
        self._since_s = 0.0
        self._waiting: list[tuple[float, tuple[Float, int]]] = []

    @property
    def emitted(self) -> Complex:
        return self.at(self.time_s)

    def at(self, time_s: float) -> Complex:
        """Return the emission at a time [s] with the present packet; without sync the clocks have drifted."""
        since_s = time_s % PERIOD_S if self.board.sync == "on" else time_s
        focus, width = self._state
        return self.board.focused(focus, width, since_s)

    def take(self, data: bytes) -> list[Emitted]:
        begin, changes, dropped = self.time_s, [], 0
        for number, byte in enumerate(data):
            self._bytes.append(byte)
            if len(self._bytes) < self._size:
                continue
            self.time_s = begin + (number + 1) * self.byte_s
            changes += self.until(self.time_s)
            numbers = self.board.numbers(bytes(self._bytes))
            if numbers is None:
                del self._bytes[0]
                dropped += 1
                continue
            self._bytes.clear()
            *steps, width = numbers
            if width > HASEGAWA_TICKS // 2:
                self.flag("garbled", f"pulse width {width} is above {width} ticks and is clipped to it")
            state = self.board.packet_lsb_m * np.array(steps, float), min(width, HASEGAWA_TICKS // 2)
            due_s = self.time_s
            if self.board.sync == "on":
                due_s = math.ceil(self.time_s / PERIOD_S - 1e-6) * PERIOD_S
            self._waiting.append((due_s, state))
        self.time_s = begin + len(data) * self.byte_s
        if dropped:
            self.flag("garbled", f"{dropped} bytes belong to no packet")
        return changes + self.until(self.time_s)

    def until(self, time_s: float) -> list[Emitted]:
        changes = []
        while self._waiting and self._waiting[0][0] <= time_s + 1e-9:
            due_s, self._state = self._waiting.pop(0)
            changes.append(Emitted(due_s, self.at(due_s)))
        return changes


BOARD = Autd2018(
    "autd2018",
    "units of Hasegawa & Shinoda 2018, 249 transducers each: one focus per packet of 57 bits at 2 kHz, 640 "
    "phases, 320 pulse widths",
    layouts=tuple(LAYOUT_OF_UNITS.values()),
    unit=TRANSDUCERS,
    most_units=max(LAYOUT_OF_UNITS),
    max_frame_rate_Hz=PACKET_RATE_HZ,
    phase_steps=HASEGAWA_TICKS,
    amplitude="pulse_width",
    amplitude_steps=HASEGAWA_TICKS // 2,
    takes="focus",
    when_host_dies="the units keep the focus of the last packet until power is cut",
    cannot_guarantee="The paper does not state header, footer, bit order, value of the lowest bit and line rate, "
    "so a real unit may need other values of the packet_ keys. The units compute the focus themselves with a "
    "fixed speed of sound, and do not compensate dead or inverted transducers.",
    keys=(
        "packet_header", "packet_footer", "packet_bit_order", "packet_lsb_m", "packet_baud", "duty_exponent",
        "pwm_edge", "hop_delay_s", "skew_s", "clock_drift_ppm", "sync", "board_sound_speed_m_s",
    ),
).ready()  # fmt: skip
