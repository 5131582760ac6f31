"""Modes of a skin in several worlds on a device: all substeps of all worlds as a few launches in one captured graph.

The states belong to the caller. Each step copies them to the device and back.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import warp as wp

from palmfield.device import SharedArray, launch, launching, matrix_product, replayed
from palmfield.skin.stepper import Reader, SurfaceLoads, check_step
from palmfield.types import Float, Float32
from warp_kernels import skin_steps as kernels


class _Work(NamedTuple):
    """Memory and graph of steps with the same number of substeps and the same reader.

    mixed: weights of the patterns in substeps, (w, s); motion: readings, (w, s, 2, m), or None; replay: runs a step"""

    mixed: SharedArray
    motion: SharedArray | None
    replay: Callable[[], object]


class DeviceWorlds:
    """Steps of a ModalStepper with uncoupled modes, in several worlds, under one pattern of pressure per world.

    stepper: owner of the states; most: largest number of worlds; device: from `palmfield.device.resolve`
    """

    def __init__(self, stepper: Any, most: int, device: str):
        self.stepper, self.most, self._device = stepper, most, device
        rows, padded = stepper.state_rows, stepper.padded
        numbers, square = kernels.of_rows(rows)
        self._advance: Any = wp.array(stepper.advance, dtype=square, device=device)
        self._inputs: Any = wp.array(stepper.inputs, dtype=numbers, device=device)
        self._pushes = SharedArray((most, padded), wp.float32, device)
        self._pushed: Float32 | None = None
        self._states = SharedArray((most, rows, padded), wp.float64, device)
        self._works: dict[tuple[int, Reader | None], _Work] = {}

    def step(
        self, state: Float, loads: SurfaceLoads, t0: float, t1: float, observe: Reader | None = None
    ) -> Float32 | None:
        """See SkinStepper. The returned motion is a view that the next step overwrites."""
        stepper = self.stepper
        check_step(stepper, state, loads, len(stepper.points), t0, t1)
        worlds, substeps, _ = loads.first.shape
        work = self._works.get((substeps, observe)) or self._work(substeps, observe)
        pushes = stepper.pushes(loads)
        states = self._states.host[:worlds].reshape(state.shape)
        states[...] = state
        work.mixed.host[:worlds] = stepper.mixed(loads)[..., 0]
        with launching:
            if pushes is not self._pushed:
                self._pushes.host[:worlds] = pushes[:, 0]
                self._pushes.upload()
                self._pushed = pushes if loads.fixed else None
            work.replay()
        if self._device != "cpu":
            wp.synchronize_stream(self._device)
        state[...] = states
        return None if work.motion is None else work.motion.host[:worlds]

    def _work(self, substeps: int, observe: Reader | None) -> "_Work":
        """Make and store the memory and graph for this number of substeps and this reader; return them."""
        stepper, device = self.stepper, self._device
        rows, padded = stepper.state_rows, stepper.padded
        mixed = SharedArray((self.most, substeps), wp.float32, device)
        count = 0 if observe is None else self.most * substeps * 2
        seen: Any = wp.zeros((count, padded), dtype=wp.float32, device=device)
        inputs = [self._advance, self._inputs, self._pushes.array, mixed.array, self._states.array, seen]
        calls: list[Callable[[], object]] = [self._states.upload, mixed.upload]
        calls.append(launch(kernels.modes_of_worlds(rows), (self.most, padded), inputs, device))
        motion = None
        if observe is not None:
            motion = SharedArray((self.most, substeps, 2, observe.count), wp.float32, device)
            matrix: Any = wp.array(observe.single, dtype=wp.float32, device=device)
            flat = motion.array.reshape((count, observe.count))
            calls += [matrix_product(seen, matrix, flat, device), motion.download]
        work = _Work(mixed, motion, replayed([*calls, self._states.download], device))
        self._works[substeps, observe] = work
        return work
