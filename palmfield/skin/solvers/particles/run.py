"""Steps of particles: state on the device, stable step, and displacement histories."""

import math
from typing import Any

import numpy as np
import warp as wp
from scipy.sparse.linalg import LinearOperator, eigsh

from palmfield.device import gather, resolve, run_kernel, scatter
from palmfield.errors import SceneError
from palmfield.skin.materials.material import Material
from palmfield.skin.solvers.particles.cloud import Cloud
from palmfield.types import Float, Int
from warp_kernels import particles as kernels

HOURGLASS = 4.0 / 3.0
"""Stiffness against deviations of pairs from the gradient of their site, over G_r. On a square lattice 4/3 removes the
h^2 error of shear waves in every direction: sites without pairs give k^2 (1 - 4 X / 3) instead of k^2, pairs without
sites k^2 (1 - X / 3), X = (k h / 2)^2."""
SAFETY = 0.9
"""Step over the stable step: margin for stiffening by strain before a run is repeated."""
COURANT = 1.24
"""Stable step of a cube times the speed of sound over the spacing."""
BLOCK = 256
"""Number of steps between checks of the state."""
SMALL_STRAIN = 0.1
"""Largest displacement gradient x for which (1 + 2 x)^4 is an upper bound of the growth of all rates of the body."""


class CrushedError(SceneError):
    """The body has broken apart, because of its load or of a step that is too long for the strain."""


class StepTooLongError(Exception):
    """Strain has stiffened the body so much that the step is too long; `step_s`: a sufficient step [s]."""

    def __init__(self, step_s: float) -> None:
        super().__init__(f"a step of {step_s:.3g} s is stable")
        self.step_s = step_s


class Particles:
    """Particles on a device, initially at rest.

    step_s: [s], at most stable_step(cloud) for small strain; None: only forces, no steps
    displacement [m], velocity [m/s] (half a step earlier): Warp arrays (n,) of vec3
    """

    def __init__(self, cloud: Cloud, device: str, step_s: float | None = None, hourglass: float = HOURGLASS) -> None:
        self.cloud, self.device, self.hourglass = cloud, resolve(device), hourglass
        self.step_s = step_s if step_s is not None else 1.0
        count, sites = len(cloud.points), len(cloud.owner)
        branches = max(len(material.relaxation.branches) for material in cloud.materials)
        table = branch_table(cloud.materials, branches, self.step_s, instant=step_s is None)
        self.sites = [
            self._ints(cloud.owner),
            self._ints(cloud.count),
            self._ints(cloud.neighbour),
            self._reals(cloud.area, wp.vec3),
            self._reals(cloud.offset, wp.vec3),
            self._reals(cloud.spring),
            self._reals(cloud.moment, wp.mat33),
            self._reals(cloud.volume),
            self._ints(cloud.law),
            self._ints(cloud.has_memory),
        ]
        self.branches = [self._reals(values) for values in table]
        self.shear = self._reals(np.array([m.shear_relaxed_Pa for m in cloud.materials]))
        self.bulk = self._reals(np.array([m.bulk_Pa for m in cloud.materials]))
        self.bulk_relaxes = self._ints(np.array([m.bulk_relaxes for m in cloud.materials]))
        self.viscous = self._reals(np.array([m.relaxation.viscous_time_s for m in cloud.materials]))
        width = cloud.neighbour.shape[1]
        self.sums = [
            self._ints(cloud.site_start),
            self.sites[1],
            self._ints(cloud.incoming_count),
            self._ints(cloud.incoming),
            width,
        ]
        self.inverse_mass = self._reals(1.0 / cloud.mass)
        self.free = self._reals(cloud.free, wp.mat33)
        self.surface = self._ints(cloud.surface)
        self.face_area = self._reals(cloud.face_area, wp.vec3)
        self.displacement, self.velocity, self.memory = (self._room(count, wp.vec3) for _ in range(3))
        self.stress = self._room(sites, kernels.vec6)
        self.relaxed = self._room((sites, branches), kernels.vec6)
        self.relaxed_displacement = self._room((count, branches), wp.vec3)
        self.gradient = self._room(sites, wp.mat33)
        self.force = self._rows(np.zeros((sites, width, 3)), wp.vec3)

    def _rows(self, values: Any, dtype: Any) -> wp.array:
        """Return a table in which, on a GPU, equal slots of neighbouring particles are adjacent in memory."""
        if wp.get_device(self.device).is_cuda:
            turned = np.ascontiguousarray(np.swapaxes(values, 0, 1))
            return wp.array(turned, dtype=dtype, device=self.device).transpose()
        return wp.array(np.ascontiguousarray(values), dtype=dtype, device=self.device)

    def _reals(self, values: Float, dtype: Any = wp.float32) -> wp.array:
        values = np.asarray(values, dtype=np.float32)
        inner = {wp.vec3: 1, wp.mat33: 2}.get(dtype, 0)
        if values.ndim - inner == 2 and values.size:
            return self._rows(values, dtype)
        return wp.array(values, dtype=dtype, device=self.device)

    def _ints(self, values: Any) -> wp.array:
        values = np.asarray(values, dtype=np.int32)
        if values.ndim == 2:
            return self._rows(values, wp.int32)
        return wp.array(values, dtype=wp.int32, device=self.device)

    def _room(self, shape: Any, dtype: Any) -> wp.array:
        return wp.zeros(shape, dtype=dtype, device=self.device)

    def _site_inputs(self) -> list[Any]:
        laws = [self.shear, self.bulk, self.bulk_relaxes, self.viscous]
        state = [self.displacement, self.velocity, self.memory, self.stress, self.relaxed, self.gradient, self.force]
        return [*self.sites, *laws, *self.branches, self.hourglass, *state]

    def net_forces(self) -> Float:
        """Return the internal force on each particle [N], shape (n, 3); this advances the branches by one step."""
        total = self._room(len(self.cloud.points), wp.vec3)
        run_kernel(kernels.site_forces, dim=len(self.cloud.owner), inputs=self._site_inputs(), device=self.device)
        run_kernel(
            kernels.sum_forces, dim=len(self.cloud.points), inputs=[*self.sums, self.force, total], device=self.device
        )
        return total.numpy().astype(np.float64)

    def steps(
        self, rows: int, pressure: wp.array, follower: bool, reader: "Reader | None" = None, first: int = 0
    ) -> None:
        """Do `rows` steps, one for each row of a table of pressures [Pa] from row `first` on.

        reader: reads the points before each step
        """
        sites = run_kernel(
            kernels.site_forces, dim=len(self.cloud.owner), inputs=self._site_inputs(), device=self.device,
            record_cmd=True,
        )  # fmt: skip
        before = [*self.sums, self.force, self.inverse_mass, self.free, self.sites[8], self.viscous, *self.branches]
        face = [self.surface, self.face_area, pressure]
        after = [int(follower), self.gradient, self.step_s]
        state = [self.displacement, self.velocity, self.memory, self.relaxed_displacement]
        for row in range(first, first + rows):
            if reader is not None:
                reader.read(self.displacement, row)
            sites.launch()
            run_kernel(
                kernels.move,
                dim=len(self.cloud.points),
                inputs=[*before, *face, row, *after, *state],
                device=self.device,
            )

    def _state_arrays(self) -> list[wp.array]:
        """Return the arrays that a step changes: motion by particle, then stresses by site."""
        motion = [self.displacement, self.velocity, self.memory, self.relaxed_displacement]
        return [*motion, self.stress, self.relaxed]

    def begin(self, numbers: Float) -> None:
        """Continue from a state, shape (state_size,)."""
        scatter(numbers, self._state_arrays())

    def numbers(self, out: Float) -> None:
        """Write the state into `out`, shape (state_size,)."""
        gather(self._state_arrays(), out)

    def check(self, longest_s: float) -> None:
        """Check that the body is whole and the step is still stable; longest_s: longest stable step at rest [s].

        Raises CrushedError, with the place, if the body has broken apart, and StepTooLongError if it has stiffened.
        """
        gradient = self.gradient.numpy().astype(np.float64)
        broken = ~np.isfinite(gradient).all(axis=(1, 2))
        if not broken.any():
            # No stretch differs from 1 by more than the largest gradient, which is usually small
            largest = float(np.linalg.norm(gradient, axis=(1, 2)).max())
            if largest < SMALL_STRAIN and self.step_s * (1.0 + 2.0 * largest) ** 4 <= longest_s:
                return
            deformation = np.eye(3) + gradient
            broken = np.linalg.det(deformation) <= 0.0
        if broken.any():
            place = self.cloud.points[self.cloud.owner[np.argmax(broken)]]
            raise CrushedError(
                f"the body is crushed or inverted near ({', '.join(f'{x:.4g}' for x in place)}) m: lower the "
                "pressure, use a thicker or stiffer body, or a shorter step_s if it is fixed"
            )
        stretch = np.linalg.svd(deformation, compute_uv=False)
        # Bulk stiffness scales with the square of the cofactor of F, shear stiffness at most with that of F^-1.
        # Frequencies scale with the root of the stiffness, rates of dashpots with the stiffness.
        growth = max(float((stretch[:, 0] * stretch[:, 1]).max()), float((1.0 / stretch[:, 2]).max()))
        if any(material.viscosity_Pa_s > 0.0 for material in self.cloud.materials):
            growth *= growth
        if self.step_s * growth > longest_s:
            raise StepTooLongError(SAFETY * longest_s / growth)


def state_size(cloud: Cloud) -> int:
    """Return the size of the state of particles, see `Particles.begin`."""
    branches = max(len(material.relaxation.branches) for material in cloud.materials)
    return len(cloud.points) * 3 * (3 + branches) + len(cloud.owner) * 6 * (1 + branches)


class Reader:
    """Stores the displacement at points, one row for each step of a block."""

    def __init__(self, particles: Int, weights: Float, device: str) -> None:
        self.device = device
        self.count = len(particles)
        self.particles: wp.array = wp.array(np.asarray(particles, dtype=np.int32), dtype=wp.int32, device=device)
        self.weights: wp.array = wp.array(weights.astype(np.float32), dtype=wp.float32, device=device)
        self.rows = wp.zeros((BLOCK, self.count), dtype=wp.vec3, device=device)

    def read(self, displacement: wp.array, row: int) -> None:
        run_kernel(
            kernels.read_points,
            dim=self.count,
            inputs=[self.particles, self.weights, displacement, row, self.rows],
            device=self.device,
        )


def branch_table(
    materials: tuple[Material, ...], branches: int, step_s: float, instant: bool
) -> tuple[Float, Float, Float, Float]:
    """Return ratios g and weights e, a, b of q1 = e q0 + a u0 + b u1, each (materials, branches).

    The weights are exact for u linear over a step. instant: whether branches have their instantaneous stiffness
    """
    table = np.zeros((4, len(materials), branches))
    for row, material in enumerate(materials):
        for column, (ratio, time_s) in enumerate(material.relaxation.active):
            table[0, row, column] = ratio
            if not instant:
                x = step_s / time_s
                fade, gain = math.exp(-x), -math.expm1(-x) / x
                table[1:, row, column] = fade, gain - fade, 1.0 - gain
    return table[0], table[1], table[2], table[3]


def stable_step(cloud: Cloud, hourglass: float = HOURGLASS) -> float:
    """Return the longest stable step at rest [s]; runs take SAFETY times this.

    Leapfrog with a dashpot on the velocity half a step earlier is stable for h^2 w^2 / 4 + h c / 2 <= 1. w^2 is the
    largest eigenvalue of M^-1 K with unrelaxed branches, and c that of M^-1 C.
    """
    stiff = _largest(cloud, hourglass, dashpots=False)
    damping = _largest(cloud, hourglass, dashpots=True) if any(m.viscosity_Pa_s > 0.0 for m in cloud.materials) else 0.0
    return (math.sqrt(damping**2 + 4.0 * stiff) - damping) / stiff


def likely_step(cloud: Cloud) -> float:
    """Return an estimate of the stable step [s] from the heights of cells: 0.6 to 0.9 of the stable step."""
    columns = cloud.columns
    levels = columns.points().reshape(len(columns.shares), -1, 3)
    steepest = 0.0
    for faces in (columns.triangles, columns.squares):
        if len(faces):
            upper, lower = levels[:-1][:, faces], levels[1:][:, faces]
            along = upper[:, :, [1, -1]] - upper[:, :, :1]
            edges = np.concatenate([along, (lower - upper).mean(axis=2, keepdims=True)], axis=2)
            steepest = max(steepest, float((np.linalg.inv(edges) ** 2).sum(axis=(2, 3)).max()))
    moduli = [(m.bulk_Pa + 4.0 / 3.0 * m.shear_instant_Pa) / m.density_kg_m3 for m in cloud.materials]
    return SAFETY * COURANT * math.sqrt(3.0 / steepest / max(moduli))


def _largest(cloud: Cloud, hourglass: float, dashpots: bool) -> float:
    """Return the largest eigenvalue of M^-1 K [1/s^2], or of M^-1 C [1/s] for dashpots, by Lanczos on the kernels."""
    body = Particles(cloud, "cpu", None, hourglass)
    excess = np.array([sum(ratio for ratio, _ in m.relaxation.active) for m in cloud.materials])
    viscous = np.array([m.relaxation.viscous_time_s for m in cloud.materials])
    law = cloud.law[cloud.site_start[:-1]]
    scale = 1.0 / np.sqrt(cloud.mass)[:, None]
    # Small enough for a linear law, and large enough for all digits of float32
    small = 1e-9
    rest = np.zeros_like(cloud.points)

    def product(x: Float) -> Float:
        free = np.einsum("nij,nj->ni", cloud.free, x.reshape(-1, 3) * scale)
        size = small * cloud.columns.spacing_m / max(float(np.abs(free).max()), 1e-300)
        u = size * free
        body.displacement.assign((rest if dashpots else u).astype(np.float32))
        body.velocity.assign((u if dashpots else rest).astype(np.float32))
        memory = (viscous if dashpots else excess)[law][:, None] * u
        body.memory.assign(memory.astype(np.float32))
        force = body.net_forces()
        return -(np.einsum("nij,nj->ni", cloud.free, force) * scale).ravel() / size

    count = cloud.points.size
    start = np.random.default_rng(0).standard_normal(count)
    operator = LinearOperator((count, count), matvec=product, dtype=np.float64)
    return float(eigsh(operator, k=1, which="LA", v0=start, tol=1e-2, return_eigenvectors=False)[0]) * 1.01
