"""Reduced models of a skin, in one world or several, on a device: a MuJoCo step is a few launches for a captured graph.

The pressure is already on the device. States equal those of the CPU stepper to rounding.

The states belong to the caller. Each step copies them to the device and back.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import warp as wp

from palmfield.device import SharedArray, launch, launching, matrix_product, replayed, whole_numbers
from palmfield.skin.stepper import Outside, Reader, SkinStepper, StepMemory, SurfaceLoads, check_step
from palmfield.threads import Calls
from palmfield.types import Float, Float32
from warp_kernels import skin_steps as kernels

LEAST_NUMBERS = 2**18
"""Size of the step matrix of a reduced model below which a product on the CPU takes no longer than a launch."""
MOST_NUMBERS = 2**23
"""Size of the same matrix above which single substeps need less memory and no more time."""
CHUNK = 32
"""Number of terms of a sum that one thread adds up."""
SECTIONS = 4
"""Number of sums of squares that measure the part of a load outside the class of modes."""


class DeviceModes:
    """DeviceModel of a ModalStepper."""

    def __init__(self, stepper: Any, substeps: int, device: str):
        self.stepper, self.substeps, self.weight_rows, self._device = stepper, substeps, substeps, device
        body, advance = stepper.body, stepper.advance
        fit, back = body.shapes.fit.T, body.shapes.shapes[:, body.shapes.points]
        residual = np.eye(len(fit)) - fit @ back
        parts = [fit @ body.forces, residual @ body.compliance, body.compliance, residual, np.eye(len(fit))]
        self._products = _Products(stepper.points, np.hstack(parts), device)
        starts = np.cumsum([part.shape[1] for part in parts])
        self._starts, self._rows = whole_numbers(starts, device), advance.shape[1]
        numbers, square = kernels.of_rows(self._rows)
        self._advance: Any = wp.array(advance[: stepper.order], dtype=square, device=device)
        self._inputs: Any = wp.array(stepper.inputs[: stepper.order], dtype=numbers, device=device)
        self._feedback: Any = wp.array(stepper.feedback, dtype=wp.float64, device=device)
        self._none: Any = wp.zeros((1, 1), dtype=wp.float64, device=device)
        self._coupling: Any = wp.array(stepper.coupling, dtype=wp.float64, device=device)

    def weights(self, first: Float, last: Float) -> Float:
        return self.stepper.mixed(SurfaceLoads(np.zeros(0), first, last)).astype(np.float64)

    def calls(self, memory: StepMemory) -> Calls:
        worlds = memory.before.shape[0]
        before, after = (part.reshape((worlds, self._rows, -1)) for part in (memory.before, memory.after))
        calls, forces = self._products.calls(memory)
        modes = kernels.lone_modes(self._rows)

        def carried(state: Any, first: int, last: int) -> Callable[[], object]:
            inputs = [self._advance, self._inputs, forces, first, last, state, after]
            return launch(modes, (worlds, self.stepper.order), inputs, self._device)

        if not self.stepper.coupled:
            calls.append(carried(before, 0, self.substeps))
        else:
            for substep in range(self.substeps):
                state = after if substep else before
                calls += [*self._pushes(state, forces, substep), carried(state, substep, substep + 1)]
        squares = launch(kernels.squares, memory.squares.shape, [forces, self._starts, memory.squares], self._device)
        return [*calls, squares]

    def _pushes(self, state: Any, forces: Any, substep: int) -> Calls:
        """Return the launches that add the coupling forces between modes to the forces of a substep."""
        worlds, count, (rows, columns) = len(state), len(self.stepper.feedback), self._coupling.shape
        chunks = -(-rows // CHUNK)
        mixed: Any = wp.zeros((worlds, rows), dtype=wp.float64, device=self._device)
        parts: Any = wp.zeros((worlds, chunks, columns), dtype=wp.float64, device=self._device)
        inputs = [self._coupling, mixed, self._none, CHUNK, parts]
        return [
            launch(kernels.mixed_rows, (worlds, count, columns), [self._feedback, state, mixed], self._device),
            launch(kernels.state_products, (worlds, chunks, columns), inputs, self._device),
            launch(kernels.add_chunks, (worlds, self.stepper.order), [parts, substep, forces], self._device),
        ]

    def outside(self, sums: Sequence[Any]) -> Outside:
        return self.stepper.weighed(sums)


def pays(size: int, shapes: int, substeps: int) -> bool:
    """Return whether a reduced model with these numbers of coordinates and force shapes is faster on a device."""
    return LEAST_NUMBERS <= size * (size + 2 * substeps * shapes) <= MOST_NUMBERS


class DeviceReduced:
    """DeviceModel of a ReducedStepper: all substeps are one matrix."""

    def __init__(self, stepper: Any, substeps: int, points: int, device: str):
        self.stepper: SkinStepper = stepper
        self.substeps, self.weight_rows, self._device = substeps, 2 * substeps, device
        own = np.arange(points) if stepper.points is None else stepper.points
        self._products = _Products(own, stepper.shares, device)
        onwards = stepper.advance.T
        at_start, at_end, power = [stepper.start], [stepper.end], onwards
        for _ in range(substeps - 1):
            at_start.append(at_start[-1] @ onwards)
            at_end.append(at_end[-1] @ onwards)
            power = power @ onwards
        matrix = np.concatenate([power, *at_start[::-1], *at_end[::-1]])
        self._matrix: Any = wp.array(matrix, dtype=wp.float64, device=device)

    def weights(self, first: Float, last: Float) -> Float:
        return np.concatenate([first, last])

    def calls(self, memory: StepMemory) -> Calls:
        calls, forces = self._products.calls(memory)
        rows, size = self._matrix.shape
        chunks = -(-rows // CHUNK)
        worlds = memory.before.shape[0]
        parts: Any = wp.zeros((worlds, chunks, size), dtype=wp.float64, device=self._device)
        inputs = [self._matrix, memory.before, forces.reshape((worlds, -1)), CHUNK, parts]
        calls.append(launch(kernels.state_products, parts.shape, inputs, self._device))
        return [*calls, launch(kernels.sums_of_chunks, (worlds, size), [parts, memory.after], self._device)]

    def outside(self, sums: Sequence[Any]) -> None:
        return None


class _Products:
    """Products of pressures at some points with a matrix (p, c), then mixed; points: their numbers, shape (p,)."""

    def __init__(self, points: Sequence[int] | Any, matrix: Float, device: str):
        self._device = device
        self._points = whole_numbers(points, device)
        self._matrix: Any = wp.array(np.ascontiguousarray(matrix, np.float32), dtype=wp.float32, device=device)

    def calls(self, memory: StepMemory) -> tuple[list[Callable[[], object]], Any]:
        """Return the launches and their output: products for each row of the weights, float64, shape (w, rows, c)."""
        points, columns = self._matrix.shape
        worlds, rows, patterns = memory.weights.shape
        blocks, chunks = -(-patterns // kernels.ROWS) * worlds, -(-points // CHUNK)
        parts: Any = wp.zeros((chunks, blocks * kernels.ROWS, columns), dtype=wp.float32, device=self._device)
        mixed: Any = wp.zeros((worlds, rows, columns), dtype=wp.float64, device=self._device)
        selected = whole_numbers(np.arange(points), self._device) if memory.chosen else self._points
        inputs = [memory.counts, memory.pressure, selected, self._matrix, CHUNK, parts]
        calls = [launch(kernels.pressure_products, (blocks, chunks, columns), inputs, self._device)]
        inputs = [memory.counts, memory.weights, parts, mixed]
        return [*calls, launch(kernels.mixed_products, mixed.shape, inputs, self._device)], mixed


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
