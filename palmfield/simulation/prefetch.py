"""Loads that are known ahead while nothing moves: the field of many coming drives costs little more than a few.

A path needs a new field at every substep. What will be emitted is known, and on points that keep still the fields of
many drives are one matrix product: see `palmfield.acoustics.transfer`.
"""

import math
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from palmfield.acoustics.transfer import MATRIX_FROM
from palmfield.simulation.emission import Emission
from palmfield.simulation.model import HapticModel
from palmfield.simulation.path_sound import PathSound
from palmfield.simulation.posed_scene import PosedScene, PosedSkin
from palmfield.simulation.radiation import Radiation, Role
from palmfield.types import Complex, Float32

AHEAD = 128
"""Substeps that are looked ahead; a move throws away what was computed for them."""
SAME_DRIVE = 1e-9
"""Of full drive: MuJoCo adds up its time, so that what comes differs from what was predicted in the last digits."""
MOST_OFF_PATH = 8
"""Loads one after another off a path, as while transducers ring up, until the path is given up."""
ALWAYS = np.ones(1, dtype=bool)


class LoadPrefetch:
    """ARP for coming drives at the quadrature points of each skin. Belongs to one state."""

    def __init__(self, model: HapticModel, emission: Emission, radiation: Radiation, path_sound: PathSound):
        """path_sound: what it gives is not computed ahead"""
        self.model, self.emission, self.radiation, self.path_sound = model, emission, radiation, path_sound
        self._posed: PosedScene | None = None
        self._until = -math.inf
        self._drives: Complex = np.zeros((0, len(model.arrays)), np.complex128)
        self._loads: dict[tuple[int, Role], tuple[PosedSkin, Float32]] = {}
        self._row = 0
        self._off_path = 0  # loads one after another that lay off a path that is known ahead

    def forget(self) -> None:
        """Begin again, as at the start of a run: whether a scene has kept still is asked of steps of one run."""
        self._posed, self._until, self._drives = None, -math.inf, self._drives[:0]
        self._loads.clear()
        self._off_path = 0

    def adopt(self, other: "LoadPrefetch") -> None:
        """Go on from another's predictions, in a copy of its state in the same PosedScene."""
        self._posed, self._until, self._drives, self._row = other._posed, other._until, other._drives, other._row
        self._loads, self._off_path = dict(other._loads), other._off_path

    def predict_drives(self, posed: PosedScene, emitted: Complex, t0: float) -> None:
        """Predict what will be emitted from t0 [s] on, where the scene has kept still since the last step.

        emitted: at t0, shape (N,)
        """
        last, self._posed = self._posed, posed
        still = last is posed or (last is not None and last.arrays is posed.arrays and last.skins == posed.skins)
        if not still:
            self._until, self._drives = -math.inf, self._drives[:0]
            self._loads.clear()
            return
        if t0 < self._until or not self._worthwhile or self._is_on_path(posed):
            return
        count = max(AHEAD // self.model.substeps, 1) * self.model.substeps
        _, course = self.emission.over(posed, emitted, t0, count)
        self._until = t0 + (count - 0.5) * self.model.step_s
        self._loads.clear()
        drives = self._drives[:0] if course.emitted is None else course.emitted
        # A focus that rests at a few points is a few drives: each of them costs less by itself.
        worthwhile = len(drives) >= MATRIX_FROM and np.add.reduce(_changes(drives)) + 1 >= MATRIX_FROM
        self._drives = drives if worthwhile else drives[:0]
        self._row = -self.model.substeps

    def _is_on_path(self, posed: PosedScene) -> bool:
        path = self.path_sound
        return path.serves and self._off_path < MOST_OFF_PATH and path.holds(posed)

    def pressures(self, posed: PosedScene, skin: int, drives: Complex, role: Role = "quadrature") -> Float32:
        """ARP [Pa] at a skin's quadrature points, or those of its load, for drives (m, N), shape (m, q)."""
        if self.path_sound.serves:
            on_path = self.path_sound.arp(posed, skin, role, drives)
            self._off_path = 0 if on_path is not None else self._off_path + 1
            if on_path is not None:
                return on_path
        rows = self._predicted_rows(drives) if len(self._drives) >= len(drives) else None
        if rows is None:
            changes = _changes(drives)
            if np.logical_and.reduce(changes):
                return self.radiation.many(posed, skin, drives, role)
            # What sounds on unchanged is computed once.
            first = np.concatenate((ALWAYS, changes))
            computed = self.radiation.many(posed, skin, drives[first], role)
            return np.asarray(computed[np.add.accumulate(first, dtype=np.intp) - 1])
        known = self._loads.get((skin, role))
        if known is None or known[0] is not posed.skins[skin]:
            loads = self.radiation.many(posed, skin, self._drives, role)
            known = self._loads[skin, role] = posed.skins[skin], loads
        return known[1][rows]

    @cached_property
    def _worthwhile(self) -> bool:
        """Whether the coming drives differ, and a transfer matrix gives their load."""
        model = self.model
        changing = any(part.config.path != "point" or part.response.delayed for part in model.stimuli)
        free = all(skin.spec.config.body_sound == "none" for skin in model.skins)
        alike = len(model.arrays.groups) == 1 and model.arrays.wall_m is None
        matrix = alike and model.arrays.precision == "fast"
        return changing and free and matrix

    def _predicted_rows(self, drives: Complex) -> slice | None:
        """Which of the predicted drives these are; None where they were not predicted."""
        # As a rule it is the step after the last one, or this step for another skin
        for first in (self._row + self.model.substeps, self._row):
            if (
                0 <= first < len(self._drives)
                and np.maximum.reduce(np.abs(self._drives[first] - drives[0])) < SAME_DRIVE
            ):
                break
        else:
            first = int(np.maximum.reduce(np.abs(self._drives - drives[0]), axis=1).argmin())
        rows = slice(first, first + len(drives))
        there = self._drives[rows]
        if len(there) < len(drives) or np.maximum.reduce(np.abs(there - drives), axis=None) >= SAME_DRIVE:
            return None
        self._row = first
        return rows


def _changes(drives: Complex) -> NDArray[np.bool_]:
    """Whether each of some drives (m, N), m >= 1, but the first differs from the one before it, shape (m - 1,)."""
    return np.asarray(np.logical_or.reduce(drives[1:] != drives[:-1], axis=1))
