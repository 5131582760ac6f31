"""From focal points to what transducers are told and emit, and boards that play it.

from palmfield.drive import solve_foci
drive = solve_foci([[0.0, 0.0, 0.15], [0.02, 0.0, 0.15]], array, air).drive
"""

from typing import TYPE_CHECKING

from palmfield.lazy_names import lazy_names

if TYPE_CHECKING:
    from palmfield.drive.array_drive import ArrayDrive, UnitDrive
    from palmfield.drive.boards import BOARDS, Board, board_named
    from palmfield.drive.foci import Foci, solve_foci
    from palmfield.drive.link import Link, RecordLink, open_link
    from palmfield.drive.playback import Played, TimedFrame, frame_times, play_frames, timed_frames
    from palmfield.drive.response import Pole
    from palmfield.drive.response_error import ResponseError
    from palmfield.drive.shapes import bottle, twin_trap, vortex
    from palmfield.drive.transducer_response import TransducerResponse, commanded_drive

_WHERE = {
    **dict.fromkeys(("ArrayDrive", "UnitDrive"), "array_drive"),
    **dict.fromkeys(("BOARDS", "Board", "board_named"), "boards"),
    **dict.fromkeys(("Foci", "solve_foci"), "foci"),
    **dict.fromkeys(("Link", "RecordLink", "open_link"), "link"),
    **dict.fromkeys(("Played", "TimedFrame", "frame_times", "play_frames", "timed_frames"), "playback"),
    "Pole": "response",
    "ResponseError": "response_error",
    **dict.fromkeys(("bottle", "twin_trap", "vortex"), "shapes"),
    **dict.fromkeys(("TransducerResponse", "commanded_drive"), "transducer_response"),
}
__all__ = [
    "BOARDS",
    "ArrayDrive",
    "Board",
    "Foci",
    "Link",
    "Played",
    "Pole",
    "RecordLink",
    "ResponseError",
    "TimedFrame",
    "TransducerResponse",
    "UnitDrive",
    "board_named",
    "bottle",
    "commanded_drive",
    "frame_times",
    "open_link",
    "play_frames",
    "solve_foci",
    "timed_frames",
    "twin_trap",
    "vortex",
]
__getattr__, __dir__ = lazy_names(__name__, _WHERE)
