"""A board: its limits, its bytes, and its virtual twin that computes the emission over time."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from palmfield.acoustics.air import sound_speed
from palmfield.errors import DeviceError
from palmfield.types import Air, Complex, Float

AmplitudeKind = Literal["continuous", "on_off", "pulse_width"]
TWIN_DELAY_S = 0.1
"""Time that is longer than the delay of whole frames in any board, and shorter than any watchdog [s]."""
GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0


@dataclass(frozen=True)
class Line:
    """The line to a board. bytes_per_s: rate of the line; baud: baud rate of a serial port, None for other lines."""

    bytes_per_s: float
    baud: int | None = None

    def time_s(self, count: int) -> float:
        """Return the transmission time of a number of bytes [s]."""
        return count / self.bytes_per_s

    def __str__(self) -> str:
        return f"{self.baud} baud, 8N1" if self.baud is not None else f"{self.bytes_per_s:g} bytes/s"


def serial_line(baud: int) -> Line:
    """Return a serial port with a start bit, 8 data bits and a stop bit."""
    return Line(baud / 10.0, baud)


class Emitted(NamedTuple):
    """Emission of a board from a moment on. time_s: time on the clock of the line [s]; amplitudes: complex, (n,)."""

    time_s: float
    amplitudes: Complex


def frames_in_words(emitted: Sequence[Emitted]) -> str:
    """Return as text the number of frames of a board, and how many differ from the frame before, first from silence."""
    before = [np.zeros_like(one.amplitudes) for one in emitted[:1]] + [one.amplitudes for one in emitted[:-1]]
    differ = sum(not np.array_equal(one.amplitudes, last) for one, last in zip(emitted, before, strict=True))
    return f"{len(emitted)} frames, {differ} of them different from the previous one"


def rate_in_words(rate_Hz: float) -> str:
    """Return a rate in frames per second as text, to 0.1."""
    return f"{rate_Hz:.1f}".removesuffix(".0")


class Flag(NamedTuple):
    """An error that a virtual board detected. kind: overrun, dc or garbled; text: description in words"""

    time_s: float
    kind: str
    text: str


class Twin(ABC):
    """A simulated board after power-up: reads bytes, computes its emission, and sets flags for invalid bytes.

    count: number of transducers; byte_s: time of a byte on the line [s]
    time_s: arrival of the last byte [s]; flags: detected errors
    """

    def __init__(self, count: int, byte_s: float) -> None:
        self.count, self.byte_s = count, byte_s
        self.time_s = 0.0
        self.flags: list[Flag] = []

    @property
    @abstractmethod
    def emitted(self) -> Complex:
        """Present emission: complex amplitude of each transducer at the carrier, e^{-iwt}, shape (n,)."""

    def feed(self, data: bytes, time_s: float | None = None) -> list[Emitted]:
        """Read bytes from the line; return the emission after each byte that changes it.

        time_s: start of the first bit of the first byte [s]; None, or a time too early: right after the last byte
        """
        if time_s is not None:
            self.time_s = max(self.time_s, time_s)
        return self.take(data)

    @abstractmethod
    def take(self, data: bytes) -> list[Emitted]:
        """Do `feed` for consecutive bytes, and advance `time_s`."""

    def until(self, time_s: float) -> list[Emitted]:
        """Return the changes of the emission up to a time [s] without further bytes: delayed frames, a watchdog."""
        return []

    def flag(self, kind: str, text: str) -> None:
        self.flags.append(Flag(self.time_s, kind, text))


class RewiredTwin(Twin):
    """Twin of a board whose transducers are wired in another order than in the layout."""

    def __init__(self, inner: Twin, places: tuple[int, ...]) -> None:
        super().__init__(inner.count, inner.byte_s)
        self.inner, self.places = inner, np.array(places)
        self.flags = inner.flags

    @property
    def emitted(self) -> Complex:
        return self.inner.emitted[self.places]

    def take(self, data: bytes) -> list[Emitted]:
        changes = self.inner.feed(data, self.time_s)
        self.time_s = self.inner.time_s
        return self._in_order(changes)

    def until(self, time_s: float) -> list[Emitted]:
        return self._in_order(self.inner.until(time_s))

    def _in_order(self, changes: list[Emitted]) -> list[Emitted]:
        return [Emitted(one.time_s, one.amplitudes[self.places]) for one in changes]


@dataclass(frozen=True)
class Board:
    """A board: its limits, its bytes and their virtual twin. Each board is one file of `palmfield.drive.boards`.

    description: description in words; layouts: layouts of its arrays, that of option `--board` first; empty for any
    unit, most_units: transducers of one unit, and largest number of units on one line; units: number of units in use
    arrays: least and largest number of arrays of a scene that it drives together
    line: line for its bytes, None for a board without bytes; max_frame_rate_Hz: frames per second, inf for any
    phase_steps: phase steps in a turn, None for any phase
    amplitude, amplitude_steps: kind of amplitudes of each transducer, and number of levels above 0
    takes: "amplitudes": a frame contains the amplitude of each transducer; "focus": place and level of one focus
    start, stop: byte sequences before the first frame and after the last; both silence the board
    when_host_dies, cannot_guarantee: one sentence each
    modulates: whether the board generates an envelope, which the scene must request
    keys: keys of palmfield.driver for this board, in addition to `board`
    dither: whether amplitudes are made by switching some transducers on and others off
    compensate: whether the sent drive compensates dead and inverted transducers and measured phases
    places: place of each transducer in the byte order of the board; empty for the order of the layout
    """

    name: str
    description: str
    layouts: tuple[str, ...] = ()
    unit: int = 1
    most_units: int = 1
    units: int = 1
    arrays: tuple[int, int] = (1, 1)
    line: Line | None = None
    max_frame_rate_Hz: float = math.inf
    phase_steps: int | None = None
    amplitude: AmplitudeKind = "continuous"
    amplitude_steps: int | None = None
    takes: Literal["amplitudes", "focus"] = "amplitudes"
    start: bytes = b""
    stop: bytes = b""
    when_host_dies: str = ""
    cannot_guarantee: str = ""
    modulates: bool = False
    keys: tuple[str, ...] = ()
    dither: bool = False
    compensate: bool = False
    places: tuple[int, ...] = ()

    @property
    def exact(self) -> bool:
        """Whether the emission of this board equals the commanded drive exactly."""
        return self.line is None

    @property
    def frame_rate(self) -> str:
        """`max_frame_rate_Hz` in words."""
        return rate_in_words(self.max_frame_rate_Hz)

    @property
    def transducers(self) -> int:
        """Number of transducers."""
        return self.unit * self.units

    @property
    def levels(self) -> bool:
        """Whether this board plays amplitudes between off and full."""
        return self.amplitude != "on_off" or self.dither

    @property
    def frame_bytes(self) -> int:
        """Number of bytes of one frame."""
        if self.takes == "focus":
            return len(self.encode_focus((0.0, 0.0, 0.2), 0.0))
        return 0 if self.exact else len(self.encode(np.zeros(self.transducers)))

    @property
    def frame_time_s(self) -> float:
        """Return the time of a frame on the line [s]."""
        return 0.0 if self.line is None else self.line.time_s(self.frame_bytes)

    @property
    def phase_loss(self) -> float:
        """Expected share of the focal pressure that is left after the rounding of phases."""
        if self.phase_steps is None:
            return 1.0
        from palmfield.drive.quantise import phase_loss

        return phase_loss(self.phase_steps)

    def sized(self, transducers: int) -> Self:
        """Return this board with the units for this number of transducers. Raises DeviceError if no number fits."""
        units, rest = divmod(transducers, self.unit)
        if self.exact:
            return self
        if rest or not 1 <= units <= self.most_units:
            several = f" to {self.unit * self.most_units} in steps of {self.unit}" if self.most_units > 1 else ""
            raise DeviceError(
                f"board '{self.name}' cannot drive {transducers} transducers; allowed: {self.unit}{several}"
            )
        return replace(self, units=units)

    def with_keys(self, keys: Mapping[str, Any]) -> Self:
        """Return this board with values for some of its `keys`. Raises DeviceError for a key that it does not have."""
        for key in keys:
            if key not in self.keys:
                own = f"it has {', '.join(self.keys)}" if self.keys else "it has no settings"
                raise DeviceError(f"board '{self.name}' has no {key}; {own}", setting=key)
        return replace(self, **keys)

    def rounded(self, levels: Float) -> Float:
        """Return the emitted levels for commanded levels 0..1 that all transducers share, same shape."""
        return levels

    def modulating(self, frequency_Hz: float) -> Self:
        """Return this board with its envelope at a rate [Hz]; only for boards with `modulates`.

        Raises DeviceError for a rate that the board cannot play."""
        raise DeviceError(
            f"board '{self.name}' cannot make an envelope of {frequency_Hz:g} Hz; allowed: a board that modulates"
        )

    def encode(self, amplitudes: ArrayLike) -> bytes:
        """Return the bytes of one frame.

        amplitudes: complex amplitude of each transducer relative to full drive, e^{-iwt}, shape (n,)
        Raises DeviceError for another shape and for amplitudes that the board cannot play.
        """
        raise DeviceError(f"board '{self.name}' takes {self._input()}, not amplitudes; use another board")

    def encode_focus(self, focus: ArrayLike, level: float) -> bytes:
        """Return the bytes of one frame of a board whose frames contain a focus.

        focus: focus in the array frame [m], shape (3,); level: amplitude of all transducers, 0..1
        Raises DeviceError for a focus or level that the board cannot play.
        """
        raise DeviceError(f"board '{self.name}' takes {self._input()}, not a focus; allowed: amplitudes")

    def twin(self) -> Twin:
        """Return the twin, with transducers in byte order. Raises DeviceError for a board without bytes."""
        raise DeviceError(f"board '{self.name}' takes {self._input()}, so it has no virtual twin; use another board")

    def wired_twin(self) -> Twin:
        """Return the twin with transducers in the order of the layout, for any wiring."""
        return RewiredTwin(self.twin(), self.places) if self.places else self.twin()

    def decode(self, data: bytes) -> list[Complex]:
        """Return the emission after each change, from power-up on, shape (n,) each."""
        twin = self.wired_twin()
        changes = twin.take(data)
        return list(map(attrgetter("amplitudes"), (*changes, *twin.until(twin.time_s + TWIN_DELAY_S))))

    def _input(self) -> str:
        return "no bytes" if self.exact else "a focus" if self.takes == "focus" else "amplitudes"


def play(board: Board, amplitudes: ArrayLike) -> Complex:
    """Return the emission of the board for the commanded `amplitudes`.

    amplitudes: complex amplitude of each transducer relative to full drive, e^{-iwt}, shape (n,), in the order of the
    layout
    Returns amplitudes of the same shape: unchanged if the board is exact, else decoded by the virtual twin from the
    bytes. Raises DeviceError for amplitudes that the board cannot play.
    """
    if board.line is None:
        return np.array(amplitudes, dtype=np.complex128)
    return board.decode(board.encode(amplitudes))[-1]


# -- common parts of codecs ------------------------------------------------------------------------------------------

FULL = 1.0 + 1e-6
"""Largest amplitude that counts as full drive."""


def commanded(board: Board, amplitudes: ArrayLike) -> Complex:
    """Return amplitudes in the byte order of the board, (n,). Raises DeviceError for other shapes, above full drive."""
    values = np.asarray(amplitudes, dtype=np.complex128)
    if values.shape != (board.unit * board.units,):
        raise DeviceError(f"a frame of {board.name} has shape {values.shape}; give ({board.transducers},)")
    magnitude = np.abs(values)
    bad = ~(magnitude <= FULL)
    if np.logical_or.reduce(bad):
        number = int(np.flatnonzero(bad)[0])
        raise DeviceError(
            f"transducer {number} has amplitude {magnitude[number]:.4g}; allowed: 0 (off) to 1 (full drive)"
        )
    if board.places:
        ordered = np.empty_like(values)
        ordered[list(board.places)] = values
        return ordered
    return values


def switched(board: Board, amplitudes: ArrayLike) -> tuple[Complex, np.ndarray]:
    """Return amplitudes of a board that plays only off and full, and which transducers are on, shapes (n,).

    Raises DeviceError for an amplitude between off and full, unless the board dithers. With dither, the amplitude is
    the share of active transducers, and the choice of transducers is fixed.
    """
    values = commanded(board, amplitudes)
    magnitude = np.abs(values)
    if board.dither:
        return values, magnitude > thresholds(len(values))
    on = magnitude != 0.0
    bad = on & (magnitude < 1.0 - (FULL - 1.0))
    if np.logical_or.reduce(bad):
        number = int(np.flatnonzero(bad)[0])
        raise DeviceError(
            f"transducer {number} has amplitude {magnitude[number]:.4g}; {board.name} has a fixed 50 % duty cycle, "
            "so only 0 (off) and 1 (full) are possible: use drive amplitude 1, dither, or board ideal"
        )
    return values, on


def thresholds(count: int) -> Float:
    """Return the amplitude above which each transducer is on, (count,): evenly spaced, different for neighbours."""
    order = np.argsort(np.modf(GOLDEN * np.arange(count))[0], kind="stable")
    result = np.empty(count)
    result[order] = (np.arange(count) + 0.5) / count
    return result


REFERENCE_SPEED_m_s = sound_speed(Air())
"""Speed of sound in the reference air [m/s], for boards that compute the focus themselves."""


# -- limits of boards ------------------------------------------------------------------------------------------------


def slow(board: Board, rate_Hz: float) -> bool:
    """Return whether the frame rate of a board is below this rate."""
    return rate_Hz > board.max_frame_rate_Hz * (1.0 + 1e-9)


def check(
    board: Board,
    *,
    frame_rate_Hz: float,
    points_per_turn: float | None = None,
    modulated: bool,
    element: str,
    modulation_Hz: float = 0.0,
    instead: Callable[[], Sequence[str]] = lambda: ("ideal",),
    plainly: str = "modulation none or a rectangle of am_depth 1",
) -> None:
    """Raise DeviceError, with the needs of the scene and the limits of the board, for a stimulus it cannot play.

    frame_rate_Hz: frames per second that the stimulus needs, 0 if it is fixed
    points_per_turn: points on each turn of a closed path at that rate, None without a path
    modulated: whether amplitudes between 0 and full occur; modulation_Hz: rate of the modulation, 0 if unknown
    For the message: element: name of the stimulus in the scene; instead: returns alternative boards; plainly: how to
    request a modulation that an on-off amplitude can play
    """
    rate = max(frame_rate_Hz, 2.0 * modulation_Hz)
    needs_amplitude = modulated and not board.levels
    too_fast = slow(board, rate)
    if not needs_amplitude and not too_fast:
        return
    required = ["continuous amplitude"] if needs_amplitude else []
    required += [f"{rate:.4g} frames/s"] if rate else []
    needs = f"stimulus '{element}' needs {' at '.join(required)}"
    if modulation_Hz and rate == 2.0 * modulation_Hz:
        needs += f" ({modulation_Hz:g} Hz, two frames per period)"
    gives = f"{board.name} gives {'any' if board.levels else 'on/off'} amplitude"
    gives += f" at {board.frame_rate} frames/s"
    if points_per_turn is not None and too_fast:
        needs += f" ({points_per_turn:.4g} points per turn)"
        gives += f", {points_per_turn * board.max_frame_rate_Hz / rate:.2g} points per turn"
    able = instead()
    mends = [f"board {', '.join(able[:-1]) + ' or ' * (len(able) > 1)}{able[-1]}"] if able else []
    if needs_amplitude:
        gives += f", which allows on/off AM up to {board.max_frame_rate_Hz / 2:.1f} Hz"
        mends.append(plainly)
        if "dither" in board.keys:
            mends.append("dither")
    if too_fast:
        mends.append(f"at most {math.floor(board.max_frame_rate_Hz)} frames/s")
    raise DeviceError(f"{needs}; {gives}: use {' or '.join(mends)}")


def control_rate_Hz(board: Board, timestep_s: float) -> float:
    """Return the highest frame rate [1/s] at which each frame begins with a MuJoCo step or an equal part of a step."""
    if board.exact:
        return 0.0
    period_s = 1.0 / board.max_frame_rate_Hz
    if period_s < timestep_s:
        return math.floor(board.max_frame_rate_Hz)
    return 1.0 / (math.ceil(period_s / timestep_s - 1e-9) * timestep_s)
