"""A board with one array that emits a focus, without a scene."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import cast

import numpy as np

from palmfield.acoustics.arrays import LAYOUTS, layout
from palmfield.acoustics.calibration_file import calibrated, read_calibration
from palmfield.acoustics.focus import compensate, focus
from palmfield.acoustics.transducer import ANY_P0
from palmfield.acoustics.transducer_file import read_transducers
from palmfield.config import DriverConfig, parse
from palmfield.config.base import naming_keys
from palmfield.config.driver import SAFETY_KEYS
from palmfield.drive.board import Board, check
from palmfield.drive.boards import BOARDS, board_of, boards_for, playable_board
from palmfield.drive.frame_log import LogHead
from palmfield.errors import DeviceError, SceneError
from palmfield.types import Air, Array, Complex, Estimate, Float


@dataclass(frozen=True)
class FocusSound:
    """Parameters of a focus that is played without a scene.

    level: amplitude of all transducers, 0 to 1
    am_frequency_Hz: frequency of a sine modulation between silence and that level; 0 for no modulation
    p0_Pa_m: p0 of the transducers [Pa m], as in layouts; None: value of the layout
    air: air of the sound field
    layout: layout of the array, or a CSV file of its transducers; None: first layout of the board
    calibration: calibration file of the transducers, as in key `calibration` of palmfield.array
    """

    level: float = 1.0
    am_frequency_Hz: float = 0.0
    p0_Pa_m: float | None = None
    air: Air = field(default_factory=Air)
    layout: str | None = None
    calibration: Path | None = None


@dataclass(frozen=True)
class FocusBoard:
    """A board with its array and its sound.

    p0: p0 of the layout or the calibration
    notes: messages for the user
    sound: the sound, without a modulation that the board itself makes
    layout: layout of the array
    """

    board: Board
    array: Array
    p0: Estimate
    sound: FocusSound
    driver: DriverConfig
    layout: str
    notes: tuple[str, ...]

    def unit(self, place: Float) -> Complex:
        """Return the amplitudes of all transducers for a focus [m] at full level.

        Raises SceneError for an impossible focus.
        """
        unit = focus(self.array, self.sound.air, place)
        return compensate(self.array, unit) if self.board.compensate else unit

    def frame(self, place: Float, unit: Complex, level: float) -> bytes:
        """Return one frame for a focus [m], shape (3,), from the result `unit` of `unit` for this focus."""
        board = self.board
        return board.encode_focus(place, level) if board.takes == "focus" else board.encode(level * unit)

    @property
    def band(self) -> tuple[float, float]:
        """Return the factors of the squared pressure at both ends of the range of p0.

        A p0 set by the user has no range.
        """
        if self.sound.p0_Pa_m is not None:
            return 1.0, 1.0
        return (self.p0.low / self.p0.value) ** 2, (self.p0.high / self.p0.value) ** 2

    @property
    def head(self) -> LogHead:
        """Return the head of a log of its frames."""
        driver, loudness = self.driver, self.array.p0_Pa_m
        limits = driver.model_dump(include=set(SAFETY_KEYS), exclude_none=True, exclude_defaults=True)
        own, high = driver.of_board(self.board.keys), loudness * self.band[1] ** 0.5
        head = LogHead(
            self.board.name, len(self.array), self.layout, self.sound.air, own, limits,
            p0_Pa_m=loudness, p0_high_Pa_m=high,
        )  # fmt: skip
        return head.measured(self.array, self.board.places)


def array_named(name: str, p0_Pa_m: float | None = None) -> tuple[Array, Estimate]:
    """Return the array of a layout, or of a CSV file of transducers, and its p0.

    Raises SceneError for an unknown name.
    """
    if not name.lower().endswith(".csv"):
        return layout(name, p0_Pa_m), LAYOUTS[name].p0
    return read_transducers(name).array(ANY_P0.value if p0_Pa_m is None else p0_Pa_m), ANY_P0


def focus_board(board: str, sound: FocusSound, keys: Mapping[str, object]) -> FocusBoard:
    """Return a board with its array.

    keys: keys of the board, as in palmfield.driver
    Raises SceneError for a board with several arrays, and for an invalid level. Raises DeviceError for an unknown
    board, a layout that it does not drive, and a level or a modulation that it cannot play.
    """
    chosen = playable_board(board)
    name = chosen.layouts[0] if sound.layout is None else sound.layout
    kind = "csv" if name.lower().endswith(".csv") else name
    if kind not in chosen.layouts or name == "csv":
        allowed = ("FILE.csv of its transducers" if one == "csv" else one for one in chosen.layouts)
        raise DeviceError(f"board '{board}' cannot drive layout '{name}'; allowed: {', '.join(allowed)}")
    if chosen.arrays[0] > 1:
        raise SceneError(f"board '{board}' drives {chosen.arrays[0]} arrays; give a scene with their positions")
    if not 0.0 <= sound.level <= 1.0:
        raise SceneError(f"--level has value {sound.level:g}; allowed: 0 (off) to 1 (full drive)")
    array, p0 = array_named(name, sound.p0_Pa_m)
    name = array.name
    if sound.calibration is not None:
        calibration = read_calibration(sound.calibration)
        if calibration.p0 is not None and sound.p0_Pa_m is None:
            array, p0 = replace(array, p0_Pa_m=calibration.p0.value), calibration.p0
        array = calibrated(array, calibration)
    texts = {key: str(value) for key, value in keys.items()}
    element = "--focus with driver keys"
    driver = cast(DriverConfig, parse(DriverConfig, {**texts, "board": board}, element))
    with naming_keys(element, driver):
        chosen = board_of(driver, len(array), calibrated=sound.calibration is not None, address=array.address)
    notes = []
    if chosen.modulates:
        # The board itself modulates, for any focus
        if sound.am_frequency_Hz > 0.0:
            chosen, sound = chosen.modulating(sound.am_frequency_Hz), replace(sound, am_frequency_Hz=0.0)
        else:
            notes.append(f"{board} always modulates, at its own frequency; give another by --am-frequency")
    modulated = sound.am_frequency_Hz > 0.0 or sound.level not in (0.0, 1.0)

    def able() -> list[str]:
        return [one for one in boards_for(2.0 * sound.am_frequency_Hz, modulated) if not BOARDS[one].exact]

    check(
        chosen, frame_rate_Hz=0.0, modulated=modulated, element="focus", modulation_Hz=sound.am_frequency_Hz,
        instead=able, plainly="no --am-frequency and --level 1",
    )  # fmt: skip
    return FocusBoard(chosen, array, p0, sound, driver, name, tuple(notes))


def am_share(time_s: float, frequency_Hz: float) -> float:
    """Return the modulation factor of the level at a time [s]: a sine between 0 and 1, or 1 without modulation."""
    return 0.5 * (1.0 + float(np.sin(2.0 * np.pi * frequency_Hz * time_s))) if frequency_Hz > 0.0 else 1.0
