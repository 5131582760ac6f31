"""No board: every amplitude and phase at once, as a simulation may."""

import math

from palmfield.drive.boards.board import Board

BOARD = Board("ideal", math.inf, "continuous", "plays every amplitude and phase at once and without rounding")
