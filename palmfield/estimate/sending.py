"""Compute the bytes, rates, latency and rounding error of a scene on its board before it is played."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from palmfield.acoustics.phased_array import only
from palmfield.config import StimulusConfig
from palmfield.drive.board import Board, rate_in_words
from palmfield.drive.boards import BOARDS
from palmfield.drive.focal_peak import loudest_point
from palmfield.simulation.emission import array_drives
from palmfield.simulation.model import HapticModel
from palmfield.stimulus.schedule import frame_rates
from palmfield.types import Float

LEAST_SAID_M = 0.05e-3


@dataclass(frozen=True)
class Sending:
    """Properties of the frames sent to a board.

    frame_bytes. frames_s: frames due per second, 0 if only constant frames are repeated. most_frames_s: limit of the
    line. latency_s: latency from the first byte of a frame to its sound, shortest and longest [s]. pressure_kept:
    expected fraction of the focal pressure after rounding of phases. amplitude_steps: above 0, None if continuous.
    """

    board: str
    frame_bytes: int
    frames_s: float
    most_frames_s: float
    latency_s: tuple[float, float]
    pressure_kept: float
    amplitude_steps: int | None

    def __str__(self) -> str:
        due = (
            f"{self.frames_s:.4g} frames/s due" if self.frames_s else "constant frames are repeated 10 times per second"
        )
        steps = "off or full" if self.amplitude_steps == 1 else f"{self.amplitude_steps} levels above off"
        low, high = self.latency_s
        return (
            f"{self.frame_bytes} bytes per frame, {due}, capacity of the line {rate_in_words(self.most_frames_s)}; "
            f"latency {1e3 * low:.3g} to {1e3 * high:.3g} ms; rounded phases keep {self.pressure_kept:.4f} of the "
            f"pressure; {steps}"
        )


def sending(board: Board, stimuli: Sequence[StimulusConfig]) -> Sending:
    """Return properties of the frames for some stimuli on a board that takes bytes."""
    fastest = max((rate for stimulus in stimuli for rate in frame_rates(stimulus)), default=0.0)
    takes_s, most_s = board.frame_time_s, board.max_frame_rate_Hz
    steps = 1 if not board.levels else board.transducers if board.dither else board.amplitude_steps
    latency_s = takes_s, 2.0 * takes_s
    return Sending(board.name, board.frame_bytes, fastest, most_s, latency_s, board.phase_loss, steps)


def peak_offset(model: HapticModel, number: int) -> tuple[Float, float] | None:
    """Return the vector from the first focus of a stimulus to the maximum of |p|, array frame [m], shape (3,).

    Return also the distance by which rounding of the board moves the maximum [m]. None in silence, and for several
    foci.
    """
    stimulus = model.stimuli[number]
    focus = stimulus.first_focus
    if stimulus.silent or focus.ndim != 1:
        return None
    middle = only(model.arrays.array, stimulus.transducers).positions.mean(axis=0)

    def loudest(board: Board) -> Float:
        drive = array_drives(model, model.arrays, board)[number].unit_drive(focus).amplitudes
        return loudest_point(lambda points: model.arrays.pressure64(points, drive), middle, focus)

    played = loudest(model.board)
    if model.board.exact:
        return played - focus, 0.0
    exact = loudest(replace(BOARDS["ideal"], compensate=model.board.compensate))
    return played - focus, float(np.linalg.norm(played - exact))


def offset_words(offset: Float, rounding_m: float = 0.0) -> str:
    """Describe a `peak_offset` in words."""
    aside = float(np.hypot(*offset[:2]))
    where = "nearer to" if offset[2] < 0.0 else "farther from"
    words = (
        f"the maximum of |p| lies {1e3 * abs(offset[2]):.1f} mm {where} the array than the focus "
        f"({1e3 * aside:.1f} mm to the side)"
    )
    return words + (
        f"; rounding by the board moves it by {1e3 * rounding_m:.1f} mm" if rounding_m >= LEAST_SAID_M else ""
    )
