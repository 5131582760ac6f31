"""A process of its own that owns a board's port and sends frames on time, whatever the caller's process does.

from palmfield.drive.player import Player
with Player(board, "/dev/ttyUSB0") as player:
    print(player.play(frames, duration_s=5.0))
"""

from typing import TYPE_CHECKING

from palmfield.lazy_names import lazy_names

if TYPE_CHECKING:
    from palmfield.drive.player.caller import Player
    from palmfield.drive.player.report import PlayReport

# The process imports this package too, and neither NumPy nor boards: names are loaded when they are asked for
_WHERE = {"Player": "caller", "PlayReport": "report"}
__all__ = ["PlayReport", "Player"]
__getattr__, __dir__ = lazy_names(__name__, _WHERE)
