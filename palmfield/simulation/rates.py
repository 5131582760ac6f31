"""Rates of spikes of the afferents in a region of a skin, for sensors of MuJoCo."""

from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np
from scipy import sparse

from palmfield.errors import SceneError
from palmfield.hand.posed_surface import SkinBinding
from palmfield.perception.afferents import AFFERENTS, AfferentSteps
from palmfield.simulation.cached import Rows
from palmfield.simulation.innervation import Innervation, endings_of
from palmfield.simulation.spec import RegionSpec
from palmfield.skin.scene_layer import SceneLayer
from palmfield.types import Float, Float32, Int

CHANNELS = tuple(f"rate_{name}_Hz" for name in AFFERENTS)
"""Channels of a sensor: spikes of the class in the region, per unit and second."""


Bind: TypeAlias = Callable[[Float], SkinBinding | None]


class RegionRates:
    """Rates in one region.

    count: number of its units. size: length of its state: spikes by class and MuJoCo step in the window, then the
        states of the units by class
    """

    def __init__(self, spec: RegionSpec, layer: SceneLayer, bind: Bind, step_s: float, timestep_s: float):
        """bind: returns the bones that carry points of the resting skin. step_s, timestep_s: of skin and MuJoCo [s].

        Raises SceneError for a region without afferents.
        """
        self.spec, endings = spec, endings_of(layer)
        self._numbers = _units_in(spec, endings.positions, bind)
        self._operator: sparse.csr_matrix | None = None
        self.count = len(self._numbers)
        names = endings.names[self._numbers]
        self._classes = [np.flatnonzero(names == name) for name in AFFERENTS]
        self._steps = [AfferentSteps(afferent, step_s) for afferent in AFFERENTS.values()]
        window = max(1, round(spec.config.window_s / timestep_s))
        self._counted = len(CHANNELS), window
        units = np.array([len(own) for own in self._classes])
        self._per_spike = 1.0 / (np.maximum(units, 1) * window * timestep_s)
        sizes = [len(CHANNELS) * window, *(one.size * n for one, n in zip(self._steps, units.tolist(), strict=True))]
        self._ends, self.size = np.cumsum(sizes)[:-1], sum(sizes)

    def operator(self, of_all: sparse.csr_matrix) -> sparse.csr_matrix:
        """Return the rows of its units of an operator to the motion of all afferents of the skin, stored."""
        if self._operator is None:
            self._operator = of_all[self._numbers]
        return self._operator

    def advance(self, part: Float, worlds: Rows, motion: Float | Float32) -> None:
        """Advance the state of some worlds by one MuJoCo step, in place.

        part: state in all worlds, shape (worlds, size); motion: at the units after each substep, shape (w, s, count)
        """
        # Single precision, as in a record
        moved, count = motion.astype(np.float32).swapaxes(0, 1).astype(np.float64), len(worlds)
        counted, *states = np.split(part[worlds], self._ends, axis=1)
        counted = counted.reshape(count, *self._counted)
        counted[..., :-1] = counted[..., 1:]
        for number, (own, step) in enumerate(zip(self._classes, self._steps, strict=True)):
            units = states[number].reshape(count, step.size, len(own)).swapaxes(0, 1).reshape(step.size, -1)
            spikes = step.counts(units, moved[:, :, own].reshape(len(moved), -1))
            counted[:, number, -1] = spikes.reshape(count, -1).sum(axis=1)
            states[number] = units.reshape(step.size, count, -1).swapaxes(0, 1).reshape(count, -1)
        part[worlds] = np.concatenate([counted.reshape(count, -1), *states], axis=1)

    def read(self, part: Float) -> Float:
        """Return the data of a sensor [1/s], shape (worlds, channels); part: state in all worlds."""
        counted = part[:, : self._ends[0]].reshape(-1, *self._counted)
        rates: Float = counted.sum(axis=2) * self._per_spike
        return rates


def watched(
    rates: Sequence[RegionRates], units: Sequence[Innervation | None], operators: Sequence[sparse.csr_matrix]
) -> tuple[sparse.csr_matrix | None, ...]:
    """Return for each skin one operator to watch: its own of `operators`, which may be empty, then those of its
    regions. units: afferents of each skin."""
    result = list[sparse.csr_matrix | None]()
    for number, innervation in enumerate(units):
        own = [*operators[number : number + 1]]
        if innervation is not None:
            own += [one.operator(innervation.operator) for one in rates if one.spec.skin == number]
        result.append(sparse.csr_matrix(sparse.vstack(own)) if len(own) > 1 else next(iter(own), None))
    return tuple(result)


def _units_in(spec: RegionSpec, positions: Float, bind: Bind) -> Int:
    """Return the numbers of the afferents in a region, shape (n,). Raises SceneError if there are none."""
    inside = np.ones(len(positions), dtype=bool)
    if spec.bone is not None:
        binding = bind(positions)
        assert binding is not None
        inside &= binding.weights.argmax(axis=0) == spec.bone
    if spec.centre is not None:
        inside &= np.linalg.norm(positions - spec.centre, axis=1) <= spec.radius_m
    if not inside.any():
        raise SceneError(
            f"{spec.element}: its region has none of the {len(positions)} afferents of its skin: choose another body, "
            "or a larger site"
        )
    return np.flatnonzero(inside).astype(np.int32)
