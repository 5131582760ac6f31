"""Boards. Each board is a module of this package with a `BOARD`; key `board` of palmfield.driver is its name."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from importlib import import_module
from pkgutil import iter_modules

import numpy as np
from numpy.typing import ArrayLike

from palmfield.config import DriverConfig
from palmfield.drive.board import Board, slow
from palmfield.errors import DeviceError, refuse_unknown


class _Boards(Mapping[str, Board]):
    """Boards by the name of their file; a file is loaded at first use, because a scene has only one board."""

    def __init__(self) -> None:
        self._names = sorted(module.name for module in iter_modules(__path__))

    def __getitem__(self, name: str) -> Board:
        if name not in self._names:
            raise KeyError(name)
        board: Board = import_module(f"{__name__}.{name}").BOARD
        return board

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


BOARDS = _Boards()
"""All boards by name."""


def board_named(name: str) -> Board:
    """Return the board of this name. Raises DeviceError for an unknown name."""
    refuse_unknown(DeviceError, "board {} is unknown", name, BOARDS)
    return BOARDS[name]


def playable_board(name: str) -> Board:
    """Return the board of this name, if it has bytes. Raises DeviceError, with the allowed names, for other names."""
    with_line = [board.name for board in BOARDS.values() if not board.exact]
    refuse_unknown(DeviceError, "board {} is unknown", name, with_line)
    return board_named(name)


def boards_for(frame_rate_Hz: float, modulated: bool, *, several_foci: bool = False) -> list[str]:
    """Return names of boards of one array that play this rate, levels or several foci, if needed; ideal is the last."""
    able = [
        board.name for board in BOARDS.values()
        if board.arrays[0] == 1 and not board.modulates and not slow(board, frame_rate_Hz)
        and (board.levels or not modulated) and not (several_foci and board.takes == "focus")
    ]  # fmt: skip
    return sorted(able, key=lambda name: BOARDS[name].exact)


def board_of(
    driver: DriverConfig, transducers: int, *, calibrated: bool = False, address: ArrayLike | None = None
) -> Board:
    """Return the board for the keys of palmfield.driver, with the units for this number of transducers.

    calibrated: whether the transducers of an array were measured, so that a driver can correct them
    address: place of each transducer in the byte order of the board, shape (transducers,); None: order of the layout
    Raises DeviceError if the board cannot drive this number of transducers, and for a key that it does not have.
    """
    board = board_named(driver.board)
    shared = {"duty_exponent": driver.duty_exponent} if "duty_exponent" in board.keys else {}
    board = board.with_keys(driver.board_keys | shared).sized(transducers)
    on = calibrated or not board.exact if driver.compensate is None else driver.compensate == "on"
    places = () if address is None else tuple(np.asarray(address).tolist())
    if len(places) != transducers or places == tuple(range(transducers)):
        # All or none of several arrays have addresses
        places = ()
    if places and board.takes == "focus":
        raise DeviceError(
            f"board '{board.name}' computes its focus itself, so the addresses of a calibration have no effect; "
            "remove them"
        )
    return replace(board, compensate=on, places=() if board.exact else places)


__all__ = ["BOARDS", "Board", "board_named", "board_of", "boards_for", "playable_board"]
