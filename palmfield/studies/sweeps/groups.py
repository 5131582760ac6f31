"""Group the points of a sweep into worlds of one model, and choose the loads for which their layers are built.

Both choices depend only on the design, not on the remaining points or the workers. So an interrupted sweep continues
with the same numbers.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palmfield.config import DriverConfig
from palmfield.drive.boards import BOARDS
from palmfield.errors import PalmfieldError, SceneError
from palmfield.session.preview import Preview, preview
from palmfield.session.worlds import WorldKeys, stimulus_texts, world_specs
from palmfield.simulation.build import demands_of, stimuli_of
from palmfield.simulation.build_worlds import Shared, strictest
from palmfield.simulation.model import SkinModel
from palmfield.simulation.small_models import mode_estimate
from palmfield.skin.costs import modal_step_s, modes_s
from palmfield.skin.reduction.modal_stepper import MOST_SHARE
from palmfield.skin.scene_layer import LayerDemand
from palmfield.studies.sweeps.design import Design, Value
from palmfield.studies.sweeps.keys import SceneKeys

MANY_LOADS = 20
"""Number of different loads on a skin from which modes for every load are considered.

On a palm, modes take about 80 s of one core to build; a reduced model for one load takes 5 s.
"""
LOOKED_AT = 2000
"""Largest number of points of a group that are examined for their requirements on the layer."""
LEVEL = ("drive_amplitude", "arp_peak_Pa")
"""Keys of a stimulus that change only the level of its load."""

Keys = Mapping[str, Value | None]


@dataclass(frozen=True)
class Group:
    """Points that may be worlds of one model.

    points: their numbers in the design
    base: keys with which the MuJoCo model is built
    shared: layers and solvers that the group shares; None for a point that is simulated separately
    modes_bytes: approximate memory to make the modes
    """

    points: tuple[int, ...]
    base: Keys
    shared: Shared | None
    modes_bytes: int = 0


def groups_of(scene: Path, design: Design, keys: SceneKeys, device: str | None, accuracy: float | None) -> list[Group]:
    """Split a design into groups, in the order of their first points.

    Points that differ only in their stimuli form one group if they have at least MANY_LOADS different loads and modes
    can compute all of them. The layer is then that of the point with the strictest requirements. Otherwise the loads of
    a group differ only in level.
    """
    by_model: dict[object, dict[int, dict[str, Value]]] = defaultdict(dict)
    for number in range(design.count):
        point = design.point(number)
        by_model[keys.of_model(point)][number] = point
    result = []
    for points in by_model.values():
        own = {number: keys.of_point(point) for number, point in points.items()}
        by_load: dict[object, list[int]] = defaultdict(list)
        exact = _plays_any_level(keys, own)
        for number, point in points.items():
            differing = keys.differing(point)
            levels = {full: differing.pop(full) for full in list(differing) if full.rpartition(".")[2] in LEVEL}
            # Keys that set the level; their values change the load shape only on boards that round levels
            kind = tuple(levels if exact else levels.items())
            by_load[tuple(differing.items()), kind].append(number)
        several = _many_loads(scene, points, own, keys, device, accuracy) if len(by_load) >= MANY_LOADS else None
        if several is not None:
            result.append(several)
            continue
        for members in by_load.values():
            loudest = max(members, key=lambda number: _level(own[number]))
            result.append(Group(tuple(members), own[loudest], Shared() if len(members) > 1 else None))
    return sorted(result, key=lambda group: group.points[0])


def _level(keys: Keys) -> float:
    """Return the sum of the levels that a point sets. It is used to find a point with sound."""
    values = [value for full, value in keys.items() if full.rpartition(".")[2] in LEVEL]
    return sum(value for value in values if isinstance(value, int | float))


def _plays_any_level(keys: SceneKeys, own: Mapping[int, Keys]) -> bool:
    """Return whether the board does not round levels. Only then do points with other levels differ only in level."""
    (first, *_) = own.values()
    boards = [
        str(first.get(f"{instance.name}.board", instance.keys.get("board")))
        for instance in keys.instances
        if instance.plugin == DriverConfig.plugin
    ]
    return all(name in BOARDS and BOARDS[name].exact for name in boards)


def _many_loads(
    scene: Path,
    points: Mapping[int, Mapping[str, Value]],
    own: Mapping[int, Keys],
    keys: SceneKeys,
    device: str | None,
    accuracy: float | None,
) -> Group | None:
    """Return the points as one group whose skins use modes for every load; None if that is not possible."""
    numbers = list(own)
    for number in (numbers[0], numbers[-1]):
        try:
            base, view = own[number], preview(scene, device=device, accuracy=accuracy, keys=own[number])
            break
        except SceneError:
            continue
    else:
        return None
    for skin in view.runtime.model.skins:
        if skin.spec.config.solver != "auto" or mode_estimate.refusal(skin.spec, skin.layer) is not None:
            return None
    demands = [_demands(view, keys.differing(points[number])) for number in _looked_at(points)]
    present = [demand for demand in demands if demand is not None]
    if not present:
        return None
    strictest_demands = tuple(strictest(of_skin) for of_skin in zip(*present, strict=True))
    if not all(_pays(skin, len(points), view.duration_s) for skin in view.runtime.model.skins):
        return None
    skins = view.runtime.model.skins
    # Vectors and their products, both in double precision
    size = sum(16 * skin.layer.dofs * mode_estimate.expected_modes(skin.spec, skin.layer) for skin in skins)
    return Group(tuple(own), base, Shared(strictest_demands, modal=True), round(size))


def _pays(skin: SkinModel, points: int, duration_s: float) -> bool:
    """Return whether modes for every load are predicted to take less time than a stepper for each point."""
    modes, dofs = mode_estimate.expected_modes(skin.spec, skin.layer), skin.layer.dofs
    steps = duration_s / skin.layer.sizes.step_s
    if modes > MOST_SHARE * dofs:
        return False
    laws = mode_estimate.laws(skin.layer)
    return modes_s(dofs, modes, laws) + points * steps * modal_step_s(modes, laws) < points * skin.choice.seconds


def _looked_at(points: Mapping[int, Mapping[str, Value]]) -> list[int]:
    """Return points that represent the requirements of all: either all points, or extreme ones and some between."""
    numbers = list(points)
    if len(numbers) <= LOOKED_AT:
        return numbers
    chosen = {numbers[place] for place in np.linspace(0, len(numbers) - 1, LOOKED_AT).astype(int).tolist()}
    for key in points[numbers[0]]:
        if all(isinstance(points[number][key], int | float) for number in numbers):
            chosen |= {pick(numbers, key=lambda number: points[number][key]) for pick in (min, max)}  # type: ignore
    return sorted(chosen)


def _demands(view: Preview, differing: Keys) -> list[LayerDemand] | None:
    """Return the requirements of a point on the layer of each skin. None for silence and for invalid keys."""
    model = view.runtime.model
    by_instance: dict[str, dict[str, tuple[object, ...]]] = defaultdict(dict)
    for full, value in differing.items():
        instance, _, key = full.rpartition(".")
        by_instance[instance][key] = (value,)
    carriers = [model.bodies[skin.body] for skin in model.skins]
    try:
        (spec,) = world_specs(view.runtime.spec, stimulus_texts(view.runtime), WorldKeys({}, by_instance), 1)
        stimuli = stimuli_of(spec, model.arrays, model.board, carriers)
        if all(stimulus.silent for stimulus in stimuli):
            return None
        return demands_of(spec, stimuli, model.arrays, model.board, carriers)
    except PalmfieldError:
        return None


def in_words(groups: Sequence[Group]) -> str:
    """Describe, in a sentence, which points share modes; "" if no points share them."""
    many = [group for group in groups if group.shared is not None and group.shared.modal]
    if not many:
        return ""
    count = sum(len(group.points) for group in many)
    layers = "one layer" if len(many) == 1 else f"{len(many)} layers, each"
    return (
        f"{count} points share modes for every load, on {layers} built for the most demanding point: smallest "
        "focus, highest frequency, longest path"
    )
