"""Steps of the explicit scheme; its energy never grows without a load."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from palmfield.device import gather, run_kernel, scatter
from palmfield.errors import SceneError
from palmfield.skin.materials.material import Material, Relaxation
from palmfield.skin.solvers.spectral_elements.model import Holds, Layout, Model
from palmfield.skin.solvers.spectral_elements.places import Table
from palmfield.skin.solvers.spectral_elements.solid import Solid, face_areas
from palmfield.types import Float, Int
from warp_kernels import hexa, hexa_steps

GRAPH_STEPS = 200
"""Number of steps in one CUDA graph."""


@dataclass(frozen=True)
class Points:
    """Points of the face: nodes of the cell of each point and their shares, both (p, n^2)."""

    nodes: Int
    shares: Float


def branch_step(step_s: float, time_s: float) -> tuple[float, float]:
    """Return (e, c h) of y <- e y + c h v, exact for v constant over the step: c = (1 - e) tau / h."""
    if time_s == 0.0:
        return 0.0, 0.0
    return math.exp(-step_s / time_s), -math.expm1(-step_s / time_s) * time_s


def lane_rows(elements: Int, layout: Layout, lanes: int) -> tuple[Int, Int]:
    """Return the first row of the nodes of each thread, (threads + 1,), and flat rows with one position for each lane.

    Lanes with fewer elements than the others point to a position in the padding, where the force is 0.
    """
    flat = elements.ravel()
    order = np.argsort(flat, kind="stable")
    nodes = flat[order]
    count = int(nodes[-1]) + 1
    threads = -(-count // lanes)
    uses = np.bincount(nodes, minlength=threads * lanes)
    rank = np.arange(len(nodes)) - (np.cumsum(uses) - uses)[nodes]
    starts = np.concatenate([[0], np.cumsum(uses.reshape(threads, lanes).max(axis=1))])
    sources = np.full(starts[-1] * lanes, layout.spare, dtype=np.int64)
    sources[(starts[nodes // lanes] + rank) * lanes + nodes % lanes] = layout.at.ravel()[order]
    return starts, sources


def copies_of(solid: Solid, materials: list[Material]) -> tuple[list[Relaxation], Int, Int]:
    """Return the copies of nodes: one for each relaxation law of the elements of a node; copies of a node are adjacent.

    Returns the laws, node * laws + law of each copy, ascending, and the copies of each element.
    """
    laws = sorted({material.relaxation for material in materials})
    law_of_sheet = np.array([laws.index(material.relaxation) for material in materials], dtype=np.int32)
    if len(laws) == 1:
        return laws, np.arange(len(solid.nodes), dtype=np.int32), solid.elements
    pairs = solid.elements.astype(np.int64) * len(laws) + law_of_sheet[solid.sheet][:, None]
    keys, result = np.unique(pairs, return_inverse=True)
    return laws, keys, result.reshape(pairs.shape)


def state_size(solid: Solid, materials: list[Material]) -> int:
    """Return the size of the state of a body, see `Stepper.numbers`."""
    laws, keys, _ = copies_of(solid, materials)
    rows = 1 + max(len(branches) for branches, _ in laws)
    return 3 * (2 * len(solid.nodes) + rows * len(keys))


class Stepper:
    """Step by central differences with exact branches; the dashpot uses the velocity of the previous half step.

    With K the elastic and K_d the relaxed deviatoric stiffness, M v' + K u + K_d (sum g y + t v(-1/2)) = f and
    y <- e y + c h v, the energy

        E = v (M - h t K_d / 2) v / 2 + u0 K u1 / 2 + sum g / (2 c) [y0 K_d y1 + (1 - e) / 2 y0 K_d y0]

    of a step from 0 to 1 changes without a load by -h t s K_d s / 4 - sum g (1 - e) / (4 c) z K_d z, where s and z are
    sums of two neighbouring v and y. So it never grows. It is positive definite if M - h^2 / 4 [K + sum g tanh(x / 2) /
    (x / 2) K_d] - h t K_d / 2 with x = h / tau is positive definite. This gives the stable step.

    step_s: [s]. table: load at each step. points: output points. graph_steps: number of steps in one CUDA graph.
    target: numbers of steps after which the points are read, ascending.
    """

    def __init__(
        self,
        model: Model,
        holds: Holds,
        step_s: float,
        table: Table,
        points: Points,
        target: Int,
        stable_s: float,
        graph_steps: int = GRAPH_STEPS,
    ) -> None:
        if not 0.0 < step_s <= stable_s:
            raise SceneError(
                f"solver 'spectral_elements': step_s is {step_s:.4g} s; allowed: above 0, at most the stable step "
                f"{stable_s:.4g} s; or omit it"
            )
        self.model, self.holds, self.step_s, self.table = model, holds, step_s, table
        device, real, put = model.device, model.real, model.put
        solid, layout = model.solid, model.layout
        count = len(solid.nodes)

        lanes = 1 if layout.gpu else hexa.LANES
        threads = -(-count // lanes)
        starts, sources = lane_rows(solid.elements, layout, lanes)
        self.threads, self.starts, self.sources = threads, model.ints(starts), model.ints(sources)
        self._copies()
        self.areas = model.vectors(face_areas(solid))
        flat = solid.nodes[: solid.surface_nodes, :2].astype(model.dtype)
        self.places: Any = wp.array(flat, dtype=wp.types.vector(2, real), device=device)
        self.spot = model.vectors(table.spot)
        self.frames = put(table.frames)
        self.frame, self.share = model.ints(table.frame), put(table.share)
        half = 0.5 * step_s * holds.damping
        pace = np.zeros((threads * lanes, 2))
        pace[:count] = np.stack([(1.0 - half) / (1.0 + half), step_s / model.mass / (1.0 + half)], axis=1)
        row_of = np.full(threads * lanes, -1)
        row_of[holds.rows] = np.arange(len(holds.rows))
        # Nodes fixed in all directions need no matrices
        still = holds.rows[~holds.projector.any(axis=(1, 2))]
        pace[still], row_of[still] = 0.0, -1
        self.held = model.ints(row_of)
        self.pace: Any = wp.array(pace.astype(model.dtype), dtype=wp.types.vector(2, real), device=device)
        mass = model.mass[holds.rows, None, None]
        drag = 0.5 * step_s * (holds.dashpot + (mass * holds.damping[holds.rows, None, None]) * np.eye(3))
        inverse = np.linalg.inv(mass * np.eye(3) + drag)
        project = holds.projector
        mat33 = wp.types.matrix((3, 3), real)
        carry = project @ inverse @ (mass * np.eye(3) - drag) @ project
        push = step_s * project @ inverse @ project
        self.matrices: list[Any] = [
            wp.array(a.astype(model.dtype), dtype=mat33, device=device) for a in (carry, push, holds.spring)
        ]
        copies = self.copy_count + threads * lanes - count
        self.u, self.v = (wp.zeros(threads * lanes, dtype=model.vec3, device=device) for _ in range(2))
        self.w = wp.zeros(copies, dtype=model.vec3, device=device)
        self.strain = wp.zeros((max(1, self.most), copies), dtype=model.vec3, device=device)
        # A separate array, because several runs may step one model at the same time
        self.force = wp.zeros_like(model.force)
        self.clock, self.finished = (wp.zeros(1, dtype=wp.int32, device=device) for _ in range(2))
        self.done = 0
        self.graph_steps = graph_steps
        slots = np.full(table.steps + graph_steps, -1)
        slots[target] = np.arange(len(target))
        self.slots = model.ints(slots)
        self.read_nodes, self.read_shares = model.ints(points.nodes), put(points.shares)
        shape = (max(1, len(target)), len(points.nodes))
        self.read_u, self.read_v = (wp.zeros(shape, dtype=model.vec3, device=device) for _ in range(2))
        self.commands = self._commands()
        self.graph: Any = None

    def _copies(self) -> None:
        """Make the arrays of the relaxing displacements by copy; see `copies_of`."""
        model, solid, layout = self.model, self.model.solid, self.model.layout
        laws, keys, inverse = copies_of(solid, model.materials)
        self.copy_count = len(keys)
        self.copy_starts = model.ints(np.searchsorted(keys // len(laws), np.arange(len(solid.nodes) + hexa.LANES + 1)))
        self.copy_laws = model.ints(keys % len(laws))
        w_conn = np.zeros(layout.count, dtype=np.int32)
        w_conn[layout.at] = inverse
        self.w_conn = model.ints(w_conn)
        ends = np.concatenate([[0], np.cumsum([len(branches) for branches, _ in laws])])
        rows = [(*branch_step(self.step_s, tau), g) for branches, _ in laws for g, tau in branches]
        self.law_ends = np.stack([ends[:-1], ends[1:]], axis=1)
        self.most = int(np.diff(ends).max())
        self.laws: Any = wp.array(self.law_ends.astype(np.int32), dtype=wp.vec2i, device=model.device)
        self.branches = model.vectors(np.array(rows).reshape(-1, 3))
        self.viscous = model.put(np.array([time_s for _, time_s in laws]))

    def _commands(self) -> list[Any]:
        """Return the launches of a step: forces of the elements, with the readings of the last step, then nodes."""
        model = self.model
        reading = (self.finished, self.slots, self.read_nodes, self.read_shares, self.v, self.read_u, self.read_v)
        return [
            model.launch(
                *(self.u, self.w, model.conn, self.w_conn, model.moduli, self.clock),
                reading=reading,
                force=self.force,
                record_cmd=True,
            ),
            run_kernel(
                hexa_steps.node_step(model.real, self.table.moving, len(self.law_ends) == 1, model.layout.gpu),
                dim=self.threads,
                inputs=[
                    *(self.starts, self.sources, self.force),
                    *(self.areas, self.places, self.spot, self.table.spread, self.frames, self.frame, self.share),
                    *(self.pace, self.held, *self.matrices),
                    *(self.copy_starts, self.copy_laws, self.laws, self.branches, self.viscous, self.step_s),
                    *(self.u, self.v, self.w, self.strain, self.clock, self.finished),
                ],
                device=model.device,
                block_dim=hexa_steps.NODE_BLOCK,
                record_cmd=True,
            ),
        ]

    def _step(self) -> None:
        for command in self.commands:
            command.launch()

    def advance(self, steps: int) -> None:
        """Do this number of steps. Raises SceneError if the table of the load has fewer."""
        if self.done + steps > self.table.steps:
            raise SceneError(
                f"solver 'spectral_elements': {self.done + steps} steps are requested, but the load table has "
                f"{self.table.steps}; give a longer table"
            )
        remaining = steps
        if self.model.layout.gpu and remaining >= self.graph_steps:
            if self.graph is None:
                with wp.ScopedCapture(device=self.model.device) as capture:
                    for _ in range(self.graph_steps):
                        self._step()
                self.graph = capture.graph
            while remaining >= self.graph_steps:
                wp.capture_launch(self.graph)
                remaining -= self.graph_steps
        for _ in range(remaining):
            self._step()
        self.done += steps
        run_kernel(
            hexa_steps.reading(self.model.real),
            dim=len(self.read_nodes),
            inputs=[
                *(self.finished, self.slots, self.read_nodes, self.read_shares),
                *(self.u, self.v, self.read_u, self.read_v),
            ],
            device=self.model.device,
        )

    def readings(self) -> tuple[Any, Any]:
        """Return displacement [m] and velocity [m/s] at the points after the target steps: (target, p) of vectors."""
        return self.read_u, self.read_v

    def _state_arrays(self) -> list[Any]:
        """Return the arrays that a step changes, without padding: u, v, w, and y of each branch."""
        nodes, copies = len(self.model.solid.nodes), self.copy_count
        strain = [self.strain[branch][:copies] for branch in range(self.most)]
        return [self.u[:nodes], self.v[:nodes], self.w[:copies], *strain]

    def numbers(self, out: Float) -> None:
        """Write the state into `out`, shape (state_size,): u and v by node, w and y of each branch by copy."""
        gather(self._state_arrays(), out)

    def begin(self, numbers: Float, frames: Float) -> None:
        """Continue from a state, shape (state_size,), at the beginning of the table, under other frames [Pa]."""
        scatter(numbers, self._state_arrays())
        self.frames[: len(frames)].assign(self.model.put(frames))
        self.clock.zero_()
        self.finished.zero_()
        self.done = 0
