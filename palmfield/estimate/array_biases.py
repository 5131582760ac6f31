"""Biases from arrays: warm-up, and level not proportional to the drive; with size if measured."""

import math
from typing import TYPE_CHECKING

import numpy as np

from palmfield.drive.board import FULL
from palmfield.estimate.bias import Bias
from palmfield.simulation.model import HapticModel, array_instances
from palmfield.types import Complex

if TYPE_CHECKING:
    from palmfield.acoustics.calibration_file import Calibration

SETTLED = 0.01
"""Relative difference from the final amplitude below which warm-up has ended."""


def array_biases(model: HapticModel, stimulus: int, drive: Complex) -> list[Bias]:
    """Return the biases from the arrays of a stimulus. drive: drive of all transducers at the loudest moment, shape
    (N,)
    """
    instances = array_instances(model.spec)
    calibrations = [instances[number].calibration for number in model.stimuli[stimulus].spec.arrays]
    level = float(np.abs(drive[model.stimuli[stimulus].transducers]).max(initial=0.0))
    return [
        _warm_up(calibrations),
        *_level(calibrations, level),
        Bias("coupling of transducers", None, None, "sign unknown: mutual coupling of the transducers is not modelled"),
    ]


def _warm_up(calibrations: "list[Calibration | None]") -> Bias:
    measured = [one.warm_up for one in calibrations if one is not None and one.warm_up is not None]
    if not measured or len(measured) < len(calibrations):
        why = "resonance and level drift over minutes; usually the sound becomes weaker"
        return Bias("warm-up", None, None, f"{why}; not in the calibration")
    starts = [(1.0 + one.drop) ** 2 - 1.0 for one in measured]
    settled_s = max(one.time_s * max(math.log(max(abs(one.drop), SETTLED) / SETTLED), 0.0) for one in measured)
    drops = " and ".join(f"{100 * one.drop:+.1f}" for one in measured)
    why = f"measured: the pressure starts {drops} % from its final value, and is within 1 % after {settled_s:.0f} s"
    return Bias("warm-up", min(0.0, *starts), max(0.0, *starts), why)


def _level(calibrations: "list[Calibration | None]", level: float) -> list[Bias]:
    """Return the bias if the pressure is p0 a^exponent; a run assumes p0 a."""
    measured = [one.level for one in calibrations if one is not None and one.level is not None]
    if not measured or level == 0.0:
        return []
    beyond = [one.linear_to for one in measured if level > FULL * one.linear_to]
    if beyond:
        end = min(beyond)
        why = f"measured: above level {end:.2g} more than 5 % of the pressure is missing; the level here is {level:.2g}"
        return [Bias("saturation of the drive", None, None, why)]
    ends = [
        level ** (2.0 * (one.exponent + side * 1.96 * one.exponent_sd - 1.0)) - 1.0
        for one in measured
        for side in (-1, 1)
    ]
    exponents = " and ".join(f"{one.exponent:.3f}" for one in measured)
    why = (
        f"measured: pressure is proportional to the level to the power {exponents}; the highest level here is "
        f"{level:.2g}"
    )
    return [Bias("level of the drive", min(0.0, *ends), max(0.0, *ends), why)]
