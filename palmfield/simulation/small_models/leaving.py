"""End of the validity of a reduced model of a skin, and the change to the whole layer.

In every step, the part of the loads outside the class of the modes is measured.
"""

import math
from typing import Any

import numpy as np

from palmfield.drive.transducer_response import present_drive
from palmfield.errors import SceneError
from palmfield.simulation.emission import Emission, array_drives
from palmfield.simulation.model import HapticModel
from palmfield.simulation.posed_scene import PosedScene
from palmfield.simulation.radiation import Radiation
from palmfield.simulation.state import HEADER, WHOLE, HapticState, claim
from palmfield.skin.stepper import Outside, SkinStepper, SurfaceLoads
from palmfield.stimulus.schedule import first_point
from palmfield.types import Complex, Float

SHORT_WAVES = 3.0
"""Velocity error due to load outside the class, divided by its fraction of the pressure; approximate.

Such a load makes shorter waves than the loads of the class. Short waves cause faster motion, because sudden pressure
moves the skin only to a depth of one wavelength.
"""


def leaves_small_model(
    model: HapticModel,
    state: HapticState,
    skin: int,
    posed: PosedScene,
    reference: PosedScene,
    emission: Emission,
    t0: float,
) -> bool:
    """Return whether the reduced model of a skin has become invalid, so that the full model must replace it.

    It is invalid if the body, an array or the focus has moved, or if the run begins after the start of the sound.

    Raises SceneError instead of returning True if key `solver` names this reduced model.
    """
    part = model.skins[skin]
    if state.skins[skin][0, 0] == WHOLE:
        return False
    stepper = model.begin[skin].value
    if stepper.any_pose and stepper.any_course:
        return False
    start_s = model.stimuli[model.sounding].config.start_s
    moved = posed.skins[skin].serial != reference.skins[skin].serial or posed.arrays.serial != model.arrays.serial
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
            f"{part.spec.element}: key 'solver' has value '{stepper.name}', but {what} at {t0:g} s, for which the "
            "reduced model was not built; set solver to auto or wedges"
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
) -> None:
    """Expand the motion of a reduced model to the full layer, in place. amplitudes: emission at t0 [s], shape (N,)"""
    small, whole = model.begin[skin].value, model.whole[skin].value
    numbers = state.skins[skin][:, HEADER:]

    def pressure() -> Float:
        course = emission.now(posed, amplitudes, t0)
        drive, factor = present_drive(course)
        assert small.points is not None
        if drive is None:
            return np.zeros(len(small.points))
        radiation.choose(skin, small.points)
        return factor * radiation.on(posed, skin, "load", drive, course.serial).arp.astype(np.float64)

    lifted = small.lifted(numbers[:, : small.state_size], pressure)
    claim(model, state, skin, whole)
    numbers[:, : whole.state_size] = lifted


class OutsideClass:
    """The part of the loads on a skin in a run that was outside the class of its modes.

    sums: sums of squares over all substeps
    loudest: largest energy of the load in one step, at least that of a focus in the middle of the skin; None initially
    """

    def __init__(self) -> None:
        self.sums = Outside(0.0, 0.0, 0.0, 0.0)
        self.loudest: float | None = None

    def add(self, step: Outside) -> float:
        """Add the loads of a step. Return the part outside the class, in the energy norm, relative to the loudest step.

        `loudest` must be set.
        """
        assert self.loudest is not None
        a, b, c, d = self.sums
        self.sums = Outside(a + step.energy, b + step.energy_of_all, c + step.plain, d + step.plain_of_all)
        self.loudest = max(self.loudest, step.energy_of_all)
        return math.sqrt(step.energy / self.loudest) if self.loudest > 0.0 else 0.0

    @property
    def energy_share(self) -> float:
        """Return the fraction of all loads outside the class, in the energy norm; about the displacement error."""
        return math.sqrt(self.sums.energy / self.sums.energy_of_all) if self.sums.energy_of_all > 0.0 else 0.0

    @property
    def pressure_share(self) -> float:
        """Return the fraction of all loads outside the class, in the norm of the pressure."""
        return math.sqrt(self.sums.plain / self.sums.plain_of_all) if self.sums.plain_of_all > 0.0 else 0.0

    def errors(self, added: tuple[float, float | None]) -> tuple[float, float | None]:
        """Return the errors that modes add (`SkinStepper.adds_error`), with the effect of loads outside the class."""
        displacement, velocity = added
        quick = SHORT_WAVES * self.pressure_share
        return math.hypot(displacement, self.energy_share), None if velocity is None else math.hypot(velocity, quick)


def leaves_class(model: HapticModel, skin: int, share: Any) -> Any:
    """Return whether modes have become invalid.

    This is so if the part of the load of a step outside their class exceeds the target accuracy.
    share: see OutsideClass.add, one number or several
    If key `solver` requests modes, they continue, and the error of the run includes this part.
    """
    config = model.skins[skin].spec.config
    return (config.solver == "auto") & (share > config.accuracy)


def loudest_load(
    model: HapticModel, skin: int, stepper: SkinStepper, reference: PosedScene, radiation: Radiation
) -> float:
    """Return the load energy of a steady focus in the middle of a skin over a step, in the reference pose. It is the
    reference for the size of loads, so the load of sound that misses the skin counts as small.
    """
    frame = reference.skins[skin].body.frame
    centre = frame.points(np.array(model.skins[skin].spec.patch_centre))
    assert stepper.points is not None
    radiation.choose(skin, stepper.points)
    loudest = 0.0
    for drive in array_drives(model, reference.arrays):
        try:
            amplitudes = drive.unit_drive(centre).amplitudes
        except SceneError:
            continue  # an array that does not face this skin
        arp = radiation.on(reference, skin, "load", amplitudes).arp
        steady = np.ones((1, model.substeps, 1))
        loudest = max(loudest, stepper.outside(SurfaceLoads(arp[None, None], steady, steady)).energy_of_all)
    return loudest
