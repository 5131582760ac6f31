"""What a SonicSurface gets for a focus, and what it emits of it: how much its rounding costs."""

import numpy as np

from palmfield.acoustics import layout, pressure
from palmfield.acoustics.focus import focus
from palmfield.drive.boards import BOARDS
from palmfield.types import Air

board, array, air = BOARDS["sonicsurface"], layout("sonicsurface"), Air()
target = np.array([0.0, 0.01, 0.15])
wanted = focus(array, air, target)
data = board.encode(wanted)
emitted = board.decode(board.start + data)[-1]
there = [abs(pressure(target[None], array, drive, air).pressure[0]) for drive in (wanted, emitted)]
print(f"{len(data)} bytes a frame, {board.frame_rate} frames/s")
print(f"{100 * there[1] / there[0]:.1f} % of the pressure is left")
