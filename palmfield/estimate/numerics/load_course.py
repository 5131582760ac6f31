"""Load of a skin over time, for comparisons of meshes and steps: levels of one sound, or the path of a focus."""

import math

import numpy as np

from palmfield.drive.response_error import recursion
from palmfield.estimate.array_inputs import stimulus_of
from palmfield.session.loudest_moment import LoudestMoment
from palmfield.simulation.emission import array_drives
from palmfield.simulation.model import HapticModel
from palmfield.simulation.small_models.known_load import at_full_level
from palmfield.skin.fem.generalised_alpha import branch_weights
from palmfield.skin.reduction.reducer import Course
from palmfield.stimulus.schedule import frames_at, path_end_s, turn_rate_Hz
from palmfield.types import Complex, Float

PLACES = 48
"""Largest number of places of a moving focus with a computed ARP; in between, the ARP is linear in time."""


class LoadCourse:
    """Load of the stimulus nearest to a skin, from the begin of its sound, in the pose of the loudest moment.

    drives: emissions at the places of a moving focus, (k, N); None if the focus rests or other stimuli sound too. The
        load then is the sound of the loudest moment, with the level of the stimulus.
    Ring-up acts as two filters in sequence, which are exact for a sudden start.
    """

    def __init__(
        self, model: HapticModel, skin: int, loudest: LoudestMoment, lasted_s: float, *, moves: bool = True
    ) -> None:
        """lasted_s: length of the load [s]. moves: whether to follow a focus that moves."""
        number = stimulus_of(model, skin)
        stimulus = model.stimuli[number]
        self.config, self.lasted_s = stimulus.config, lasted_s
        self.damping_1_s = float(stimulus.response.pole.damping.min()) if model.response_on else math.inf
        self.drives: Complex | None = None
        if moves and self.config.path != "point" and sum(not one.silent for one in model.stimuli) == 1:
            rate = turn_rate_Hz(self.config)
            repeats = rate is not None and path_end_s(self.config) is None
            self.turn_s = 1.0 / rate if rate and repeats else math.inf
            self.times: Float = np.linspace(0.0, min(lasted_s, self.turn_s), PLACES)
            points, levels = frames_at(self.config, self.config.start_s + self.times)
            drive, places = (
                array_drives(model, loudest.posed.arrays)[number],
                loudest.posed.focal_points(stimulus, number),
            )
            self.drives = at_full_level(drive.unit_drives(points, places, None, levels[:, None] > 0.0))[0]

    def at(self, step_s: float) -> Course:
        """Return the load at times with spacing `step_s` [s]."""
        times: Float = step_s * np.arange(1 + max(1, round(self.lasted_s / step_s)), dtype=np.float64)
        factors = frames_at(self.config, self.config.start_s + times)[1][:, None]
        if self.drives is not None:
            at = np.interp(np.mod(times, self.turn_s), self.times, np.arange(PLACES))
            factors = factors * np.maximum(1.0 - np.abs(at[:, None] - np.arange(PLACES)), 0.0)
        for rate in (self.damping_1_s, 2.0 * self.damping_1_s) if math.isfinite(self.damping_1_s) else ():
            decay, first, last = branch_weights(step_s, 1.0 / rate)
            loads = np.zeros_like(factors)
            loads[1:] = first * factors[:-1] + last * factors[1:]
            factors = recursion([1.0, -decay], loads).real
        return Course(times, factors, self.drives is not None)
