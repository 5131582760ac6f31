"""Where a small model of a skin no longer serves, and how the whole layer goes on from it."""

import numpy as np

from palmfield.errors import SceneError
from palmfield.simulation.emission import Emission
from palmfield.simulation.model import HapticModel
from palmfield.simulation.posed_scene import PosedScene
from palmfield.simulation.radiation import Radiation
from palmfield.simulation.state import HEADER, WHOLE, HapticState, claim
from palmfield.skin.fem.wedge_stepper import WedgeStepper
from palmfield.stimulus.schedule import first_point
from palmfield.types import Complex, Float


def leaves_small_model(
    model: HapticModel,
    state: HapticState,
    skin: int,
    posed: PosedScene,
    reference: PosedScene,
    emission: Emission,
    t0: float,
) -> bool:
    """Whether a skin's small model ends here: body, arrays or focus have moved, or the run begins after the sound.

    Raises SceneError instead where key `solver` names what steps it.
    """
    part = model.skins[skin]
    if state.skins[skin][0, 0] == WHOLE:
        return False
    stepper = model.begin[skin].value
    if stepper.any_pose and stepper.any_course:
        return False
    start_s = model.stimuli[model.sounding].config.start_s
    moved = posed.skins[skin] is not reference.skins[skin] or posed.arrays is not model.arrays
    if not moved:
        stimulus, _, points = emission.placed(posed, t0)[model.sounding]
        difference = np.abs(points.at(first_point(stimulus.config)) - stimulus.reference_foci)
        moved = bool(np.maximum.reduce(difference, axis=None) > part.still_m)
    numbers = state.skins[skin][0, HEADER : HEADER + stepper.state_size]
    late = start_s < t0 - 1e-9 and not stepper.any_course and not np.logical_or.reduce(numbers)
    if (stepper.any_pose or not moved) and not late:
        return False
    if part.spec.config.solver == stepper.name:
        what = (
            f"body '{part.spec.config.body}', an array or the focus has moved" if moved else "the skin begins at rest"
        )
        raise SceneError(
            f"plugin 'palmfield.skin' instance '{part.spec.name}': key 'solver' has value '{stepper.name}', but {what} "
            f"at {t0:g} s, which the small model was not made for; set solver to auto or wedges"
        )
    return True


def continue_on_whole_layer(
    model: HapticModel,
    state: HapticState,
    skin: int,
    posed: PosedScene,
    emission: Emission,
    radiation: Radiation,
    amplitudes: Complex,
    t0: float,
) -> tuple[WedgeStepper, Float]:
    """Turn a small model's motion into one of the whole layer, in place; amplitudes: emitted at t0 [s], shape (N,).

    Returns the whole layer's stepper and its numbers, shape (1, state_size), a view of the state.
    """
    small, whole = model.begin[skin].value, model.whole[skin].value
    numbers = state.skins[skin][:, HEADER:]

    def pressure() -> Float:
        course = emission.now(posed, amplitudes, t0)
        assert small.points is not None
        radiation.choose(skin, small.points)
        if course.unit is not None and course.levels is not None:
            return np.asarray(abs(course.levels[0]) ** 2 * radiation.on(posed, skin, "load", course.unit).arp)
        if course.emitted is not None:
            return radiation.on(posed, skin, "load", course.emitted[0]).arp.astype(np.float64)
        return np.zeros(len(small.points))

    numbers[:, : whole.state_size] = small.lifted(numbers[:, : small.state_size], pressure)
    claim(model, state, skin, whole)
    return whole, numbers[:, : whole.state_size]
