"""Interface of backends that replace the stages of a step. The classes here replace none."""

import numpy as np

from palmfield.device import resolve
from palmfield.drive.transducer_response import EmittedCourse
from palmfield.simulation.kept import Rows
from palmfield.simulation.model import HapticModel
from palmfield.simulation.posed_scene import PosedScene
from palmfield.simulation.sensors import SensorPlace
from palmfield.skin.stepper import Outside, SkinStepper
from palmfield.stimulus.schedule import Moments
from palmfield.types import Float, Float32, Int


class Backend:
    """The stages for one world in a pose. A backend that computes steps elsewhere overrides this. Belongs to one state.

    whole: whether a single step costs least, so that steps are not gathered, and the ARP of bodies stays on the device.
    course: the emission over the step that has begun and its moments, if it is computed here; None otherwise.
    stepped: the skins whose step has been computed, each with the size of its state.
    `forces`, `arp` and `patterns` are called only after `begin` has returned True, which it does not here.
    """

    whole = False

    def __init__(self) -> None:
        self.course: tuple[Moments, EmittedCourse] | None = None
        self.stepped: list[tuple[int, int]] = []

    def watch(self, skin: int, place: SensorPlace) -> None:
        """Compute the ARP at the place of a sensor as well, from the next step on."""

    def forget(self) -> None:
        """Begin again, after a reset or a step that was computed elsewhere."""
        self.course, self.stepped = None, []

    def begin(self, posed: PosedScene, t0: float, watched: bool) -> bool:
        """Compute the step that begins at t0 [s] in a pose; False leaves it to the stages.

        watched: whether the drives are recorded
        """
        return False

    def forces(self, body: int) -> Float:
        """Mean force [N] on the parts of a body and torques about their origins [N m], array frame, shape (2, b, 3)."""
        raise NotImplementedError

    def arp(self, skin: int, place: SensorPlace) -> float:
        """ARP [Pa] at the beginning of the step at the place of a watched sensor."""
        raise NotImplementedError

    def patterns(self, skin: int, points: Int | None = None) -> Float32:
        """ARP [Pa] of the course at the quadrature points of a skin, shape (m, q); points: the numbers of some of them.

        A view that the next step overwrites.
        """
        raise NotImplementedError

    def outside(self, skin: int, stepper: SkinStepper) -> Outside | None:
        """The part of a skin's load outside the class of this stepper; None as in `after`, and without a class."""
        return None

    def after(self, skin: int, stepper: SkinStepper) -> Float | None:
        """State of a skin at the end of the step, shape (1, state_size), a view that the next step overwrites.

        None where the step of this stepper is not computed here.
        """
        return None


class WorldsBackend:
    """The host stages for all worlds. A backend that computes steps of many from MuJoCo frames overrides this.

    some: whether any world can ever take its step here; joined: numbers of those that take the present one, shape (g,)
    stepped: as of Backend
    `sensed` is called only if worlds have joined, which none does here.
    """

    some = False

    def __init__(self) -> None:
        self.joined: Rows = np.zeros(0, dtype=np.intp)
        self.stepped: list[tuple[int, int]] = []

    def watch(self, skin: int, place: SensorPlace) -> None:
        """Compute the reading of a sensor there as well."""

    def forget(self) -> None:
        """The state has not come from here: after a reset, or in a copy."""

    def fetch(self) -> None:
        """Update the state from the device."""

    def begin(self, places: Float, axes: Float, t0: float, watched: bool) -> None:
        """Take the frames of all worlds at the beginning of a step, t0 [s], and compute it in those that can join.

        places [m], axes: of the rows of the layout, shapes (worlds, rows, 3) and (worlds, rows, 9); watched: whether
        every substep is recorded, which is not done here
        """

    def mean_forces(self) -> list[Float]:
        """Forces [N] on the parts of each body and torques about their origins [N m], world axes, shape (g, 2, b, 3).

        In the worlds that have joined: the mean over the step that begins.
        """
        return []

    def sensed(self, skin: int, place: SensorPlace) -> tuple[Float, Float]:
        """ARP [Pa], shape (g,), displacement [m] and velocity [m/s], (g, 2), at the place of a watched sensor."""
        raise NotImplementedError

    def advance(self, skins: bool = True) -> None:
        """Carry joined worlds, their skins included, to the end of the step; skins: False leaves these unchanged."""


def serves(model: HapticModel) -> bool:
    """Whether the sound of a model is computed here: on a GPU, except echoes, boundary elements and 'accurate'."""
    fast = model.arrays.precision == "fast" and model.arrays.wall_m is None
    solved = any(skin.spec.config.body_sound == "scattering" for skin in model.skins)
    return resolve(model.spec.device) != "cpu" and fast and not solved
