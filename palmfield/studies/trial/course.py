"""Poses of a scene at any time of a trial, also between MuJoCo's steps."""

import math
from typing import NamedTuple

import numpy as np

from palmfield.acoustics.phased_array import PhasedArray
from palmfield.drive.playback import ON_STEP
from palmfield.errors import SceneError
from palmfield.motion.quaternions import inverse, matrices, of_turns, product, turns_of
from palmfield.session.preview import Preview
from palmfield.simulation.model import HapticModel
from palmfield.simulation.posed_scene import PosedScene, PosedSkin, PosedSurface
from palmfield.transforms import Transform, quaternion
from palmfield.types import Float

NO_OBSTACLES = np.zeros((0, 3)), np.zeros((0, 3, 3))


class Frames(NamedTuple):
    """Moving coordinate frames relative to the first array: those of the stimuli, then those of the bodies.

    positions: [m], shape (m, 3); rotations: axes as columns, shape (m, 3, 3); quaternions: the same, w first, (m, 4)
    """

    positions: Float
    rotations: Float
    quaternions: Float


class SceneCourse:
    """Poses at MuJoCo's steps, interpolated linearly; constant before the first and after the last.

    model: model of the scene; step_s: time between poses [s]; end_s: time of the last one [s]; refused: reason of an
    early end
    """

    def __init__(self, view: Preview, duration_s: float, *, as_far_as_it_goes: bool = False) -> None:
        """Step a copy of the scene without its skins. Raises the errors of modules in a step.

        as_far_as_it_goes: end without an error if the hand reaches into the array, as a tracked hand may
        """
        self.refused = ""
        self.step_s = view.runtime.spec.timestep_s
        count = math.ceil(duration_s / self.step_s - ON_STEP) + 1 if view.moves else 1
        self.model: HapticModel = view.runtime.model
        self._rows: list[Frames] = []
        self._turns: dict[int, Float] = {}
        self._bones: list[list[tuple[Float, Float]]] = []
        self._outer: list[tuple[Transform, PhasedArray]] = []
        try:
            for _, runtime, posed in view.posed_at(self.step_s * np.arange(count)):
                self.model = runtime.model
                self._add(posed)
        except SceneError as error:
            if not as_far_as_it_goes or len(self._rows) < 2:
                raise
            count, self.refused = len(self._rows), str(error)
        self.end_s = (count - 1) * self.step_s

    @property
    def moves(self) -> bool:
        """Return whether any part may move."""
        return len(self._rows) > 1

    def frames(self, time_s: float) -> Frames:
        """Return the frames of stimuli and bodies at a time [s]."""
        row, share = self._place(time_s)
        before = self._rows[row]
        if share == 0.0:
            return before
        after = self._rows[row + 1]
        if row not in self._turns:
            self._turns[row] = turns_of(product(after.quaternions, inverse(before.quaternions)))
        quaternions = product(of_turns(share * self._turns[row]), before.quaternions)
        positions = (1.0 - share) * before.positions + share * after.positions
        return Frames(positions, matrices(quaternions), quaternions)

    def posed(self, time_s: float, frames: Frames | None = None) -> PosedScene:
        """Return the scene at a time [s], or with other frames. Obstacles are omitted: foci do not need them."""
        row, _ = self._place(time_s)
        positions, rotations, _ = self.frames(time_s) if frames is None else frames
        of_stimuli = len(self.model.stimuli)
        parts = [Transform(*pair) for pair in zip(positions, rotations, strict=True)]
        bodies = []
        for number, frame in enumerate(parts[of_stimuli:]):
            first = self.model.skins[self.model.first_skins[number]]
            bodies.append(PosedSurface(self.model.bodies[number], first, frame, self._bones[row][number]))
        skins = [PosedSkin(skin, bodies[skin.body], NO_OBSTACLES) for skin in self.model.skins]
        outer, arrays = self._outer[row]
        return PosedScene(outer, arrays, parts[:of_stimuli], bodies, skins)

    def _place(self, time_s: float) -> tuple[int, float]:
        """Return the index of the pose before a time [s], and the fraction of the interval to the next pose."""
        at = min(max(time_s / self.step_s, 0.0), float(len(self._rows) - 1))
        nearest = round(at)
        if abs(at - nearest) < ON_STEP:
            return nearest, 0.0
        return int(at), at - int(at)

    def _add(self, posed: PosedScene) -> None:
        parts = [*posed.frames, *(body.frame for body in posed.bodies)]
        positions, rotations = np.array([one.position for one in parts]), np.array([one.rotation for one in parts])
        self._rows.append(Frames(positions, rotations, np.array([quaternion(one) for one in rotations])))
        self._bones.append([(body.bone_positions, body.bone_rotations) for body in posed.bodies])
        self._outer.append((posed.array_frame, posed.arrays))
