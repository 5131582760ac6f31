"""From focal points to what transducers are told and emit, and boards that play it.

from palmfield.drive import solve_foci
drive = solve_foci([[0.0, 0.0, 0.15], [0.02, 0.0, 0.15]], array, air).drive
"""

from typing import TYPE_CHECKING

from palmfield.lazy_names import lazy_names

if TYPE_CHECKING:
    from palmfield.drive.array_drive import ArrayDrive, UnitDrive
    from palmfield.drive.board import Board, Emitted, Twin
    from palmfield.drive.boards import BOARDS, board_named
    from palmfield.drive.foci import Foci, solve_foci
    from palmfield.drive.frame_log import FrameLog, read_log
    from palmfield.drive.playback import TimedFrame, frame_times
    from palmfield.drive.ports import open_port
    from palmfield.drive.recording import record
    from palmfield.drive.response import Pole
    from palmfield.drive.response_error import ResponseError
    from palmfield.drive.shapes import bottle, twin_trap, vortex
    from palmfield.drive.transducer_response import TransducerResponse, commanded_drive
    from palmfield.drive.transport import FileTransport
    from palmfield.drive.virtual import VirtualBoard

_WHERE = {
    **dict.fromkeys(("ArrayDrive", "UnitDrive"), "array_drive"),
    **dict.fromkeys(("Board", "Emitted", "Twin"), "board"),
    **dict.fromkeys(("BOARDS", "board_named"), "boards"),
    **dict.fromkeys(("Foci", "solve_foci"), "foci"),
    **dict.fromkeys(("FrameLog", "read_log"), "frame_log"),
    **dict.fromkeys(("TimedFrame", "frame_times"), "playback"),
    "Pole": "response",
    "ResponseError": "response_error",
    **dict.fromkeys(("bottle", "twin_trap", "vortex"), "shapes"),
    **dict.fromkeys(("TransducerResponse", "commanded_drive"), "transducer_response"),
    "FileTransport": "transport",
    "open_port": "ports",
    "record": "recording",
    "VirtualBoard": "virtual",
}
__all__ = [
    "BOARDS",
    "ArrayDrive",
    "Board",
    "Emitted",
    "FileTransport",
    "Foci",
    "FrameLog",
    "Pole",
    "ResponseError",
    "TimedFrame",
    "TransducerResponse",
    "Twin",
    "UnitDrive",
    "VirtualBoard",
    "board_named",
    "bottle",
    "commanded_drive",
    "frame_times",
    "open_port",
    "read_log",
    "record",
    "solve_foci",
    "twin_trap",
    "vortex",
]
__getattr__, __dir__ = lazy_names(__name__, _WHERE)
