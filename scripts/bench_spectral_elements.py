"""Measure time and error of solver spectral_elements: the reference disc, a fast focus, the layer of a hand.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python scripts/bench_spectral_elements.py [--device cuda:0] [--out FILE]

Errors of the disc with roller sides and of the infinite slab are relative to the exact layer
(palmfield/skin/analytic/layer_oracle.py) through its frequency response. Those of fixed and free sides and of the fast
focus are relative to a finer run of the same solver, and those of the layer of a hand to a reduced model at 2 %. Times
include meshing and, on the disc, the coarser run that estimates the error, but no compilation of kernels.
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import warp as wp

from palmfield.device import resolve
from palmfield.hand.patch import surface_patch
from palmfield.hand.preset import load_preset
from palmfield.hand.surface import hand_surface
from palmfield.skin.analytic.layer_oracle import centre_response
from palmfield.skin.materials.catalogue import preset
from palmfield.skin.materials.material import Material, Sheet, bulk_from_poisson
from palmfield.skin.problem import Layer, SkinProblem, Slab, Spot
from palmfield.skin.solver_choice import solve
from palmfield.skin.solvers.spectral_elements.solve import solve_spectral_elements
from palmfield.studies.bench.table import processor

ROOT = Path(__file__).resolve().parents[1]
SPOT, DEPTH, RADIUS, END = 0.0103, 0.02, 0.06, 0.2
PLACES = np.array([[0.0, 0.0], [0.01, 0.0]])
ECOFLEX = preset("ecoflex_00-10")


def courses() -> dict[str, Spot]:
    grid = np.arange(0.0, END + 1e-9, 5e-5)
    ramp = np.where(grid < 1e-3, 0.5 - 0.5 * np.cos(np.pi * grid / 1e-3), 1.0)
    modulated = 0.5 * (1.0 + np.sin(2.0 * np.pi * 200.0 * grid))
    turn = 2.0 * np.pi * 70.0 * grid
    circle = 0.01 * np.column_stack([np.cos(turn), np.sin(turn)])
    return {
        "ramp": Spot(SPOT, grid, ramp),
        "AM 200 Hz": Spot(SPOT, grid, modulated),
        "STM 70 Hz": Spot(SPOT, grid, np.ones_like(grid), circle),
    }


def exact(course: Spot, times: np.ndarray, radius: float | None) -> np.ndarray:
    """Return the exact displacement into the layer at PLACES, (t, 2), of a fixed spot that is switched off at END.

    The period of 0.6 s includes 0.4 s of decay; the part of a jump above 4 kHz is omitted.
    """
    period, top, step = 0.6, 4000.0, 5e-5
    count = round(period / step)
    grid = step * np.arange(count)
    # The mean of both sides where the course jumps
    values = np.interp(grid, course.times_s, course.peak_Pa, right=0.0)
    values[0] *= 0.5
    spectrum = np.fft.rfft(values)
    responses = np.zeros((len(spectrum), len(PLACES)), dtype=complex)
    for index in range(round(top * period)):
        responses[index] = centre_response(index / period, ECOFLEX, DEPTH, SPOT, radius, PLACES[:, 0]).conj()
    series = np.fft.irfft(spectrum[:, None] * responses, n=count, axis=0)
    return np.stack([np.interp(times, grid, column) for column in series.T], axis=1)


def timed(problem: SkinProblem, **keywords):
    """Return a solution, after a step or two of the same problem that compile the kernels."""
    solve_spectral_elements(replace(problem, times=problem.load.times_s[:1] + 1e-4), **keywords)
    return solve_spectral_elements(problem, **keywords)


def gap(found: np.ndarray, reference: np.ndarray) -> float:
    return float((np.linalg.norm(found - reference, axis=0) / np.linalg.norm(reference, axis=0)).max())


def disc_rows(device: str) -> list[str]:
    times = np.arange(1, 1001) * 2e-4
    sheets = (Sheet(ECOFLEX, DEPTH),)
    bodies = {side: Slab(sheets, "disc", "bonded", side, radius_m=RADIUS) for side in ("roller", "fixed", "free")} | {
        "endless": Slab(sheets)
    }
    rows = []
    for side, body in bodies.items():
        for name, course in courses().items():
            motion = timed(SkinProblem(body, course, times, PLACES, accuracy=0.02, device=device))
            if side in ("roller", "endless") and name != "STM 70 Hz":
                reference = exact(course, times, RADIUS if side == "roller" else None)
            else:
                reference = -solve_spectral_elements(
                    SkinProblem(body, course, times, PLACES, device=device),
                    order=4,
                    size_m=0.0067,
                    deep=(3,),
                    estimate=False,
                ).displacement_m[:, :, 2]
            error = gap(-motion.displacement_m[:, :, 2], reference)
            rows.append(
                f"| {side} | {name} | {motion.seconds:.2f} | {100 * error:.2f} % | {100 * motion.error:.2f} % "
                f"| {motion.solver.removeprefix('spectral_elements, ')} |"
            )
    return rows


def fast_rows(device: str, sizes: dict[int, tuple[float, ...]]) -> list[str]:
    """Measure a focus at 7 m/s over an infinite plate of 10 mm: the normal velocity at the end of its path."""
    rows = []
    grid = np.array([0.0, 0.16 / 7.0])
    load = Spot(0.006, grid, np.ones(2), np.array([[-0.08, 0.0], [0.08, 0.0]]))
    x, y = (a.ravel() for a in np.meshgrid(np.arange(-0.1, 0.1001, 0.002), np.arange(-0.04, 0.0401, 0.002)))
    at = np.column_stack([x, y])
    shear = 23087.5
    plate = Material("plate", 923.5, shear, (), bulk_from_poisson(0.495, shear), "Reardon et al. 2023", 0.0202, True)
    for base in ("bonded", "free"):
        body = Slab((Sheet(plate, 0.01),), base=base)
        finest = None
        for order, widths in sizes.items():
            for width in widths:
                motion = timed(
                    SkinProblem(body, load, grid[1:], at, device=device), order=order, size_m=width, estimate=False
                )
                speed = motion.velocity_m_s[0, :, 2]
                finest = speed if finest is None else finest
                error = float(np.linalg.norm(speed - finest) / np.linalg.norm(finest))
                text = "reference" if speed is finest else f"{100 * error:.2f} %"
                rows.append(
                    f"| {base} | {motion.solver.removeprefix('spectral_elements, ')} | {motion.seconds:.2f} | {text} |"
                )
    return rows


def hand_rows(device: str) -> list[str]:
    """Measure palmar skin of 2 mm, AM 200 Hz from rest to END, at 5 %, as `solve` does it; the median of three."""
    skin = hand_surface(load_preset("open_men_p50"))
    patch = surface_patch(
        skin.surface, 0.002, np.zeros(3), 0.045, 0.0018, 0.0018, 0.045, max_depth_m=0.002, max_fraction=1.0
    )
    body = Layer(patch, (Sheet(preset("finger_pad"), 0.002),))
    grid = np.arange(0.0, END + 1e-9, 5e-5)
    middle = patch.vertices[int(np.argmin(np.linalg.norm(patch.vertices[:, :2], axis=1)))]
    at = middle + np.array([[0.0, 0.0, 0.0], [0.5 * SPOT, 0.0, 0.0]])
    load = Spot(SPOT, grid, 0.5 * (1.0 + np.sin(2.0 * np.pi * 200.0 * grid)), middle[:2])
    reference = solve(body, load, grid[1:], at, solver="reduced", accuracy=0.02, device="cpu")
    steppers = {"cpu": (("reduced", False), ("reduced", True), ("wedges", False))}
    rows = []
    for name, whole in steppers.get(device, (("spectral_elements", False), ("spectral_elements", True))):
        motions = []
        solve(body, load, grid[1:3], at, solver=name, accuracy=0.05, device=device, whole=whole)
        for _ in range(3):
            motions.append(solve(body, load, grid[1:], at, solver=name, accuracy=0.05, device=device, whole=whole))
            if motions[-1].seconds > 30.0:
                break
        error = gap(motions[-1].displacement_m[:, :, 2], reference.displacement_m[:, :, 2])
        seconds = float(np.median([motion.seconds for motion in motions]))
        rows.append(
            f"| {'whole patch' if whole else 'what the load reaches'} | {motions[-1].solver.split(' (')[0]} "
            f"| {seconds:.2f} | {100 * motions[-1].error:.2g} % | {100 * error:.2g} % |"
        )
    rows += ["", f"The reference: {reference.solver.split(' (')[0]}, its estimate {100 * reference.error:.2g} %."]
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "bench" / "skin_spectral_elements.md")
    parser.add_argument("--cases", default="disc,hand", help="any of disc, fast, hand")
    arguments = parser.parse_args()
    device = resolve(arguments.device)
    gpu = device != "cpu"
    where = wp.get_device(device).name if gpu else f"{processor()}, one core"
    lines = [
        "# Spectral elements: time and error",
        "",
        f"For developers of solvers. `python scripts/bench_spectral_elements.py --device {arguments.device} --cases "
        f"{arguments.cases}`, {where}, Warp {wp.__version__}. Times include meshing and, for the disc, the coarser run "
        "for the estimate.",
    ]
    begun = time.perf_counter()
    if "disc" in arguments.cases:
        lines += [
            "",
            "## The reference disc",
            "",
            "There are two bonded bodies of Ecoflex 00-10: a disc with a diameter of 120 mm and a height of 20 mm, and "
            f'an infinite slab ("endless" in the table). A spot of {1e3 * SPOT:g} mm acts for {END} s. The target '
            "accuracy is 0.02. The error is that of the worse of two points: the centre and 10 mm off. The disc with "
            "roller sides and the slab are compared with the exact frequency response. Discs with other sides, and all "
            "cases of STM, are compared with elements of 6.7 mm.",
            "",
            "| side | load | seconds | error | estimate | elements |",
            "|---|---|---|---|---|---|",
            *disc_rows(device),
        ]
    if "fast" in arguments.cases:
        sizes = {5: (0.0025,), 4: (0.0025, 0.004), 2: (0.002,)}
        lines += [
            "",
            "## A focus at 7 m/s",
            "",
            "An infinite plate is 10 mm thick and has a density of 923.5 kg/m3, a shear modulus of 23087.5 Pa, a "
            "Kelvin-Voigt viscosity of 0.0202 Pa s in shear and volume, and nu 0.495. A spot of 6 mm moves from -80 to "
            "80 mm. The difference is that of the normal velocity at the end, on 200 x 80 mm.",
            "",
            "| base | elements | seconds | difference |",
            "|---|---|---|---|",
            *fast_rows(device, sizes if gpu else {4: (0.004, 0.006), 2: (0.003,)}),
        ]
    if "hand" in arguments.cases:
        lines += [
            "",
            "## The layer of a hand",
            "",
            "The layer is 2 mm of palmar skin (radius 45 mm) with the finger-pad material. It is bonded, and under AM "
            f"of 200 Hz for {END} s. The target accuracy of `palmfield.skin.solve` is 5 %. The mesh has triangles of "
            "1.8 mm, and 40 k hexahedra in three rows. Times are medians of three solutions. The error is that of the "
            "worse of two points: the middle of the spot and half a width off.",
            "",
            "| part of the layer | solver | time [s] | estimate | error |",
            "|---|---|---|---|---|",
            *hand_rows(device),
        ]
    lines += ["", f"The whole computation took {time.perf_counter() - begun:.0f} s.", ""]
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    arguments.out.write_text("\n".join(lines))
    print("\n".join(lines))


if __name__ == "__main__":
    main()
