"""Data of a scene that change in a run, as plain arrays with a leading axis for worlds.

In a plain mj_step the arrays are views of MuJoCo's plugin state, so mj_copyData, mj_getState and mj_resetData include
them. The array of a skin has room for its full layer, because a run may change to the full layer. A reduced model uses
only its first part. For a solver with its own mesh, the array has room for that mesh. A header identifies the writer of
the numbers. If all numbers are zero, the skin is at rest and has no writer.
"""

import hashlib
import json
from dataclasses import replace
from importlib.metadata import version

import numpy as np

from palmfield.errors import SceneError
from palmfield.simulation.cached import Rows
from palmfield.simulation.model import HapticModel
from palmfield.skin.stepper import SkinStepper
from palmfield.types import Complex, Float

HEADER = 4
"""Length of the header: writer (0 none, BEGUN, WHOLE), fingerprint, two more numbers (LEVEL in the first array)."""
LEVEL = slice(2, 4)
"""Position of a complex number: the emitted level of the unit drive, if a step of `SmoothSound` wrote the state."""
BEGUN, WHOLE = 1.0, 2.0
VERSION = 1
"""Version of the layout of these arrays."""


class HapticState:
    """State of a scene. arrays: for each array header and emission of its transducers, (w, HEADER + 2 n); skins: for
    each skin header and numbers, shape (w, HEADER + room); regions: for each region of afferents that sensors read,
    shape (w, size). float64; w: worlds, 1 in a plain mj_step

    arrays: for each array header and emission, (w, HEADER + 2 n); skins: for each header and numbers, (w, HEADER +
        room)
    emitted: complex amplitude that each transducer emits, by array, shape (w, n), views
    """

    def __init__(self, arrays: tuple[Float, ...], skins: tuple[Float, ...], regions: tuple[Float, ...]):
        self.arrays, self.skins, self.regions = self._parts = arrays, skins, regions
        self.emitted: tuple[Complex, ...] = tuple(part[:, HEADER:].view(np.complex128) for part in arrays)

    def emission(self, worlds: Rows | slice = slice(None)) -> Complex:
        """Return a copy of the emission of all transducers in some worlds, shape (g, N)."""
        first, *others = self.emitted
        return np.concatenate([part[worlds] for part in self.emitted], axis=1) if others else np.array(first[worlds])

    def set_emission(self, worlds: Rows | slice, emission: Complex) -> None:
        """Set the emission of all transducers in some worlds, shape (g, N)."""
        start = 0
        for part in self.emitted:
            part[worlds] = emission[:, start : start + part.shape[1]]
            start += part.shape[1]

    def copy(self) -> "HapticState":
        """Return a copy with its own memory."""
        return HapticState(*(tuple(map(np.copy, parts)) for parts in self._parts))

    def of(self, worlds: slice) -> "HapticState":
        """Return the state of some worlds, as views."""
        return HapticState(*(tuple(part[worlds] for part in parts) for parts in self._parts))

    def world(self, number: int) -> "HapticState":
        """Return the state of one world, as views."""
        return self.of(slice(number, number + 1))


def array_room(transducers: int) -> int:
    """Return the length of the state of an array."""
    return HEADER + 2 * transducers


def skin_room(model: HapticModel, skin: int) -> int:
    """Return the length of the state of a skin. This needs no matrices."""
    return HEADER + model.skins[skin].solver.state_size


def new_state(model: HapticModel, worlds: int = 1) -> HapticState:
    """Return a new state in which everything is at rest."""
    arrays = tuple(np.zeros((worlds, array_room(len(part)))) for part in model.arrays.parts)
    skins = tuple(np.zeros((worlds, skin_room(model, i))) for i in range(len(model.skins)))
    return HapticState(arrays, skins, tuple(np.zeros((worlds, region.size)) for region in model.rates))


def at_rest(state: HapticState, skin: int) -> bool:
    """Return whether a skin has not been stepped since the start or a reset."""
    return bool(state.skins[skin][0, 0] == 0.0)


def untouched(state: HapticState) -> bool:
    """Return whether the state is that after a reset, before the first step."""
    return not any(np.logical_or.reduce(part[0]) for part in state.arrays)


def check_arrays(model: HapticModel, state: HapticState) -> bool:
    """Mark the states of the arrays as those of this model. Return whether they had no writer, as in a new run.

    Raises SceneError for a state that another scene or version has written.
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
    """Return the stepper that wrote the state of a skin, and its numbers, shape (1, state_size), a view.

    Raises SceneError for the state of another solver, basis or version.
    """
    part = state.skins[skin]
    kind = part[0, 0]
    stepper: SkinStepper = (model.whole if kind == WHOLE else model.begin)[skin].value
    if kind == 0.0:
        valid = not np.logical_or.reduce(part[0])
    else:
        mark = model.marks.get(("skin", skin, stepper.name)) or _mark(model, "skin", skin, stepper.name)
        valid = kind in (BEGUN, WHOLE) and part[0, 1] == mark
    if not valid:
        raise SceneError(_foreign(model.skins[skin].spec.element))
    return stepper, part[:, HEADER : HEADER + stepper.state_size]


def claim(model: HapticModel, state: HapticState, skin: int, stepper: SkinStepper, of_any_owner: bool = False) -> None:
    """Write this stepper into the header of a skin as the owner of its numbers. Raises SceneError like `stepper_of`.

    of_any_owner: whether to accept numbers of any owner; they must be valid for the stepper
    """
    mark = model.marks.get(("skin", skin, stepper.name)) or _mark(model, "skin", skin, stepper.name)
    kind, header = BEGUN if model.begin[skin].value is stepper else WHOLE, state.skins[skin][0]
    if header[0] != kind or header[1] != mark:
        if not of_any_owner:
            stepper_of(model, state, skin)
        header[0], header[1] = kind, mark


def _mark(model: HapticModel, kind: str, number: int, name: str) -> float:
    """Return a number, exact in float64, that identifies states of this solver, scene and version."""
    if kind == "array":
        array = model.spec.arrays[number]
        parts = [array.config.model_dump_json(), len(model.arrays.parts[number])]
    else:
        skin = model.skins[number]
        stepper = (model.begin[number] if model.begin[number].value.name == name else model.whole[number]).value
        parts = [skin.spec.config.model_dump_json(), skin.layer.state_room, stepper.state_size, stepper.step_s]
        parts += [skin.spec.patch_centre, len(skin.nodes[0])]
        if not stepper.factorises:
            # The state of a reduced model belongs to its basis, which depends on the whole planned run of the scene.
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
