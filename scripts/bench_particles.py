"""Measure error and cost of the particles relative to the exact layer; writes docs/bench/skin_particles.md.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python scripts/bench_particles.py [--device cuda:0] [--out FILE]

The reference disc is 120 x 20 mm of Ecoflex 00-10 (nu 0.495), bonded below, roller sides, under a Gaussian spot of 10.3
mm. Its exact motion is the Fourier series of the load over 2 s, times the exact response of the layer.
"""

import argparse
import dataclasses
import platform
import time
from pathlib import Path

import numpy as np
from scipy.sparse.linalg import LinearOperator, cg

from palmfield.skin.analytic.layer_oracle import centre_response
from palmfield.skin.materials.catalogue import PRESETS
from palmfield.skin.materials.material import Material, Sheet, bulk_from_poisson
from palmfield.skin.problem import GAUSSIAN, Slab, Spot
from palmfield.skin.solvers.particles.cloud import Cloud, build_cloud
from palmfield.skin.solvers.particles.resolution import law_error
from palmfield.skin.solvers.particles.run import Particles
from palmfield.skin.solvers.particles.solve import run_particles
from palmfield.types import Float

ROOT = Path(__file__).resolve().parent.parent
MATERIAL = PRESETS["ecoflex_00-10"]
WIDTH, DEPTH, RADIUS, LASTS = 0.0103, 0.02, 0.06, 0.1
PERIOD, SAMPLES, HIGHEST_HZ = 2.0, 40000, 2000.0
AT = np.array([[0.0, 0.0], [0.01, 0.0]])
SPACINGS_MM = (7.0, 5.0, 4.0, 10.0 / 3.0, 2.5, 2.0)
# Spot width, depth [m], nu: from deep to thin, and from compressible to nearly not.
STATIC = (
    (0.0103, 0.010, 0.30),
    (0.0103, 0.010, 0.495),
    (0.0103, 0.020, 0.495),
    (0.0103, 0.005, 0.495),
    (0.0103, 0.002, 0.495),
    (0.0103, 0.010, 0.499),
)


def ramp(t: Float) -> Float:
    """Return a raised-cosine ramp of 1 ms, then 1."""
    return 0.5 * (1.0 - np.cos(np.pi * np.clip(t / 1e-3, 0.0, 1.0)))


def modulated(t: Float) -> Float:
    return 0.5 * (1.0 + np.sin(2.0 * np.pi * 200.0 * t))


def exact_motion() -> tuple[Float, dict[str, Float]]:
    """Return times [s] and exact displacement per pascal [m/Pa] at AT by load, each on for a quarter period."""
    times = np.arange(SAMPLES) * PERIOD / SAMPLES
    on = times < 0.25 * PERIOD
    count = round(HIGHEST_HZ * PERIOD)
    response = np.array([centre_response(k / PERIOD, MATERIAL, DEPTH, WIDTH, RADIUS, AT[:, 0]) for k in range(count)])
    loads = {"ramp": ramp(times) - ramp(times - 0.25 * PERIOD), "AM": modulated(times) * on}
    loads["AM"][[0, int(0.25 * SAMPLES)]] = 0.25
    found = {}
    for name, load in loads.items():
        spectrum = np.zeros((SAMPLES // 2 + 1, len(AT)), dtype=complex)
        spectrum[:count] = np.fft.rfft(load)[:count, None] * np.conj(response)
        found[name] = np.fft.irfft(spectrum, SAMPLES, axis=0)
    return times, found


def motion_rows(device: str) -> list[str]:
    times, exact = exact_motion()
    requested = times[: round(LASTS / PERIOD * SAMPLES)][::2]
    fine = np.arange(0.0, LASTS, 5e-5)
    loads = {"ramp": Spot(WIDTH, fine, ramp(fine)), "AM": Spot(WIDTH, fine, modulated(fine))}
    body = Slab((Sheet(MATERIAL, DEPTH),), "disc", "bonded", "roller", radius_m=RADIUS)
    rows = []
    for spacing_mm in SPACINGS_MM:
        cloud = build_cloud(body, spacing_mm * 1e-3)
        cells = [f"{spacing_mm:.3g}", str(len(cloud.points))]
        for name, load in loads.items():
            begin, wall = time.process_time(), time.perf_counter()
            _, u, _, step = run_particles(cloud, load, requested, AT, device=device)
            seconds = time.process_time() - begin if device == "cpu" else time.perf_counter() - wall
            right = exact[name][: 2 * len(requested) : 2]
            error = np.linalg.norm(-u[..., 2] - right, axis=0) / np.linalg.norm(right, axis=0)
            law = law_error(body, load, cloud.columns.spacing_m)
            cells += [f"{100 * error[0]:.2f} %", f"{100 * error[1]:.2f} %", f"{100 * law:.1f} %"]
        cells += [f"{1e6 * step:.1f}", f"{seconds:.2f}", f"{1e6 * seconds / (LASTS / step) / len(cloud.points):.2f}"]
        rows.append("| " + " | ".join(cells) + " |")
        print(rows[-1], flush=True)
    return rows


def static_push(cloud: Cloud, width: float) -> Float:
    """Return the static displacement of particles of the face under 1 Pa [m].

    It uses conjugate gradients on the forces of the particles.
    """
    body = Particles(cloud, "cpu")
    face = cloud.columns.face
    force = np.zeros_like(cloud.points)
    force[: len(face)] = -np.exp(-GAUSSIAN * (face[:, :2] ** 2).sum(axis=1) / width**2)[:, None] * cloud.face_area
    small = 1e-11

    def product(x: Float) -> Float:
        u = np.einsum("nij,nj->ni", cloud.free, x.reshape(-1, 3))
        size = np.abs(u).max() / small
        body.displacement.assign((u / size).astype(np.float32))
        return -size * np.einsum("nij,nj->ni", cloud.free, body.net_forces()).ravel()

    count = force.size
    operator = LinearOperator((count, count), matvec=product, dtype=np.float64)
    right = np.einsum("nij,nj->ni", cloud.free, force).ravel()
    u, left = cg(operator, right, rtol=1e-4, maxiter=4000)
    if left != 0:
        raise RuntimeError(f"conjugate gradients stopped after {left} products")
    return -u.reshape(-1, 3)[: len(face), 2]


def static_rows() -> list[str]:
    rows = []
    elastic = dataclasses.replace(MATERIAL, branches=())
    for width, depth, nu in STATIC:
        material: Material = dataclasses.replace(elastic, bulk_Pa=bulk_from_poisson(nu, elastic.shear_relaxed_Pa))
        radius = 2.0 * width
        body = Slab((Sheet(material, depth),), "disc", "bonded", "roller", radius_m=radius)
        cells = [f"{1e3 * width:g}", f"{1e3 * depth:g}", f"{nu:g}"]
        for per_width in (3, 4, 6, 8):
            cloud = build_cloud(body, width / per_width)
            r = np.hypot(*cloud.columns.face[:, :2].T)
            near = r < width
            exact = centre_response(0.0, material, depth, width, radius, r[near]).real
            area = cloud.face_area[near, 2]
            miss = static_push(cloud, width)[near] - exact
            error = np.sqrt((area * miss**2).sum() / (area * exact**2).sum())
            law = law_error(body, Spot(width, np.zeros(1), np.ones(1)), cloud.columns.spacing_m)
            cells.append(f"{100 * error:.2f} % ({100 * law:.1f} %)")
        rows.append("| " + " | ".join(cells) + " |")
        print(rows[-1], flush=True)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "bench" / "skin_particles.md")
    arguments = parser.parse_args()
    clock = "processor time of one run on one core" if arguments.device == "cpu" else "time of one run"
    text = f"""# Solver `particles`: time and error

For developers of solvers. Command:
`OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python scripts/bench_particles.py --device {arguments.device}`
Device: {arguments.device}; machine: {platform.processor() or platform.machine()}, one thread.

The disc of Ecoflex 00-10 (nu 0.495) has a diameter of 120 mm and a height of 20 mm. Its base is bonded, and its sides
are on rollers. A spot of 10.3 mm acts for {LASTS:g} s, from rest. Errors are relative L2 errors over time, at the
centre and 10 mm off, compared with the exact layer. "Law" is `law_error`, the error that the solver predicts. The cost
is the {clock}. It includes the search for the stable step.

| spacing [mm] | particles | ramp: centre | 10 mm | law | AM: centre | 10 mm | law | step [us] | cost [s] | cost per \
particle and step [us] |
|---|---|---|---|---|---|---|---|---|---|---|
{chr(10).join(motion_rows(arguments.device))}

The next table has the error of the static displacement, with "law" in brackets. It is the relative L2 error by area,
over the points up to one width of the spot from the axis. The disc has a radius of two widths of the spot. In each
column, the spacing of the particles is a share of this width:

| spot [mm] | depth [mm] | nu | width / 3 | width / 4 | width / 6 | width / 8 |
|---|---|---|---|---|---|---|
{chr(10).join(static_rows())}
"""
    arguments.out.write_text(text)


if __name__ == "__main__":
    main()
