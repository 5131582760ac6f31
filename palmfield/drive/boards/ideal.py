"""No board: every amplitude and phase at once, as a simulation may."""

from palmfield.drive.board import Board

BOARD = Board("ideal", "plays every amplitude and phase without delay and without rounding", arrays=(1, 1_000_000))
