"""Sparse factorisation against conjugate gradients for one step of the skin, over sizes: docs/bench/skin_linear.md.

python scripts/bench_skin_linear.py [--device cuda:0] [--largest 60000] [--out docs/bench/skin_linear.md]
"""

import argparse
import dataclasses
import platform
import time
from pathlib import Path

import numpy as np
import warp as wp

from palmfield.skin.fem.assembly import assemble
from palmfield.skin.fem.solver import SkinSolver
from palmfield.skin.materials.catalogue import preset
from palmfield.skin.materials.material import bulk_from_poisson
from palmfield.skin.mesh.disc import disc_patch
from palmfield.skin.mesh.wedges import extrude
from palmfield.skin.pcg import Pcg

STEP = 2.5e-4
HEAD = """# One step of the implicit solver: factorisation or conjugate gradients

Ecoflex disc, 20 mm deep, two to three rows of elements, bonded, roller sides, steps of 0.25 ms, a random force,
tolerance 1e-8. The factorisation is SuperLU in nested-dissection order; conjugate gradients have one-level overlapping
Schwarz blocks in float32. Memory: the factors; the blocks. `python scripts/bench_skin_linear.py` on {machine}.

| nu | unknowns | factorise s | solve s | factors MB | set up s | iterations | solve s ({device}) | blocks MB |
|---|---|---|---|---|---|---|---|---|
"""


def row(edge_m: float, nu: float, device: str) -> tuple[int, str]:
    """Unknowns and the table's line."""
    material = dataclasses.replace(preset("ecoflex_00-10"), bulk_Pa=bulk_from_poisson(nu, 12.5e3))
    mesh = extrude(disc_patch(0.06, 0.02, edge_m, 2.0 * edge_m, 0.02), np.array([0.0, 0.2, 0.5, 1.0]))
    system = assemble(mesh, material, side="roller")
    solver = SkinSolver(system, STEP)
    force = np.random.default_rng(1).normal(size=system.ndof)
    begin = time.perf_counter()
    for _ in range(5):
        exact = solver.factor.solve(force)
    direct = (time.perf_counter() - begin) / 5
    begin = time.perf_counter()
    linear = Pcg(solver.scheme.effective, system, device)
    linear.solve(force)
    wp.synchronize()
    made = time.perf_counter() - begin
    begin = time.perf_counter()
    found = linear.solve(force)
    wp.synchronize()
    iterative = time.perf_counter() - begin
    assert np.abs(found - exact).max() < 1e-4 * np.abs(exact).max()
    megabytes = 12e-6 * solver.factor.lu.nnz
    return system.ndof, (
        f"| {nu:g} | {system.ndof} | {solver.factor_seconds:.2f} | {direct:.4f} | {megabytes:.0f} | {made:.1f} | "
        f"{linear.iterations} | {iterative:.4f} | {linear.schwarz.bytes / 1e6:.0f} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--largest", type=int, default=60_000)
    parser.add_argument("--out", type=Path, default=Path("docs/bench/skin_linear.md"))
    options = parser.parse_args()
    lines = []
    for nu in (0.495, 0.4999):
        for edge in (0.012, 0.008, 0.006, 0.0045, 0.0033):
            unknowns, line = row(edge, nu, options.device)
            print(line, flush=True)
            lines.append(line)
            if unknowns > 0.6 * options.largest:
                break
    machine = f"{platform.processor() or platform.machine()}, one thread"
    options.out.write_text(HEAD.format(machine=machine, device=options.device) + "\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
