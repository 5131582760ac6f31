"""What plays a drive. A board is a module of this package with a `BOARD`; key `board` of palmfield.driver names it."""

from importlib import import_module
from pkgutil import iter_modules

from palmfield.drive.boards.board import Board, check, play
from palmfield.errors import DeviceError


def _registered() -> dict[str, Board]:
    modules = [import_module(f"{__name__}.{module.name}") for module in iter_modules(__path__)]
    boards: list[Board] = [module.BOARD for module in modules if hasattr(module, "BOARD")]
    return {board.name: board for board in boards}


BOARDS = _registered()
"""All boards by name."""


def board_named(name: str) -> Board:
    """The board of that name. Raises DeviceError where there is none."""
    if name not in BOARDS:
        raise DeviceError(f"board '{name}' is not known; allowed: {', '.join(BOARDS)}")
    return BOARDS[name]


__all__ = ["BOARDS", "Board", "board_named", "check", "play"]
