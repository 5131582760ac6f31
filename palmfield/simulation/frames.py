"""Encode the bytes of one frame for a board, at a moment of a scene."""

from dataclasses import replace

import numpy as np

from palmfield.drive.array_drive import ArrayDrive
from palmfield.drive.board import Board
from palmfield.drive.boards import BOARDS
from palmfield.drive.transducer_response import commanded_drive
from palmfield.simulation.cached import Cached
from palmfield.simulation.emission import Emission, PlacedStimulus
from palmfield.simulation.model import HapticModel
from palmfield.simulation.posed_scene import PosedScene
from palmfield.stimulus.schedule import frames_at
from palmfield.types import Complex

UNMODULATED = {"modulation": "none", "am_quantity": None, "am_frequency_Hz": None, "am_depth": None}


class Frames:
    """Makes frames for the board of a model. It belongs to one state, and reads ticks and points from its Emission.

    sounds: whether any stimulus was active in the last frame
    """

    sounds = False

    def __init__(self, model: HapticModel, emission: Emission):
        self.model, self.emission = model, emission
        # Commanded drive of the transducers, before the board rounds it
        self._exact: Board = replace(BOARDS["ideal"], compensate=model.board.compensate)
        # A board that makes the envelope itself always gets the drive of the loudest moment
        self._configs = [
            config.model_copy(update=UNMODULATED) if model.board.modulates else None for config in model.configs
        ]
        self._cached = Cached()

    def at(self, posed: PosedScene, time_s: float, share: float = 1.0) -> bytes:
        """Return the bytes that make the board emit the drive of the stimuli at a time [s].

        posed: the poses at that time; share: factor on all amplitudes.
        Raises SceneError for an impossible focus, DeviceError for a drive that the board cannot play.
        """
        board = self.model.board
        self.emission.begin(posed, time_s)
        placed = self.emission.placed(posed, time_s)
        if board.takes == "focus":
            part, drive, points = placed[0]
            where, factors = frames_at(part.config, np.array([time_s]))
            focus, level = points.along(where)[0], float(np.sqrt(factors[0]))
            if level > 0.0:
                level *= drive.level_at(points, where[0])
            self.sounds = level * share > 0.0
            return board.encode_focus(focus, level * share)
        target = share * self._sum(placed, posed, time_s)
        self.sounds = bool(target.any())
        return board.encode(target)

    def target(self, posed: PosedScene, time_s: float) -> Complex:
        """Return the commanded drive at a time [s], before the board encodes it, shape (N,).

        It is relative to full drive, e^{-iwt}, with all compensations for the board. The errors are those of `at`.
        """
        self.emission.begin(posed, time_s)
        return self._sum(self.emission.placed(posed, time_s), posed, time_s)

    def _sum(self, placed: list[PlacedStimulus], posed: PosedScene, time_s: float) -> Complex:
        target: Complex = np.zeros(len(posed.arrays), np.complex128)
        for number, (part, drive, points) in enumerate(placed):
            inputs = posed.arrays, drive.chosen, part.config.arp_peak_Pa, part.config.drive_amplitude, self._exact
            own = self._cached.of(number, posed.arrays.serial, ArrayDrive, *inputs)
            target += commanded_drive(self._configs[number] or part.config, own, None, np.array([time_s]), points)[0]
        return target
