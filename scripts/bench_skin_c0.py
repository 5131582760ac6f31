"""Measure cost and error of the skin solver on the reference disc; writes docs/bench/skin_c0.md.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python scripts/bench_skin_c0.py

The disc is 120 x 20 mm of Ecoflex 00-10, bonded below, roller sides, under a Gaussian spot of 10.3 mm full width;
errors are those of the displacement at the centre relative to the exact Fourier-Bessel series. Set the thread counts:
on a busy machine, the BLAS inside SuperLU took 200 times as long with several threads.
"""

import os
import time
from pathlib import Path

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from palmfield.skin.analytic.layer_oracle import centre_response
from palmfield.skin.fem.assembly import SkinSystem, assemble, element_matrices
from palmfield.skin.fem.factor import factorise
from palmfield.skin.fem.load import SurfaceQuadrature
from palmfield.skin.fem.probe import SurfaceProbe
from palmfield.skin.fem.solver import harmonic, harmonic_discrete, static
from palmfield.skin.fem.wedge_stepper import WedgeStepper
from palmfield.skin.materials.catalogue import PRESETS
from palmfield.skin.mesh.disc import disc_patch
from palmfield.skin.mesh.wedges import extrude
from palmfield.skin.stepper import SurfaceLoads
from palmfield.studies.bench.field import git_commit
from palmfield.studies.bench.table import keep_rows, processor

ROOT = Path(__file__).resolve().parent.parent
ORDERS = "| order | factor [s] | solve [s] | numbers in both factors [millions] |"
SIDES = "| base | side | static push [nm/Pa] | magnitude at 200 Hz [nm/Pa] |"
SPOT, DEPTH, RADIUS, STEP = 0.0103, 0.02, 0.06, 2e-4
MATERIAL = PRESETS["ecoflex_00-10"]
# Edge under the spot and at the rim [mm], layers: growing 1.6 times each from the surface down.
MESHES = ((8.0, 20.0, 2), (6.0, 15.0, 3), (4.0, 10.0, 3), (4.5, 11.0, 4))


def build(fine_mm: float, coarse_mm: float, layers: int, side: str = "roller", base: str = "bonded"):
    edges = np.concatenate([[0.0], np.cumsum(1.6 ** np.arange(layers))])
    mesh = extrude(disc_patch(RADIUS, DEPTH, fine_mm * 1e-3, coarse_mm * 1e-3, 0.012), edges / edges[-1])
    begin = time.perf_counter()
    system = assemble(mesh, MATERIAL, side=side, base=base)
    seconds = time.perf_counter() - begin
    quadrature = SurfaceQuadrature(mesh, system)
    force = quadrature.assemble(np.exp(-4 * np.log(2) * (quadrature.points[:, :2] ** 2).sum(axis=1) / SPOT**2))
    read = -SurfaceProbe(mesh, np.zeros((1, 3)), system).operator
    return system, force, read, seconds


def mesh_row(fine_mm: float, coarse_mm: float, layers: int) -> str:
    system, force, read, assembly_s = build(fine_mm, coarse_mm, layers)
    still = (read @ static(system, force))[0]
    begin = time.perf_counter()
    moving = (read @ harmonic(system, force, 200.0))[0]
    harmonic_s = time.perf_counter() - begin
    errors = [abs(u / complex(exact(f)) - 1) for u, f in ((still, 0.0), (moving, 200.0))]
    begin = time.perf_counter()
    stepper = WedgeStepper(system, sparse.csr_matrix(force[:, None]), STEP)
    factor_s = time.perf_counter() - begin
    state = np.zeros((1, stepper.state_size))
    steady = SurfaceLoads(*np.ones((3, 1, 1, 1)))
    begin = time.perf_counter()
    for _ in range(20):
        stepper.step(state, steady, 0.0, STEP)
    step_s = (time.perf_counter() - begin) / 20
    errors_text = " | ".join(f"{100 * error:.2f} %" for error in errors)
    return (
        f"| {fine_mm:g} / {coarse_mm:g} mm, {layers} layers | {system.ndof} | {errors_text} "
        f"| {assembly_s:.2f} | {factor_s:.2f} | {step_s:.4f} | {harmonic_s:.2f} |"
    )


def exact(f_Hz: float, radius_m: float | None = RADIUS, base: str = "bonded"):
    return centre_response(f_Hz, MATERIAL, DEPTH, SPOT, radius_m, base=base)


def order_rows(system: SkinSystem) -> list[str]:
    """Return factor and solve times of the tested orders, for the matrix of a step of 0.2 ms."""
    matrix = (4.0 / STEP**2 * system.mass + system.parts[0].stiffness + system.elastic).tocsc()
    right = np.ones(system.ndof)
    rows = []

    def row(name, factor, solve, nonzeros):
        begin = time.perf_counter()
        lu = factor()
        middle = time.perf_counter()
        solve(lu)
        end = time.perf_counter()
        rows.append(f"| {name} | {middle - begin:.2f} | {end - middle:.3f} | {nonzeros(lu) / 1e6:.1f} |")

    order = system.elimination_order()
    row(
        "nested dissection of the surface (used)",
        lambda: factorise(matrix, order),
        lambda factor: factor.solve(right),
        lambda factor: factor.fill,
    )
    symmetric = {"diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
    row(
        "MMD_AT_PLUS_A, SymmetricMode",
        lambda: splu(matrix, permc_spec="MMD_AT_PLUS_A", **symmetric),
        lambda lu: lu.solve(right),
        lambda lu: lu.nnz,
    )
    return rows


def side_rows() -> list[str]:
    rows = []
    for base in ("bonded", "free_slip"):
        for side in ("fixed", "roller", "free"):
            system, force, read, _ = build(6.0, 15.0, 3, side, base)
            still = f"{(read @ static(system, force))[0] * 1e9:.2f}" if system.supported else "free to slide"
            moving = (read @ harmonic(system, force, 200.0))[0]
            rows.append(f"| {base} | {side} | {still} | {abs(moving) * 1e9:.2f} |")
        still, moving = (exact(f, None, base) for f in (0.0, 200.0))
        rows.append(f"| {base} | endless (exact) | {still.real * 1e9:.2f} | {abs(moving) * 1e9:.2f} |")
    return rows


def step_rows() -> list[str]:
    system, force, read, _ = build(8.0, 20.0, 2)
    reference = (read @ harmonic(system, force, 200.0))[0]
    rows = []
    for count in (10, 20, 40, 80):
        stepped = (read @ harmonic_discrete(system, force, 200.0, 1 / 200.0 / count))[0]
        rows.append(f"| {5.0 / count:g} | {count} | {100 * abs(stepped / reference - 1):.3f} % |")
    return rows


def main() -> None:
    commit = git_commit()
    element_matrices(extrude(disc_patch(0.01, 0.01, 0.01, 0.01, 0.01), np.array([0.0, 1.0])))
    mesh_rows = [mesh_row(*mesh) for mesh in MESHES]
    system = build(*MESHES[-1])[0]
    target = ROOT / "docs" / "bench" / "skin_c0.md"
    lines = [
        "# Solver `wedges` on the reference disc",
        "",
        "For developers of solvers. Command: `OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python "
        "scripts/bench_skin_c0.py`",
        f"CPU: {processor()}, {os.cpu_count()} cores, threads: OMP_NUM_THREADS={os.environ.get('OMP_NUM_THREADS')}, "
        f"OPENBLAS_NUM_THREADS={os.environ.get('OPENBLAS_NUM_THREADS')}. Commit: {commit}.",
        "",
        "The disc of Ecoflex 00-10 (nu 0.495) has a diameter of 120 mm and a height of 20 mm. Its base is bonded, and",
        "its sides are on rollers. The load is a Gaussian spot of 10.3 mm. Errors are at the centre, compared with the",
        "exact series. Time is integrated by the generalised-alpha method, in steps of 0.2 ms.",
        "",
        "| edge at spot / rim | unknowns | static error | error at 200 Hz | assembly [s] | factor [s] | step [s] "
        "| harmonic solution [s] |",
        "|---|---|---|---|---|---|---|---|",
        *mesh_rows,
        "",
        f"{keep_rows(target, [ORDERS, '', *order_rows(system)], 'skin_c0_orders')} has the time with other elimination",
        f"orders. {keep_rows(target, [SIDES, '', *side_rows()], 'skin_c0_sides')} has the displacement with other",
        "boundary conditions.",
        "",
        "Error of the steady state at 200 Hz for several time steps (8 / 20 mm, 2 layers):",
        "",
        "| step [ms] | steps per period | error |",
        "|---|---|---|",
        *step_rows(),
        "",
    ]
    target.write_text("\n".join(lines))
    print("\n".join(lines))


if __name__ == "__main__":
    main()
