"""All data of a scene that change in a run, as plain arrays with a leading axis for worlds.

In a plain mj_step the arrays are views of MuJoCo's plugin state, so that mj_copyData, mj_getState and mj_resetData
treat them as their own. The array of a skin has room for its whole layer; a small model uses the front, because a run
may leave the small model. A solver with its own mesh has room for that mesh instead. A header identifies the writer of
the numbers; all zeros means rest without a writer.
"""

import hashlib
import json
from dataclasses import replace
from importlib.metadata import version

import numpy as np

from palmfield.errors import SceneError
from palmfield.simulation.model import HapticModel
from palmfield.skin.stepper import SkinStepper
from palmfield.types import Complex, Float

HEADER = 4
"""Numbers before the state itself: its writer (0 none, BEGUN, WHOLE), its fingerprint, and two more, of which the
first array uses LEVEL."""
LEVEL = slice(2, 4)
"""A complex number: how much of a unit drive all transducers emitted when a step of `SmoothSound` wrote the state."""
BEGUN, WHOLE = 1.0, 2.0
VERSION = 1
"""Version of the layout of these numbers."""


class HapticState:
    """arrays: of each array header and what its transducers emit, shape (w, HEADER + 2 n); skins: of each skin header
    and numbers, shape (w, HEADER + room). float64; w: worlds, 1 in a plain mj_step

    emitted: complex amplitude that each transducer emits, by array, shape (w, n), views
    """

    def __init__(self, arrays: tuple[Float, ...], skins: tuple[Float, ...]):
        self.arrays, self.skins = arrays, skins
        self.emitted: tuple[Complex, ...] = tuple(part[:, HEADER:].view(np.complex128) for part in arrays)

    def copy(self) -> "HapticState":
        """The same, in its own memory."""
        return HapticState(tuple(part.copy() for part in self.arrays), tuple(part.copy() for part in self.skins))

    def of(self, worlds: slice) -> "HapticState":
        """The part of some worlds, as views."""
        return HapticState(tuple(part[worlds] for part in self.arrays), tuple(part[worlds] for part in self.skins))

    def world(self, number: int) -> "HapticState":
        """The part of one world, as views."""
        return self.of(slice(number, number + 1))


def array_room(transducers: int) -> int:
    """Count of numbers in the state of an array."""
    return HEADER + 2 * transducers


def skin_room(model: HapticModel, skin: int) -> int:
    """Count of numbers in the state of a skin, available without its matrices."""
    return HEADER + model.skins[skin].state_room


def new_state(model: HapticModel, worlds: int = 1) -> HapticState:
    """Everything at rest."""
    arrays = tuple(np.zeros((worlds, array_room(len(part)))) for part in model.arrays.parts)
    return HapticState(arrays, tuple(np.zeros((worlds, skin_room(model, i))) for i in range(len(model.skins))))


def at_rest(state: HapticState, skin: int) -> bool:
    """Whether a skin has not been stepped since the start or a reset."""
    return bool(state.skins[skin][0, 0] == 0.0)


def untouched(state: HapticState) -> bool:
    """Whether no step has been taken from this state: it is that after a reset."""
    return not any(np.logical_or.reduce(part[0]) for part in state.arrays)


def check_arrays(model: HapticModel, state: HapticState) -> bool:
    """Mark the states of the arrays as those of this model; return whether they had no writer, so that a run begins.

    Raises SceneError for one that another scene or version wrote.
    """
    new = False
    for number, (array, part) in enumerate(zip(model.spec.arrays, state.arrays, strict=True)):
        mark = model.marks.get(("array", number, "pole")) or _mark(model, "array", number, "pole")
        if part[0, 0] == BEGUN and part[0, 1] == mark:
            continue
        if np.logical_or.reduce(part[0]):
            raise SceneError(_foreign(array.element))
        part[0, 0], part[0, 1] = BEGUN, mark
        new = True
    return new


def stepper_of(model: HapticModel, state: HapticState, skin: int) -> tuple[SkinStepper, Float]:
    """The stepper to which the state of a skin belongs, and its numbers, shape (1, state_size), a view.

    Raises SceneError for the state of another solver, basis or version.
    """
    part = state.skins[skin]
    kind = part[0, 0]
    stepper: SkinStepper = (model.whole if kind == WHOLE else model.begin)[skin].value
    if kind == 0.0:
        known = not np.logical_or.reduce(part[0])
    else:
        mark = model.marks.get(("skin", skin, stepper.name)) or _mark(model, "skin", skin, stepper.name)
        known = kind in (BEGUN, WHOLE) and part[0, 1] == mark
    if not known:
        raise SceneError(_foreign(model.skins[skin].spec.element))
    return stepper, part[:, HEADER : HEADER + stepper.state_size]


def claim(model: HapticModel, state: HapticState, skin: int, stepper: SkinStepper) -> None:
    """Write this stepper into the header of a skin as the owner of its numbers."""
    header = state.skins[skin][0]
    header[0] = BEGUN if model.begin[skin].value is stepper else WHOLE
    header[1] = model.marks.get(("skin", skin, stepper.name)) or _mark(model, "skin", skin, stepper.name)


def _mark(model: HapticModel, kind: str, number: int, name: str) -> float:
    """Number, exact in float64, that identifies states of this solver, on this scene, in this version."""
    if kind == "array":
        array = model.spec.arrays[number]
        parts = [array.config.model_dump_json(), len(model.arrays.parts[number])]
    else:
        skin = model.skins[number]
        stepper = (model.begin[number] if model.begin[number].value.name == name else model.whole[number]).value
        parts = [skin.spec.config.model_dump_json(), skin.layer.state_room, stepper.state_size, stepper.step_s]
        parts += [skin.spec.patch_centre, len(skin.nodes[0])]
        if not stepper.factorises:
            # A small model's numbers belong to its basis, which comes from all that the scene is going to do.
            parts.append(repr(replace(model.spec, device="", duration_s=0.0)))
    digest = hashlib.sha256(json.dumps([VERSION, version("palmfield"), kind, name, *parts]).encode()).digest()
    mark = float(int.from_bytes(digest[:6], "big") + 1)
    model.marks[kind, number, name] = mark
    return mark


def _foreign(element: str) -> str:
    return (
        f"{element}: the state in mjData comes from another solver, basis, scene or version of palmfield; start "
        "from mj_resetData, or use the scene that wrote it"
    )
