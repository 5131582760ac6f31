"""Disc by harmonics and the reduced model: cost and error. Writes docs/bench/skin_axisymmetric.md.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python scripts/bench_axisymmetric.py [--quick]

The disc is 120 x 20 mm of Ecoflex 00-10, bonded below, under a Gaussian spot of 10.3 mm full width, 0.2 s, evaluated at
the centre and at r = 10 mm, where the circling spot starts. `--quick` omits the random cases.
"""

import os
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
from scipy.sparse import csr_matrix

from palmfield.skin.analytic.layer_oracle import centre_response
from palmfield.skin.fem.assembly import assemble
from palmfield.skin.fem.load import SurfaceQuadrature
from palmfield.skin.fem.probe import SurfaceProbe
from palmfield.skin.fem.solver import harmonic, static
from palmfield.skin.fem.wedge_stepper import WedgeStepper
from palmfield.skin.materials.catalogue import preset
from palmfield.skin.materials.material import Sheet
from palmfield.skin.mesh.disc import disc_patch
from palmfield.skin.mesh.wedges import extrude
from palmfield.skin.problem import Motion, SkinProblem, Slab, Spot
from palmfield.skin.reduction.reduced import Reduced
from palmfield.skin.reduction.reducer import reduce
from palmfield.skin.solvers.axisymmetric.solve import cost_axisymmetric, solve_axisymmetric
from palmfield.skin.stepper import SurfaceLoads
from palmfield.studies.bench.field import git_commit
from palmfield.studies.bench.table import keep_rows, processor, ranged

ROOT = Path(__file__).resolve().parent.parent
ECOFLEX = preset("ecoflex_00-10")
FWHM, DEPTH, RADIUS = 0.0103, 0.02, 0.06
TIMES = np.linspace(0.0, 0.2, 2001)
POINTS = np.array([[0.0, 0.0], [0.01, 0.0]])
SIDES = ("fixed", "free", "roller")


def disc(side: str) -> Slab:
    return Slab((Sheet(ECOFLEX, DEPTH),), shape="disc", radius_m=RADIUS, side=side)


def loads() -> dict[str, Spot]:
    ramp = np.linspace(0.0, 1e-3, 101)
    fine = np.linspace(0.0, 0.2, 10001)
    circle = np.linspace(0.0, 0.2, 4001)
    turn = 2.0 * np.pi * 70.0 * circle
    return {
        "step (to static)": Spot(FWHM, np.zeros(1), np.ones(1), law="held"),
        "1 ms ramp": Spot(FWHM, ramp, 0.5 * (1.0 - np.cos(np.pi * ramp / 1e-3))),
        "AM 200 Hz": Spot(FWHM, fine, 0.5 * (1.0 + np.sin(2.0 * np.pi * 200.0 * fine))),
        "STM 70 Hz": Spot(FWHM, circle, np.ones(4001), 0.01 * np.stack([np.cos(turn), np.sin(turn)], axis=1)),
    }


def differs(motion: Motion, reference: Motion, field: str = "displacement_m") -> float:
    """Return the relative L2 difference over the times, that of the worst point."""
    found, exact = getattr(motion, field), getattr(reference, field)
    return float(np.max(np.sqrt(((found - exact) ** 2).sum(axis=(0, 2)) / (exact**2).sum(axis=(0, 2)))))


def case_rows(sides: tuple[str, ...]) -> list[str]:
    rows = []
    for side in sides:
        for name, load in loads().items():
            reference = solve_axisymmetric(SkinProblem(disc(side), load, TIMES, POINTS, accuracy=0.002), degree=7)
            begin = time.process_time()
            motion = solve_axisymmetric(SkinProblem(disc(side), load, TIMES, POINTS, accuracy=0.01))
            cpu = time.process_time() - begin
            predicted = cost_axisymmetric(SkinProblem(disc(side), load, TIMES, POINTS, 0.01))
            rows.append(
                f"| {side} | {name} | {100 * differs(motion, reference):.2f} % "
                f"| {100 * differs(motion, reference, 'velocity_m_s'):.1f} % | {100 * motion.error:.2f} % "
                f"| {motion.seconds:.1f} | {cpu:.1f} | {predicted:.1f} | {motion.solver} |"
            )
            print(rows[-1], flush=True)
    return rows


def oracle_row() -> str:
    """Compare steady AM at the end of 0.2 s on the disc with roller sides with the series, real and imaginary part."""
    load = loads()["AM 200 Hz"]
    motion = solve_axisymmetric(SkinProblem(disc("roller"), load, TIMES, POINTS, accuracy=0.002))
    last = TIMES > 0.18
    r = np.hypot(*POINTS.T)
    phase = np.exp(-2j * np.pi * 200.0 * TIMES[last])[:, None]
    still, moving = (centre_response(f, ECOFLEX, DEPTH, FWHM, RADIUS, at=r) for f in (0.0, 200.0))
    exact = 0.5 * still.real + 0.5 * (1j * moving * phase).real
    found = -motion.displacement_m[last, :, 2]
    return f"{100 * np.max(np.linalg.norm(found - exact, axis=0) / np.linalg.norm(exact, axis=0)):.3f} %"


def wedge(side: str, fine: float, layers: int):
    edges = np.concatenate([[0.0], np.cumsum(1.6 ** np.arange(layers))])
    mesh = extrude(disc_patch(RADIUS, DEPTH, fine, 2.5 * fine, 0.012), edges / edges[-1])
    system = assemble(mesh, ECOFLEX, side=side)
    quadrature = SurfaceQuadrature(mesh, system)
    force = quadrature.assemble(np.exp(-4 * np.log(2) * (quadrature.points[:, :2] ** 2).sum(axis=1) / FWHM**2))
    return system, force, -SurfaceProbe(mesh, np.column_stack([POINTS, np.zeros(2)]), system).operator


def wedge_rows() -> list[str]:
    """Compute the disc with 3-D wedges, for sides without a series."""
    rows = []
    load = loads()["1 ms ramp"]
    times = np.linspace(0.0, 0.02, 201)
    for side in SIDES:
        system, force, read = wedge(side, 0.006, 3)
        stepper = WedgeStepper(system, csr_matrix(force[:, None]), 1e-4)
        state = np.zeros((1, stepper.state_size))
        amplitude = np.interp(times, load.times_s, load.peak_Pa)[None, :, None]
        ramp = SurfaceLoads(np.ones((1, 1, 1)), amplitude[:, :-1], amplitude[:, 1:])
        after = stepper.step(state, ramp, times[0], times[-1], stepper.reader(read))
        computed = np.concatenate([np.zeros((1, 2)), after[0, :, 0]])
        motion = solve_axisymmetric(SkinProblem(disc(side), load, times, POINTS, accuracy=0.002))
        ours = -motion.displacement_m[..., 2]
        gap = np.linalg.norm(computed - ours, axis=0) / np.linalg.norm(ours, axis=0)
        late = -solve_axisymmetric(
            SkinProblem(disc(side), loads()["step (to static)"], np.ones(1), POINTS, accuracy=0.002)
        ).displacement_m
        still = (read @ static(system, force)) / late[0, :, 2] - 1.0
        rows.append(
            f"| {side} | {1e9 * late[0, 0, 2]:.2f} | {100 * still[0]:.2f} / {100 * still[1]:.2f} % "
            f"| {100 * gap[0]:.2f} / {100 * gap[1]:.2f} % "
            f"| {system.ndof} |"
        )
        print(rows[-1], flush=True)
    return rows


def reduced_rows() -> list[str]:
    rows = []
    for fine, layers, tolerances in ((0.008, 2, (1e-2, 1e-3, 1e-4)), (0.006, 3, (1e-3,))):
        system, force, read = wedge("fixed", fine, layers)
        stepper = WedgeStepper(system, csr_matrix(force[:, None]), 1e-4)
        state = np.zeros((1, stepper.state_size))
        full = seconds(partial(stepper.step, state, SurfaceLoads(*np.ones((3, 1, 1, 1))), 0.0, 1e-4), 20)
        for tolerance in tolerances:
            begin = time.perf_counter()
            model = reduce(system, force[:, None], read, (0.0, 600.0), tolerance, order=system.elimination_order())
            made = time.perf_counter() - begin
            rows.append(reduced_row(model, system, force, read, tolerance, full, made))
            print(rows[-1], flush=True)
    return rows


def reduced_row(model: Reduced, system, force, read, tolerance: float, full: float, made: float) -> str:
    small = model.new_state()
    one = np.ones(1)
    fast = seconds(lambda: model.step(small, one, one, 1e-4), 2000)
    errors = []
    for f in (70.0, 200.0, 400.0):
        exact = read @ harmonic(system, force, f)
        errors.append(np.linalg.norm(model.transfer(f)[:, 0] - exact) / np.linalg.norm(exact))
    return (
        f"| {system.ndof} | {tolerance:g} | {model.order} | {model.state_size} | {made:.1f} "
        f"| {model.error:.1e} | {max(errors):.1e} | {1e3 * full:.2f} | {1e6 * fast:.1f} | {full / fast:.0f} |"
    )


def seconds(call, count: int) -> float:
    call()
    begin = time.perf_counter()
    for _ in range(count):
        call()
    return (time.perf_counter() - begin) / count


def random_rows(count: int = 10) -> tuple[list[str], float, float]:
    """Run random cases, with a finer run of each.

    Return the share of cases with a difference of at most the estimate, and the median of estimate / difference.
    """
    random = np.random.default_rng(5)
    rows, ratios = [], []
    for number in range(count):
        body, load, times, points = random_case(random)
        accuracy = float(random.choice([0.05, 0.02, 0.01]))
        motion = solve_axisymmetric(SkinProblem(body, load, times, points, accuracy=accuracy))
        reference = solve_axisymmetric(
            SkinProblem(body, load, times, points, accuracy=0.1 * accuracy), degree=7, fine=1.5
        )
        true = differs(motion, reference)
        ratios.append(motion.error / true)
        size = f"{1e3 * body.thickness_m:.1f} mm, R {1e3 * body.radius_m:.0f} mm"
        shown = " | ".join(f"{100 * value:.2f} %" for value in (accuracy, motion.error, true))
        rows.append(
            f"| {number} | {len(body.sheets)} of {body.sheets[0].material.name}, {size}, {body.base}, {body.side} "
            f"| {1e3 * load.fwhm_m:.1f} | {shown} | {motion.seconds:.1f} |"
        )
        print(rows[-1], flush=True)
    return rows, float(np.mean(np.array(ratios) >= 1.0)), float(np.median(ratios))


def random_case(random: np.random.Generator) -> tuple[Slab, Spot, np.ndarray, np.ndarray]:
    materials = [preset(name) for name in ("ecoflex_00-10", "palm")]
    first, second = random.choice(2), random.choice(2)
    depth = float(random.uniform(0.003, 0.02))
    sheets: tuple[Sheet, ...] = (Sheet(materials[first], depth),)
    if random.random() < 0.4:
        sheets = (Sheet(materials[first], 0.4 * depth), Sheet(materials[second], 0.6 * depth))
    body = Slab(
        sheets,
        shape="disc",
        radius_m=float(random.uniform(0.02, 0.05)),
        base=str(random.choice(["bonded", "free_slip"])),
        side=str(random.choice(SIDES)),
    )
    times = np.linspace(0.0, 0.03, 301)
    fwhm = float(random.uniform(0.006, 0.015))
    kind = random.choice(3)
    radius = float(random.uniform(0.0, 0.4)) * body.radius_m
    centre = np.array([radius, 0.0])
    amplitude = 0.5 * (1.0 - np.cos(2.0 * np.pi * float(random.uniform(30.0, 300.0)) * times))
    if kind == 1:
        amplitude = np.ones(301)
    if kind == 2:
        turn = 2.0 * np.pi * float(random.uniform(10.0, 100.0)) * times
        centre = radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    points = np.array([[0.0, 0.0], [radius, 0.0], [0.0, 0.5 * body.radius_m]])
    return body, Spot(fwhm, times, amplitude, centre), times, points


WEDGES = "| side | static push [nm/Pa] | difference, static | difference, 1 ms ramp | unknowns of wedges |"
REDUCED = (
    "| unknowns | tolerance | vectors | state | time to make [s] | estimate | difference | full step [ms] "
    "| reduced step [us] | speed-up |"
)
RANDOM = ["| case | body | spot [mm] | wanted | estimate | differs by | wall [s] |", ""]


def main() -> None:
    commit = git_commit()
    target = ROOT / "docs" / "bench" / "skin_axisymmetric.md"
    head = ["| side | load | error | velocity | estimate | wall [s] | cpu [s] | predicted [s] | how |", ""]
    cases = case_rows(SIDES)
    lines = [
        "# Solver `axisymmetric` and the reduced model",
        "",
        "For developers of solvers. Command: `OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python",
        f"scripts/bench_axisymmetric.py`, {processor()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f} at",
        f"the start; commit {commit}.",
        "",
        "The reference disc is solved with a target accuracy of 1 % for 0.2 s, at 2001 times, at the centre and at",
        "r = 10 mm. The error is the relative L2 error over the times, at the worse of the two points. The reference",
        "has degree 7 and reduced models at 0.02 %. A load that starts with a jump (step, AM, STM) causes pressure",
        "echoes at all frequencies. The echoes leave an error of about 0.1 % in the displacement, and make the",
        "velocity converge slowly. CPU time is the sum over all cores; `cost_axisymmetric` predicts it.",
        f"{keep_rows(target, [*head, *cases])} has each side, and the meshes.",
        "",
        "| load, for all sides | error of the displacement | error of the velocity | estimate | wall time [s] | CPU "
        "time [s] | predicted [s] |",
        "|---|---|---|---|---|---|---|",
        *ranged(cases, (1,), (2, 3, 4, 5, 6, 7)),
        "",
        f"For AM of 200 Hz with roller sides, the error of the last 20 ms is {oracle_row()}, compared with the "
        "exact series.",
        "",
        "Solver `axisymmetric` (target 0.2 %) was compared with quadratic wedges (6 / 15 mm, 3 rows, step 0.1 ms), for",
        "the static displacement and the 1 ms ramp, at the centre / r = 10 mm",
        f"({keep_rows(target, [WEDGES, '', *wedge_rows()], 'skin_axisymmetric_wedges')}).",
        f"{keep_rows(target, [REDUCED, '', *reduced_rows()], 'skin_axisymmetric_reduced')} has reduced models of these",
        "wedges (fixed sides, one spot, two points, 0-600 Hz), with their largest difference at 70, 200 and 400 Hz.",
        "",
    ]
    if "--quick" not in sys.argv:
        rows, covered, median = random_rows()
        lines += [
            f"{len(rows)} random cases of 30 ms were compared with the same solver at degree 7, on a finer grid and",
            "with a tenth of the tolerances (a test of consistency). The difference is at most the estimate in",
            f"{100 * covered:.0f} % of cases. The median of estimate / difference is {median:.1f}",
            f"({keep_rows(target, [*RANDOM, *rows], 'skin_axisymmetric_random')}).",
            "",
        ]
    target.write_text("\n".join(lines))


if __name__ == "__main__":
    main()
