"""A separate process that owns the port of a board and sends frames on time, independent of the process of the caller.

from palmfield.drive.player import Player
with Player(board, "/dev/ttyUSB0") as player:
    print(player.play(frames, duration_s=5.0))
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
