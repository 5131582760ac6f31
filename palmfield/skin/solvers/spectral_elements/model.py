"""A solid on a device: geometry, masses, materials, constraints, and the stable step."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from palmfield.device import run_kernel
from palmfield.errors import SceneError
from palmfield.skin.base import BaseKind, SideKind, Springs
from palmfield.skin.materials.material import Material, Sheet
from palmfield.skin.solvers.spectral_elements.solid import (
    Rule,
    Solid,
    base_areas,
    cell_areas,
    inside_out,
    rim_edges,
    rule,
)
from palmfield.types import Float, Int
from warp_kernels import hexa, hexa_steps
from warp_kernels.hexa import READERS

SAFETY = 0.95
"""Step over the computed stable step; power iteration approaches the largest rate from below, within 2 %."""

ROUNDS = 60
"""Number of power iterations from a random start; tests compare the rate with a dense eigenvalue."""


@dataclass(frozen=True)
class Layout:
    """Positions of element nodes in flat arrays.

    at: position by element and node, shape (E, n^3); slot, element: node and element by position, with padding
    count: number of positions; padded: number of elements with padding, which has at least one element
    spare: a position in the padding; gpu: whether the order is that for a GPU
    """

    at: Int
    slot: Int
    element: Int
    count: int
    padded: int
    spare: int
    gpu: bool


def lay_out(elements: int, order: int, gpu: bool) -> Layout:
    nodes, places = (order + 1) ** 3, hexa.places(order, gpu)
    group = max(1, hexa.BLOCK // places) if gpu else hexa.LANES
    padded = -(-(elements + 1) // group) * group
    index = np.arange(padded * places).reshape(padded, places)
    if not gpu:
        index = index.reshape(-1, places, group).transpose(0, 2, 1).reshape(padded, places)
    slot, element = np.empty(index.size, dtype=np.int32), np.empty(index.size, dtype=np.int32)
    slot[index] = np.where(np.arange(padded)[:, None] < elements, np.arange(places), nodes)
    element[index] = np.arange(padded)[:, None]
    return Layout(index[:elements, :nodes].astype(np.int32), slot, element, index.size, padded, int(index[-1, 0]), gpu)


class Model:
    """Masses, stiffness and constraints of a solid of sheets, on a device.

    precision: "float32" or "float64" for state and elements
    mass: mass by node [kg], shape (nodes,); conn: node by position
    Raises SceneError, with its place [m], for an element that is flat or inverted.
    """

    def __init__(self, solid: Solid, sheets: tuple[Sheet, ...], device: str, precision: str = "float32") -> None:
        self.solid, self.device = solid, device
        self.real: Any = wp.float64 if precision == "float64" else wp.float32
        self.dtype = np.dtype(precision)
        self.vec3 = wp.types.vector(length=3, dtype=self.real)
        self.materials = [sheet.material for sheet in sheets]
        self.layout = lay_out(len(solid.elements), solid.order, device != "cpu")
        layout, n = self.layout, solid.order + 1
        self.conn_host = np.zeros(layout.count, dtype=np.int32)
        self.conn_host[layout.at] = solid.elements
        self.conn = self.ints(self.conn_host)
        gll = rule(solid.order)
        self.derivative = self.put(gll.derivative)
        self.filter = self.put(np.concatenate([gll.top, gll.top_weights, gll.weights]))
        self.at = self.ints(layout.at)
        self.metric = wp.zeros((11, layout.count), dtype=self.real, device=device)
        volume = wp.zeros(layout.count, dtype=self.real, device=device)
        determinant = wp.zeros(layout.count, dtype=self.real, device=device)
        run_kernel(
            hexa_steps.geometry(self.real),
            dim=layout.count,
            inputs=[
                wp.array(solid.nodes, dtype=wp.vec3d, device=device),
                self.conn,
                self.ints(layout.slot),
                self.ints(layout.element),
                self.at,
                self.put(gll.derivative),
                self.put(gll.weights),
                self.metric,
                volume,
                determinant,
            ],
            device=device,
        )
        self.volume = volume.numpy()[layout.at]
        jacobian = determinant.numpy()[layout.at]
        lengths = np.abs(jacobian).max(axis=1)
        worst = int(np.argmin(np.divide(jacobian.min(axis=1), lengths, out=-np.ones(len(lengths)), where=lengths > 0)))
        if not jacobian[worst].min() > 1e-6 * lengths[worst]:
            raise SceneError(inside_out(solid, worst))
        boxed = reduced(jacobian.reshape(-1, n, n, n), gll)
        row = np.zeros(layout.count, dtype=self.dtype)
        row[layout.at] = 1.0 / boxed.reshape(len(boxed), -1)
        wp.copy(self.metric[10], wp.array(row, dtype=self.real, device=device))
        density = np.array([m.density_kg_m3 for m in self.materials])[solid.sheet]
        self.element_mass = self.volume * density[:, None]
        self.mass = np.bincount(
            solid.elements.ravel(), self.element_mass.ravel().astype(np.float64), minlength=len(solid.nodes)
        )
        self.mixes = np.array([float(m.bulk_relaxes or not m.relaxes) for m in self.materials])
        self.single = bool((self.mixes == 1.0).all())
        self.kernel = hexa.element_forces(solid.order, self.real, self.single, layout.gpu)
        self.force = wp.zeros((3, layout.count), dtype=self.real, device=device)
        none = wp.zeros((0, 0), dtype=self.vec3, device=device)
        nowhere = wp.zeros((0, 0), dtype=self.real, device=device)
        indices = wp.zeros((0, 0), dtype=wp.int32, device=device)
        spare = wp.zeros(1, dtype=wp.int32, device=device)
        self.no_reading = (spare, spare, indices, nowhere, wp.zeros(0, dtype=self.vec3, device=device), none, none)
        self.moduli = self.moduli_of([m.shear_relaxed_Pa for m in self.materials])

    def put(self, values: Float) -> Any:
        """Return an array on the device of the model, in its precision."""
        return wp.array(np.asarray(values, dtype=self.dtype), dtype=self.real, device=self.device)

    def ints(self, values: Any) -> Any:
        return wp.array(np.asarray(values, dtype=np.int32), dtype=wp.int32, device=self.device)

    def vectors(self, values: Float) -> Any:
        return wp.array(np.asarray(values, dtype=self.dtype), dtype=self.vec3, device=self.device)

    def moduli_of(self, shear: list[float], bulk: list[float] | None = None) -> Any:
        """Return shear modulus, bulk modulus [Pa] (default: relaxed) and mix by element, from moduli by sheet."""
        rows = np.zeros((3, self.layout.padded))
        for row, values in enumerate((shear, bulk or [m.bulk_Pa for m in self.materials], self.mixes)):
            rows[row, : len(self.solid.sheet)] = np.asarray(values)[self.solid.sheet]
        return self.put(rows)

    def launch(
        self,
        u: Any,
        w: Any,
        conn: Any,
        w_conn: Any,
        moduli: Any,
        clock: Any,
        reading: tuple[Any, ...] | None = None,
        force: Any = None,
        record_cmd: bool = False,
    ) -> Any:
        """Compute internal forces by position in `force` (default: array of the model), now or as a recorded launch.

        reading: as in hexa.element_forces
        """
        layout, order = self.layout, self.solid.order
        block = max(hexa.BLOCK, hexa.places(order, True))
        threads = layout.count if layout.gpu else layout.padded // hexa.LANES
        return run_kernel(
            self.kernel,
            dim=threads + READERS,
            inputs=[
                *(u, w, conn, w_conn, self.metric, moduli, self.derivative, self.filter),
                *(self.force if force is None else force, clock, threads),
                *(reading or self.no_reading),
            ],
            device=self.device,
            block_dim=block,
            record_cmd=record_cmd,
        )

    def largest_rate(self, factors: list[float], start: Any) -> float:
        """Return the largest eigenvalue of M^-1 K of any element [1/s^2], a bound for the body (Irons & Treharne 1971).

        factors: factors by sheet on the relaxed stiffness of the relaxing part
        start: initial displacement by position; it becomes the eigenvectors of the elements
        """
        own = self.ints(np.arange(self.layout.count))
        mass = np.ones(self.layout.count)
        mass[self.layout.at] = self.element_mass
        shear = [m.shear_relaxed_Pa * factor for m, factor in zip(self.materials, factors, strict=True)]
        bulk = [m.bulk_Pa * (f if m.bulk_relaxes else 1.0) for m, f in zip(self.materials, factors, strict=True)]
        there, moduli = self.put(mass), self.moduli_of(shear, bulk)
        rate = wp.zeros(len(self.solid.elements), dtype=self.real, device=self.device)
        spare = wp.zeros(1, dtype=wp.int32, device=self.device)
        # The first Rayleigh quotient belongs to a vector that is not normalised
        for _ in range(ROUNDS + 1):
            self.launch(start, start, own, own, moduli, spare)
            run_kernel(
                hexa_steps.power_step(self.real),
                dim=len(self.solid.elements),
                inputs=[self.at, self.force, there, start, rate],
                device=self.device,
            )
        return float(rate.numpy().max())

    def stable_step(self, spring_rate: float = 0.0) -> float:
        """Return the largest step [s] with positive discrete energy of the scheme (see `Stepper`): h^2 rate(h) = 4.

        spring_rate: largest k / m of springs at nodes [1/s^2]
        """
        rng = np.random.default_rng(0)
        start = self.vectors(rng.standard_normal((self.layout.count, 3)))
        step = 2.0 / np.sqrt(self.largest_rate([stiffening_at(m, 0.0) for m in self.materials], start) + spring_rate)
        for _ in range(12):
            rate = self.largest_rate([stiffening_at(m, step) for m in self.materials], start) + spring_rate
            better = 2.0 / np.sqrt(rate)
            if not 0.0 < better < np.inf:
                worst = max(self.materials, key=lambda material: material.viscosity_Pa_s)
                raise SceneError(
                    f"solver 'spectral_elements': a viscosity of {worst.viscosity_Pa_s:.3g} Pa s makes steps too small "
                    f"for {self.dtype}; use solver 'wedges'"
                )
            if abs(better / step - 1.0) < 1e-3:
                return float(min(step, better))
            step = float(better)
        return step


def reduced(values: Float, gll: Rule) -> Float:
    """Return nodal values, (E, n, n, n), without the highest Legendre polynomial along each direction."""
    for axis in (1, 2, 3):
        share = np.tensordot(values, gll.top_weights, (axis, 0))[..., None] * gll.top
        values = values - np.moveaxis(share, -1, axis)
    return values


def stiffening_at(material: Material, step_s: float) -> float:
    """Return the factor on G_r in the bound of the step: 1 + sum g tanh(x/2) / (x/2) + 2 t / h, x = h / tau.

    At step 0 the term of the dashpot, which is infinite, is omitted.
    """
    total = 1.0 + (2.0 * material.relaxation.viscous_time_s / step_s if step_s > 0.0 else 0.0)
    for ratio, time_s in material.relaxation.active:
        half = 0.5 * step_s / time_s
        total += ratio * (math.tanh(half) / half if half > 0.0 else 1.0)
    return total


@dataclass(frozen=True)
class Holds:
    """Fixed and damped directions of the nodes.

    damping: mass-proportional rate by node [1/s], shape (nodes,)
    rows: node of each row; projector: on free directions; spring [N/m]; dashpot [N s/m]; each (rows, 3, 3)
    """

    damping: Float
    rows: Int
    projector: Float
    spring: Float
    dashpot: Float


def constraints(
    model: Model, base: BaseKind | Springs, side: SideKind | None, damping: Float | None
) -> tuple[Holds, float]:
    """Return the constraints of `hold`, and the largest stable step of the constrained model [s]."""
    holds = hold(model, base, side, damping)
    rows = model.mass[holds.rows, None, None]
    return holds, model.stable_step(float((np.abs(holds.spring) / rows).sum(axis=2).max(initial=0.0)))


def hold(model: Model, base: BaseKind | Springs, side: SideKind | None, damping: Float | None = None) -> Holds:
    """Return the constraints of base and sides; "absorbing" sides get dashpots rho c with the instantaneous speeds
    (Lysmer & Kuhlemeyer 1969)."""
    solid, quads = model.solid, model.solid.quads
    count, levels = solid.surface_nodes, solid.levels
    bottom = np.arange((levels - 1) * count, levels * count)
    rim = np.flatnonzero(quads.rim)
    sides = (rim + count * np.arange(levels)[:, None]).ravel() if side not in (None, "free") else np.zeros(0, np.int64)
    held_base = bottom if base != "free" else np.zeros(0, np.int64)
    rows = np.unique(np.concatenate([held_base, sides]))
    row_of = np.full(len(solid.nodes), -1)
    row_of[rows] = np.arange(len(rows))
    projector = np.tile(np.eye(3), (len(rows), 1, 1))
    spring, dashpot = np.zeros((2, len(rows), 3, 3))
    lists: list[list[Float]] = [[] for _ in range(len(rows))]
    if side == "fixed":
        projector[row_of[sides]] = 0.0
    elif side == "roller":
        for node, normals in zip(sides, np.tile(quads.rim_normals[rim], (levels, 1, 1)), strict=True):
            lists[row_of[node]] += [x for x in normals if x.any()]
    elif side == "absorbing":
        dashpot += _side_dashpots(model, row_of, len(rows))
    if isinstance(base, Springs):
        areas = base_areas(solid)
        area = np.linalg.norm(areas, axis=1)[:, None, None]
        out = areas / area[:, 0]
        along = np.einsum("sc,sd->scd", out, out)
        across = np.eye(3) - along
        spring[row_of[bottom]] = area * (base.normal_Pa_m * along + base.tangential_Pa_m * across)
        dashpot[row_of[bottom]] += area * (base.normal_Pa_s_m * along + base.tangential_Pa_s_m * across)
    elif base == "bonded":
        projector[row_of[bottom]] = 0.0
    elif base == "free_slip":
        for node, area in zip(bottom, base_areas(solid), strict=True):
            lists[row_of[node]].append(area / np.linalg.norm(area))
    for row, normals in enumerate(lists):
        if normals and projector[row].any():
            basis, sizes, _ = np.linalg.svd(np.array(normals).T)
            fixed = basis[:, : len(sizes)][:, sizes > 1e-6 * sizes[0]]
            projector[row] = np.eye(3) - fixed @ fixed.T
    rate = np.zeros(len(solid.nodes)) if damping is None else damping
    return Holds(rate, rows, projector, spring, dashpot)


def _side_dashpots(model: Model, row_of: Int, count: int) -> Float:
    """Return the dashpots of side nodes, (rows, 3, 3): area times rho c_p along the normal and rho c_s across it."""
    solid = model.solid
    edges, cell = rim_edges(solid.quads.cells)
    layers = (solid.levels - 1) // solid.order
    level = solid.order * np.arange(layers)[:, None] + np.arange(solid.order + 1)
    cells = edges[None, :, :, None] + solid.surface_nodes * level[:, None, None, :]
    cells = cells.reshape(-1, solid.order + 1, solid.order + 1)
    owner = (cell + len(solid.quads.cells) * np.arange(layers)[:, None]).ravel()
    total = np.zeros((count, 3, 3))
    area = cell_areas(solid.nodes[cells], solid.order)
    size = np.linalg.norm(area, axis=3)
    out = area / size[..., None]
    impedance = np.array(
        [
            [np.sqrt(m.density_kg_m3 * (m.bulk_Pa + 4.0 / 3.0 * m.shear_instant_Pa)) for m in model.materials],
            [np.sqrt(m.density_kg_m3 * m.shear_instant_Pa) for m in model.materials],
        ]
    )[:, solid.sheet[owner]]
    along = np.einsum("eijc,eijd->eijcd", out, out)
    pull = impedance[0][:, None, None, None, None] * along
    pull += impedance[1][:, None, None, None, None] * (np.eye(3) - along)
    np.add.at(total, row_of[cells], size[..., None, None] * pull)
    return total
