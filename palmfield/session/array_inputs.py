"""What is known of the arrays that a stimulus drives: how loud their transducers are, and how sharply they resonate."""

import numpy as np

from palmfield.simulation.build import nearest_stimulus
from palmfield.simulation.emission import array_drives
from palmfield.simulation.model import HapticModel, StimulusModel, array_instances
from palmfield.types import Estimate


def stimulus_of(model: HapticModel, skin: int) -> int:
    """Number of the stimulus whose sound a skin's layer is made for."""
    nearest = nearest_stimulus(model.skins[skin].spec, model.stimuli)
    return next(number for number, stimulus in enumerate(model.stimuli) if stimulus is nearest)


def p0_band(model: HapticModel, stimulus: int) -> tuple[float, float] | None:
    """Factors on the skin's motion at the low and high ends of every array's p0; None where arp_peak_Pa sets the level.

    The pressures of the stimulus's arrays add up at its focus, each with its own p0, and the motion goes with the
    square.
    """
    part, arrays = model.stimuli[stimulus], model.arrays
    drive = array_drives(model, arrays)[stimulus].unit_drive(part.first_focus).amplitudes
    pressures = []
    for own in arrays.slices:
        alone = np.zeros_like(drive)
        alone[own] = drive[own]
        pressures.append(arrays.pressure64(part.first_focus[None], alone)[0])
    whole = abs(sum(pressures)) ** 2
    if part.config.arp_peak_Pa is not None or whole == 0.0:
        return None
    known = [array.p0 for array in array_instances(model.spec)]
    low, high = [p0.low / p0.value for p0 in known], [p0.high / p0.value for p0 in known]
    return abs(np.dot(low, pressures)) ** 2 / whole, abs(np.dot(high, pressures)) ** 2 / whole


def p0_known(model: HapticModel, stimulus: int) -> list[Estimate]:
    """p0 of the arrays of a stimulus, each once where several have the same."""
    instances = array_instances(model.spec)
    return list(dict.fromkeys(instances[number].p0 for number in model.stimuli[stimulus].spec.arrays))


def quality_known(model: HapticModel, stimulus: int) -> list[Estimate]:
    """Quality of the transducers of a stimulus's arrays, each once where several have the same."""
    instances = array_instances(model.spec)
    return list(dict.fromkeys(instances[number].quality for number in model.stimuli[stimulus].spec.arrays))


def qualities(stimulus: StimulusModel) -> str:
    """Quality factors of the transducers that a stimulus drives, in words."""
    response = stimulus.response
    own = np.broadcast_to(response.pole.Q, response.delays_s.shape)[stimulus.transducers]
    return "Q " + " and ".join(f"{quality:g}" for quality in np.unique(own))
