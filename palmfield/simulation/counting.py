"""Advance the afferents whose rates sensors read; only few scenes have them."""

from collections.abc import Callable, Sequence

from palmfield.simulation.backend import Observer, StepTrace
from palmfield.simulation.cached import Rows
from palmfield.simulation.model import HapticModel
from palmfield.simulation.state import HapticState
from palmfield.simulation.workspace import Workspace
from palmfield.skin.stepper import SkinStepper


def counting(
    model: HapticModel,
    works: Sequence[Workspace],
    state: HapticState,
    steppers: Callable[[int, Rows], Sequence[tuple[SkinStepper, Rows]]],
    observer: Observer | None,
) -> Observer:
    """Return an observer that advances the afferents by each step, and then calls another observer.

    steppers: returns the steppers of a skin in some worlds
    """

    def count(trace: StepTrace) -> None:
        for skin, parts in enumerate(trace.motion):
            own = [number for number, rates in enumerate(model.rates) if rates.spec.skin == skin]
            for worlds, watched in parts if own else ():
                [(stepper, _)], values = steppers(skin, worlds), watched[:, :, 0]
                matrix = works[worlds[0]].coordinates(skin, stepper)
                end = values.shape[-1] if matrix is None else matrix.shape[1]
                for number in reversed(own):
                    begin = end - model.rates[number].count
                    moved = values[..., begin:end] if matrix is None else values @ matrix[:, begin:end]
                    model.rates[number].advance(state.regions[number], worlds, moved)
                    end = begin
        if observer is not None:
            observer(trace)

    return count
