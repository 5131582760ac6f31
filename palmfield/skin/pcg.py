"""Conjugate gradients for the constant effective matrix, on blocks of 3x3, and time stepping with it on a device.

Preconditioner: one-level additive Schwarz (Toselli & Widlund 2005, ch. 3). The surface is cut into cells, each grown
by `overlap` rings of nodes; a subdomain is everything below a cell, through the whole depth, and its matrix is inverted
densely once. Waves move less than a cell in a step, and a layer's free face lets a subdomain keep its volume, so
neither needs a coarse level; see docs/bench/skin_linear.md for the iterations it takes.
"""

import math
from typing import Any

import numpy as np
import warp as wp
from scipy import sparse

from palmfield.device import resolve
from palmfield.errors import SceneError
from palmfield.skin.fem.assembly import SkinSystem
from palmfield.skin.fem.solver import Scheme
from palmfield.skin.mesh.ordering import surface_cells
from palmfield.types import Float, Int
from warp_kernels import sparse_blocks as kernels

CELL_DOFS = 300
"""Degrees of freedom of a cell before it is grown."""
PARTIAL_SUMS = {"cpu": 1, "cuda": 256}
LANES = {"cpu": 1, "cuda": 32}
CHECK_EVERY = 4


class NodalForm:
    """A system's degrees of freedom, three a node that may move, with what is held left as an identity.

    spread: csr (3 nodes, n): nodal vector = spread @ u; its columns are orthonormal
    surface_node: surface node under which each node lies, shape (nodes,)
    """

    def __init__(self, system: SkinSystem) -> None:
        moving = np.flatnonzero(np.diff(system.directions.indptr).reshape(-1, 3).any(axis=1))
        self.spread = system.directions[(3 * moving[:, None] + np.arange(3)).ravel()]
        self.surface_node = (moving % system.mesh.surface_nodes).astype(np.int32)
        self.held = sparse.identity(self.spread.shape[0]) - self.spread @ self.spread.T

    def blocks(self, matrix: sparse.csr_matrix, hold: bool) -> sparse.bsr_matrix:
        """The nodal matrix; with `hold` the held directions get a 1 of the diagonal's size."""
        nodal = self.spread @ matrix @ self.spread.T
        if hold:
            nodal = nodal + float(matrix.diagonal().mean()) * self.held
        result = sparse.bsr_matrix(sparse.csr_matrix(nodal), blocksize=(3, 3))
        result.sort_indices()
        return result


class BlockMatrix:
    """A block-sparse matrix on a device; see warp_kernels.sparse_blocks for its layout."""

    def __init__(self, matrix: sparse.bsr_matrix, device: str) -> None:
        self.device = device
        self.lanes = LANES[device.partition(":")[0]]
        counts = np.diff(matrix.indptr).astype(np.int32)
        self.size = len(counts)
        order = np.argsort(-counts, kind="stable") if self.lanes > 1 else np.arange(self.size)
        slices = math.ceil(self.size / self.lanes)
        padded = np.zeros(slices * self.lanes, dtype=np.int64)
        padded[: self.size] = counts[order]
        widths = padded.reshape(slices, self.lanes).max(axis=1)
        starts = np.concatenate([[0], np.cumsum(widths * self.lanes)])
        if starts[-1] > np.iinfo(np.int32).max:
            raise SceneError(f"the matrix has {starts[-1]} blocks, above 2^31: use larger elements")
        columns = np.zeros(starts[-1], dtype=np.int32)
        blocks = np.zeros((starts[-1], 3, 3))
        place = np.repeat(starts[np.arange(self.size) // self.lanes] + np.arange(self.size) % self.lanes, counts[order])
        entry = np.arange(len(place)) - np.repeat(np.cumsum(counts[order]) - counts[order], counts[order])
        source = np.repeat(matrix.indptr[order], counts[order]) + entry
        columns[place + entry * self.lanes] = matrix.indices[source]
        blocks[place + entry * self.lanes] = matrix.data[source]
        self.arrays: list[Any] = [
            wp.array(np.ascontiguousarray(values, dtype=kind), dtype=warp_type, device=device)
            for values, kind, warp_type in (
                (starts[:-1], np.int32, wp.int32),
                (counts[order], np.int32, wp.int32),
                (order, np.int32, wp.int32),
                (columns, np.int32, wp.int32),
                (blocks, np.float64, wp.mat33d),
            )
        ]

    def multiply(self, x: Any, y: Any, add: bool = False) -> None:
        """y = A x, or y += A x, on device vectors of 3 `size` numbers."""
        inputs = [*self.arrays, self.lanes, x, int(add)]
        wp.launch(kernels.multiply, dim=self.size, inputs=inputs, outputs=[y], device=self.device)


class Schwarz:
    """Overlapping dense solves; `bytes` is what the inverses take."""

    def __init__(self, matrix: sparse.bsr_matrix, cells: list[Int], device: str) -> None:
        self.device = device
        csr = matrix.tocsr()
        inverses, members, sizes = [], [], []
        for nodes in cells:
            dofs = (3 * nodes[:, None] + np.arange(3)).ravel()
            inverse = np.linalg.inv(csr[dofs][:, dofs].toarray())
            inverses.append((0.5 * (inverse + inverse.T)).astype(np.float32).ravel())
            members.append(dofs)
            sizes.append(len(dofs))
        size = np.array(sizes, dtype=np.int64)
        first = np.concatenate([[0], np.cumsum(size)[:-1]])
        offset = np.concatenate([[0], np.cumsum(size**2)[:-1]])
        member = np.concatenate(members)
        copies = np.argsort(member, kind="stable")
        starts = np.searchsorted(member[copies], np.arange(csr.shape[0] + 1))
        self.bytes = int(4 * (size**2).sum())
        self.count, self.size = len(member), csr.shape[0]

        def upload(values: Any, dtype: Any) -> Any:
            return wp.array(np.ascontiguousarray(values), dtype=dtype, device=device)

        self.local = [
            upload(np.concatenate(inverses), wp.float32),
            upload(np.repeat(offset, size), wp.int64),
            upload(np.repeat(first, size).astype(np.int32), wp.int32),
            upload(np.repeat(size, size).astype(np.int32), wp.int32),
            upload(member.astype(np.int32), wp.int32),
            int(device == "cpu"),
        ]
        self.gathering = [upload(starts.astype(np.int32), wp.int32), upload(copies.astype(np.int32), wp.int32)]
        self.room = wp.zeros(self.count, dtype=wp.float64, device=device)

    def apply(self, residual: Any, out: Any) -> None:
        inputs = [*self.local, residual]
        wp.launch(kernels.local_solve, dim=self.count, inputs=inputs, outputs=[self.room], device=self.device)
        inputs = [*self.gathering, self.room]
        wp.launch(kernels.gather, dim=self.size, inputs=inputs, outputs=[out], device=self.device)


class Pcg:
    """Preconditioned conjugate gradients for one symmetric positive matrix.

    tolerance: of the residual in the preconditioner's norm, relative to the right side's
    overlap: rings of nodes by which a cell is grown; iterations: those of the last solve
    Raises SceneError where `limit` iterations do not reach the tolerance.
    """

    def __init__(
        self,
        matrix: sparse.csr_matrix,
        system: SkinSystem,
        device: str = "cpu",
        tolerance: float = 1e-8,
        overlap: int = 1,
        limit: int = 2000,
    ) -> None:
        self.device = resolve(device)
        self.tolerance, self.limit = tolerance, limit
        self.form = NodalForm(system)
        blocks = self.form.blocks(matrix, hold=True)
        self.matrix = BlockMatrix(blocks, self.device)
        self.schwarz = Schwarz(blocks, self._cells(system, overlap), self.device)
        size = 3 * self.matrix.size
        self.x, self.residual, self.z, self.direction, self.image, self.right = (
            wp.zeros(size, dtype=wp.float64, device=self.device) for _ in range(6)
        )
        self.partial = wp.zeros(PARTIAL_SUMS[self.device.partition(":")[0]], dtype=wp.float64, device=self.device)
        # (r, z) now, before, and (p, A p); the last slot is spare.
        self.values = wp.zeros(4, dtype=wp.float64, device=self.device)
        self.iterations = 0
        self._graph: Any = None

    def _cells(self, system: SkinSystem, overlap: int) -> list[Int]:
        nodes = np.argsort(self.form.surface_node, kind="stable")
        owner = self.form.surface_node[nodes]
        depth = max(1, round(3 * len(nodes) / max(1, len(np.unique(owner)))))
        cells = surface_cells(system.mesh, max(1, CELL_DOFS // depth), overlap)
        grown = []
        for cell in cells:
            first, last = np.searchsorted(owner, cell), np.searchsorted(owner, cell, side="right")
            found = np.concatenate([nodes[a:b] for a, b in zip(first, last, strict=True)])
            if len(found):
                grown.append(np.sort(found))
        return grown

    def solve(self, right: Float) -> Float:
        """Solution over the system's degrees of freedom, shape (n,)."""
        self.right.assign(self.form.spread @ right)
        self.x.zero_()
        self.solve_on_device()
        return self.form.spread.T @ self.x.numpy()

    def solve_on_device(self) -> None:
        """`x`, its guess on entry, for `right`."""
        self.schwarz.apply(self.right, self.z)
        self._dot(self.right, self.z, 0, 3)
        wanted = self.tolerance**2 * float(self.values.numpy()[0])
        self.matrix.multiply(self.x, self.image)
        self._launch(kernels.subtract, [self.right, self.image], [self.residual])
        self.schwarz.apply(self.residual, self.z)
        self.values.zero_()
        self._dot(self.residual, self.z, 0, 3)
        self.direction.assign(self.z)
        self.iterations = 0
        while float(self.values.numpy()[0]) > wanted:
            if self.iterations >= self.limit:
                raise SceneError(
                    f"conjugate gradients: not at {self.tolerance} after {self.limit} iterations; the body may lack a "
                    "support, or use solver 'implicit' on the CPU, which factorises"
                )
            self._iterate()
            self.iterations += CHECK_EVERY

    def _iterate(self) -> None:
        if self.device == "cpu":
            self._some_iterations()
            return
        if self._graph is None:
            self._some_iterations_compiled()
        wp.capture_launch(self._graph)

    def _some_iterations_compiled(self) -> None:
        wp.load_module(kernels, device=self.device)
        with wp.ScopedCapture(device=self.device, force_module_load=False) as capture:
            self._some_iterations()
        self._graph = capture.graph

    def _some_iterations(self) -> None:
        for _ in range(CHECK_EVERY):
            self.matrix.multiply(self.direction, self.image)
            self._dot(self.direction, self.image, 2, 3)
            self._launch(kernels.descend, [self.values, self.direction, self.image], [self.x, self.residual])
            self.schwarz.apply(self.residual, self.z)
            self._dot(self.residual, self.z, 0, 1)
            self._launch(kernels.turn, [self.values, self.z], [self.direction])

    def _dot(self, a: Any, b: Any, slot: int, shift: int) -> None:
        wp.launch(
            kernels.partial_dot, dim=len(self.partial), inputs=[a, b], outputs=[self.partial], device=self.device
        )  # fmt: skip
        wp.launch(
            kernels.whole_dot, dim=1, inputs=[self.partial, self.values, slot, shift], device=self.device
        )  # fmt: skip

    def _launch(self, kernel: Any, inputs: list[Any], outputs: list[Any]) -> None:
        wp.launch(kernel, dim=3 * self.matrix.size, inputs=inputs, outputs=outputs, device=self.device)


class DeviceStepper:
    """Time steps by conjugate gradients, the whole state on a device; the scheme's numbers as for SkinSolver.

    read: csr (m, n): what `step` returns of the new displacement, velocity and acceleration
    """

    def __init__(self, scheme: Scheme, read: sparse.csr_matrix, device: str, tolerance: float = 1e-8) -> None:
        self.scheme = scheme
        self.linear = Pcg(scheme.effective, scheme.system, device, tolerance)
        self.device = self.linear.device
        form = self.linear.form
        self.read = sparse.csr_matrix(read @ form.spread.T)
        self.spread = form.spread
        size = 3 * self.linear.matrix.size
        self.terms = [
            (BlockMatrix(form.blocks(matrix, hold=False), self.device), self._upload(row))
            for matrix, row in scheme.terms
        ]
        self.follow, self.matrix = self._upload(scheme.follow), self._upload(scheme.advance)
        # The first guess of the new displacement: the old motion carried on with its acceleration.
        guess = np.zeros(scheme.state_rows)
        guess[:3] = 1.0, scheme.step_s, 0.5 * scheme.step_s**2
        self.guess = self._upload(guess)
        self.state, self.spare = (
            wp.zeros((scheme.state_rows, size), dtype=wp.float64, device=self.device) for _ in range(2)
        )
        self.mixed = wp.zeros(size, dtype=wp.float64, device=self.device)

    def _upload(self, values: Float) -> Any:
        return wp.array(np.ascontiguousarray(values), dtype=wp.float64, device=self.device)

    def step(self, force_start: Float, force_end: Float) -> Float:
        """One step under a force [N], (n,), linear between its two values; read @ (u, v, a), shape (m, 3)."""
        linear, scheme = self.linear, self.scheme
        force = (1.0 - scheme.alpha_f) * force_end + scheme.alpha_f * force_start
        linear.right.assign(self.spread @ force)
        size = 3 * linear.matrix.size
        for matrix, row in self.terms:
            self._launch(kernels.combine, size, [self.state, row], [self.mixed])
            matrix.multiply(self.mixed, linear.right, add=True)
        self._launch(kernels.combine, size, [self.state, self.guess], [linear.x])
        linear.solve_on_device()
        inputs = [self.matrix, self.follow, linear.x, self.state]
        self._launch(kernels.advance, (scheme.state_rows, size), inputs, [self.spare])
        self.state, self.spare = self.spare, self.state
        return np.asarray(self.read @ self.state.numpy()[:3].T)

    def _launch(self, kernel: Any, dim: Any, inputs: list[Any], outputs: list[Any]) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=self.device)
