"""Run boundary elements on spheres, a finger, a sheet and a hand; writes docs/bench/scattering.md and pictures.

    python scripts/bench_scattering.py [--device cuda:0] [--hand] [--commit HASH] [--out FILE]

--hand adds the whole open hand (100 k elements: seconds on a GPU, some minutes on two CPU cores). Pictures are written
to docs/images/scattering for the default file, else to the folder of the file.
"""

import argparse
import os
import sys
import time
import warnings
from pathlib import Path

import numpy as np
import warp as wp
from _scattering_bodies import FOCUS, Body, cupped, draw_bodies, draw_spheres, finger, front, palm, turned, whole_hand
from scipy.spatial import cKDTree

from palmfield.acoustics.air import density, sound_speed
from palmfield.acoustics.arp import arp
from palmfield.acoustics.arrays import layout
from palmfield.acoustics.field import FieldEvaluator
from palmfield.acoustics.focus import focus
from palmfield.acoustics.langevin import radiation_force
from palmfield.acoustics.scattering import DoubleLayer, Scattering, scatter, wall_arp
from palmfield.acoustics.shadow import shadow_mesh
from palmfield.device import resolve
from palmfield.hand.triangles import face_normals, vertex_normals
from palmfield.instruments.microphone import surface_pressure
from palmfield.studies.bench.field import device_name, git_commit
from palmfield.studies.bench.table import cells, keep_rows, processor
from palmfield.types import Air, Field, Float, Surface

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "oracles"))

from rigid_sphere import force_over_energy, geodesic
from scattered_sound import array_sound, scattered_field, wall_force
from shadow_rays import lit, shadowed_pressure

ROOT = Path(__file__).resolve().parents[1]
AIR = Air()
FREQUENCY_HZ = 40e3
K = 2 * np.pi * FREQUENCY_HZ / sound_speed(AIR)
ENERGY = 1.0 / (2 * density(AIR) * sound_speed(AIR) ** 2)

SPHERES = [(1.0, 6), (np.pi, 6), (3.0, 6), (5.9, 9), (10.0, 15), (30.0, 46)]
"""ka and divisions of the geodesic mesh (20 divisions^2 triangles); for ka = 1 and pi the least for the shape."""


LARGEST_FOR_FAR_FORCE = 30_000
"""Number of elements above which the check through a far sphere takes minutes on a CPU."""


class Memory:
    """Peak memory: memory that a block of work adds to the process on the CPU, or maximum of Warp's pool on a GPU."""

    def __init__(self, device: str) -> None:
        self.device = device

    def start(self) -> None:
        if self.device == "cpu":
            Path("/proc/self/clear_refs").write_text("5")
            self.before = self._status("VmRSS")

    def MB(self) -> float:
        if self.device == "cpu":
            return (self._status("VmHWM") - self.before) / 1e6
        return wp.get_mempool_used_mem_high(self.device) / 1e6

    @staticmethod
    def _status(key: str) -> int:
        lines = Path("/proc/self/status").read_text().splitlines()
        return 1024 * int(next(line for line in lines if line.startswith(key)).split()[1])


def timed(body: Body, device: str, memory: Memory, sound) -> tuple[Scattering, float, float]:
    """Return solution, seconds and MB, after a first solution on a small sphere that compiles the kernels."""
    memory.start()
    start = time.perf_counter()
    found = scatter(body.vertices, body.faces, sound, K, device=device)
    return found, time.perf_counter() - start, memory.MB()


def plane_wave(points: Float) -> np.ndarray:
    return np.exp(1j * K * points[:, 2])


def sphere(ka: float, divisions: int, device: str) -> tuple[Scattering, float]:
    """Return the solution and the relative L2 error of its surface pressure."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # the refinement study goes below six a wavelength
        found = scatter(*geodesic(ka / K, divisions), plane_wave, K, device=device)
    return found, sphere_error(found, found.pressure, ka)


def sphere_error(found: Scattering, pressure: np.ndarray, ka: float) -> float:
    exact = surface_pressure(ka, found.centroids[:, 2] / np.linalg.norm(found.centroids, axis=1))
    return float(np.sqrt(found.areas @ np.abs(pressure - exact) ** 2 / (found.areas @ np.abs(exact) ** 2)))


def outer_surface_alone(found: Scattering, device: str) -> np.ndarray:
    """Return the pressure by the equation on the outer surface only, with a dense matrix."""
    layer = DoubleLayer(found.centroids, found.vertices, found.faces, K, device, np.arange(len(found.faces)))
    units = np.eye(len(found.faces))
    matrix = 0.5 * units - np.stack([layer.apply(unit) for unit in units], axis=1)
    return np.linalg.solve(matrix, plane_wave(found.centroids))


def sphere_rows(device: str, memory: Memory) -> list[str]:
    rows = []
    for ka, divisions in SPHERES:
        body = Body("sphere", "", *geodesic(ka / K, divisions), 0.0)
        found, seconds, size = timed(body, device, memory, plane_wave)
        force = wall_force(found, AIR)[2] / (np.pi * (ka / K) ** 2 * ENERGY)
        known = force_over_energy(ka)
        rows.append(
            f"| {ka:.3g} | {len(body.faces)} | {found.elements_per_wavelength:.1f} | "
            f"{100 * sphere_error(found, found.pressure, ka):.2f} % | {force:.4f} | {known:.4f} | "
            f"{100 * (force / known - 1):+.2f} % | {found.iterations} | {seconds:.2f} | {size:.0f} |"
        )
        print(rows[-1], flush=True)
    return rows


def sphere_pictures(path: Path, device: str) -> None:
    found, _ = sphere(10.0, 15, device)
    cosine = found.centroids[:, 2] / np.linalg.norm(found.centroids, axis=1)
    angle = np.degrees(np.arccos(cosine)), np.abs(found.pressure), np.abs(surface_pressure(10.0, cosine))
    refined = [(s.elements_per_wavelength, e) for n in (5, 7, 9, 13, 18) for s, e in [sphere(6.0, n, device)]]
    sweep = []
    for ka in np.arange(3.0, 7.001, 0.025):
        small, error = sphere(ka, 5, device)
        sweep.append((ka, error, sphere_error(small, outer_surface_alone(small, device), ka)))
    draw_spheres(path, angle, tuple(np.array(refined).T), tuple(np.array(sweep).T))


def smoothed(centroids: Float, areas: Float, values: Float, radius_m: float) -> Float:
    """Return the mean over the faces within a radius, weighted by area."""
    near = cKDTree(centroids).query_ball_point(centroids, radius_m)
    return np.array([areas[i] @ values[i] / areas[i].sum() for i in near])


def far_force(found: Scattering, incident: FieldEvaluator, drive: np.ndarray, device: str) -> Float:
    """Return the radiation force [N] from the momentum through a sphere around the body.

    The sphere has four triangles per wavelength.
    """
    low, high = found.vertices.min(axis=0), found.vertices.max(axis=0)
    radius = 0.5 * float(np.linalg.norm(high - low)) + 6e-3
    vertices, faces = geodesic(radius, round(1.1 * radius / (np.pi / (2.0 * K))))
    vertices = vertices + 0.5 * (low + high)
    normals, areas = face_normals(vertices, faces)
    points = vertices[faces].mean(axis=1)
    added = scattered_field(found, points, gradient=True, device=device)
    alone = incident.pressure(points, drive, gradient=True)
    assert added.gradient is not None
    assert alone.gradient is not None
    total = Field(added.pressure + alone.pressure, added.gradient + alone.gradient)
    return radiation_force(total, normals, areas, AIR, FREQUENCY_HZ)


def compare(body: Body, device: str, memory: Memory) -> tuple[list[str], str, np.ndarray, dict[str, Float]]:
    """Return rows of the models relative to boundary elements, a row of cost, the compared faces, and each ARP."""
    array = layout("uhev1")
    drive = focus(array, AIR, FOCUS)
    found, seconds, size = timed(body, device, memory, array_sound(array, drive, AIR, device, absorption_Np_m=0.0))
    normals, areas = face_normals(body.vertices, body.faces)
    centroids = found.centroids
    surface = Surface(body.vertices, body.faces, vertex_normals(body.vertices, body.faces))
    start = time.perf_counter()
    evaluator = FieldEvaluator(array, AIR, device, absorption_Np_m=0.0)
    incident = evaluator.pressure(centroids, drive, gradient=True)
    plain = arp(incident, normals, AIR, FREQUENCY_HZ, device=device)
    plain_s = time.perf_counter() - start
    start = time.perf_counter()
    mesh = shadow_mesh(surface, device)
    assert incident.gradient is not None
    flux = np.imag(incident.pressure.conj()[:, None] * incident.gradient)  # Re(p u*) times 2 w rho
    rays = np.where(lit(centroids, flux, mesh), plain, 0.0)
    rays_s = time.perf_counter() - start + plain_s
    start = time.perf_counter()
    part = shadowed_pressure(centroids, normals, mesh, array, drive, AIR, absorption_Np_m=0.0)
    shaded = arp(part, normals, AIR, FREQUENCY_HZ, device=device)
    shaded_s = time.perf_counter() - start
    pressed = {
        "boundary elements": wall_arp(found, AIR),
        "seen transducers": shaded.astype(float),
        "one ray": rays.astype(float),
        "no shadow": plain.astype(float),
    }
    look = front(body, normals)
    spot = look & (np.linalg.norm(centroids - FOCUS, axis=1) < 0.01)
    true = pressed["boundary elements"]
    half_wave = np.pi / K
    mean_true = smoothed(centroids[look], areas[look], true[look], half_wave)
    rows = []
    for (model, values), model_s in zip(pressed.items(), (seconds, shaded_s, rays_s, plain_s), strict=True):
        rough = np.sqrt(areas[look] @ (values - true)[look] ** 2 / (areas[look] @ true[look] ** 2))
        mean = smoothed(centroids[look], areas[look], values[look], half_wave)
        fine = np.sqrt(areas[look] @ (mean - mean_true) ** 2 / (areas[look] @ mean_true**2))
        at_spot = -1e3 * (areas * values * normals[:, 2])[spot].sum()
        total = -1e3 * (areas * values) @ normals
        rows.append(
            f"| {body.name} | {model} | {values[look].max():.1f} | {100 * rough:.0f} % | {100 * fine:.0f} % | "
            f"{at_spot:.3f} | {total[2]:.3f} | {np.hypot(*total[:2]):.3f} | {model_s:.2f} |"
        )
        print(rows[-1], flush=True)
    affordable = device != "cpu" or len(body.faces) < LARGEST_FOR_FAR_FORCE
    far = f"{1e3 * far_force(found, evaluator, drive, device)[2]:.3f}" if affordable else "-"
    cost = (
        f"| {body.name}: {body.what} | {len(body.faces)} | {found.elements_per_wavelength:.1f} | {found.iterations} | "
        f"{found.residual:.1e} | {1e3 * wall_force(found, AIR)[2]:.3f} | {far} | {seconds:.1f} | {size:.0f} |"
    )
    print(cost, flush=True)
    return rows, cost, look, pressed


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--hand", action="store_true", help="also the whole open hand")
    parser.add_argument("--commit", help="what to print as the commit, where there is no git")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "bench" / "scattering.md")
    options = parser.parse_args()
    wp.config.log_level = wp.LOG_WARNING
    device = resolve(options.device)
    at_home = options.out.resolve() == ROOT / "docs" / "bench" / "scattering.md"
    pictures = ROOT / "docs" / "images" / "scattering" if at_home else options.out.resolve().parent
    pictures.mkdir(parents=True, exist_ok=True)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    memory = Memory(device)
    sphere(1.0, 4, device)

    spheres = sphere_rows(device, memory)
    sphere_pictures(pictures / "spheres.png", device)
    hand = whole_hand()
    bodies = [finger(hand), cupped(), turned(cupped(), 60.0)] + ([palm(hand)] if options.hand else [])
    rows, costs, visible, pressed = [], [], {}, {}
    for body in bodies:
        lines, cost, visible[body.name], pressed[body.name] = compare(body, device, memory)
        rows += lines
        costs.append(cost)
    draw_bodies(pictures / "bodies.png", bodies, visible, pressed)
    prefix = "../images/scattering/" if at_home else ""
    options.out.write_text(
        REPORT.format(
            command=f"python scripts/bench_scattering.py --device {options.device}{' --hand' if options.hand else ''}",
            machine=device_name(device) if device != "cpu" else f"{processor()}, {os.cpu_count()} cores",
            warp=wp.config.version,
            commit=options.commit or git_commit(),
            p0=layout("uhev1").p0_Pa_m,
            spheres="\n".join(spheres),
            costs="\n".join(costs),
            rows="\n".join(f"| {' | '.join(cells(row)[i] for i in (0, 1, 2, 3, 4, 6, 8))} |" for row in rows),
            link=keep_rows(options.out, [ALL, "", *rows]),
            images=prefix,
        )
    )
    print(options.out.read_text())


ALL = "| body | model | peak, Pa | L2 | L2 of the mean | spot | up | sideways | s |"
REPORT = """# Scattering by boundary elements, and the errors of cheaper models

`{command}`, {machine}, Warp {warp}, commit {commit}. 40 kHz, 20 C.
"Edges per wavelength" is the wavelength divided by the mean edge. Times are those of whole calls of `scatter`. Memory
is the peak that the call adds. GMRES stops at a residual of 1e-4.

## Rigid sphere in a plane wave

The error is the relative L2 difference of the surface pressure from the series. The force is computed from the wall
pressure, and divided by pi a^2 E. For ka = 1, 3 and pi, the shape of the sphere needs a finer mesh than the wavelength.

| ka | elements | edges per wavelength | error | force | series | difference | iterations | s | MB |
|---|---|---|---|---|---|---|---|---|---|
{spheres}

![spheres]({images}spheres.png)

## Bodies before the array

Array uhev1 at full drive with p0 = {p0:g} Pa m in lossless air, focused on the skin, 200 mm above its middle.

"Up" is the force from the wall pressure. "Far" is the force from the momentum through a sphere around the body. Use
"far" for bodies with sharp rims, where the velocity along the surface is singular.

| body | elements | edges per wavelength | iterations | residual | up, mN | far, mN | s | MB |
|---|---|---|---|---|---|---|---|---|
{costs}

The next table compares the ARP of cheaper models with boundary elements, on faces that face the array within 60 mm of
the focus. The models use the default ARP law, and differ in the rule for lit faces: each transducer lights the faces
that it sees; a face is lit if a ray back along the energy flux is free; or each face is lit ("no shadow"). L2 is the
relative difference by face. "L2 of the mean" is the relative difference of means over half a wavelength. "Up" is the
force on the body ({link} has more forces).

| body | model | peak, Pa | L2 | L2 of the mean | up, mN | s |
|---|---|---|---|---|---|---|
{rows}

![bodies]({images}bodies.png)
"""


if __name__ == "__main__":
    main()
