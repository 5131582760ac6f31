"""No board: every amplitude and phase, without delay, as in a simulation."""

from palmfield.drive.board import Board

BOARD = Board("ideal", "plays every amplitude and phase without delay and without rounding", arrays=(1, 1_000_000))
