"""Wall time, peak memory and results of the shipped scenes, each in a process of its own; writes docs/bench/scenes.md.

python scripts/bench_scenes.py [SCENE ...] [--compare] [--out docs/bench/scenes.md]

--compare: also the small model of the skin against the whole layer, beginning of each scene
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import mujoco
import numpy as np
from palmfield.skin.reduction.stepping import ReducedSkin

import palmfield
from palmfield.engine.host import raise_errors
from palmfield.studies.bench.field import git_commit
from palmfield.studies.bench.table import processor

ROOT = Path(__file__).resolve().parents[1]
SCENES = ROOT / "mjcf" / "scenes"
COMPARED_S = 0.03


def yardstick_s() -> float:
    """Median time of a fixed piece of work: a 1000 x 1000 float64 matrix product, 10 times."""
    a = np.random.default_rng(0).random((1000, 1000))
    times = []
    for _ in range(5):
        start = time.perf_counter()
        for _ in range(10):
            a @ a
        times.append(time.perf_counter() - start)
    return float(np.median(times))


def measure(scene: Path, folder: Path) -> str:
    """One row of the table."""
    out = folder / scene.stem
    start = time.perf_counter()
    child = subprocess.Popen([sys.executable, "-m", "palmfield", "run", str(scene), "--out", str(out)])
    _, status, usage = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    wall = time.perf_counter() - start
    if child.returncode:
        raise SystemExit(f"{scene} ended with exit code {child.returncode}")
    s = json.loads((out / "summary.json").read_text())
    return (
        f"| {scene.stem} | {wall:.1f} | {usage.ru_maxrss / 1024:.0f} | {s['dofs']} | {s['skin_steps']} "
        f"| {s['peak_arp_Pa']:.3g} | {1e3 * s['total_force_peak_N']:.3g} | {1e6 * s['peak_displacement_m']:.3g} "
        f"| {1e6 * s['rms_displacement_m']:.3g} | {100 * s['mesh_error_relative']:.1f} "
        f"| {100 * s['step_error_relative']:.1f} | {100 * s['reduction_error_relative']:.2f} "
        f"| {100 * s['edge_error_relative']:.1f} | {s['skin_solver']} |"
    )


def motion(path: Path, solver: str, folder: Path) -> tuple[float, float, str, np.ndarray]:
    """Seconds of making the solver and of a simulated millisecond, its name, and the surface's displacement."""
    text = path.read_text().replace('<config key="body"', f'<config key="solver" value="{solver}"/><config key="body"')
    for include in ("plain_palm", "plain_phantom"):
        text = text.replace(f'file="{include}', f'file="{SCENES}/{include}')
    changed = folder / f"{path.stem}_{solver}.xml"
    changed.write_text(text)
    scene = palmfield.load(changed)
    chain = scene.skin.chain
    start = time.perf_counter()
    skin = chain.skin.begin
    made = time.perf_counter() - start
    seen: list[np.ndarray] = []
    chain.observer = lambda t, motion, *rest: seen.append(motion[0])
    steps = round(COMPARED_S / scene.model.opt.timestep)
    start = time.perf_counter()
    for _ in range(steps):
        mujoco.mj_step(scene.model, scene.data)
        raise_errors(scene.data)
    each = (time.perf_counter() - start) / (1e3 * COMPARED_S)
    name = f"{skin.model.order} vectors, {100 * skin.error:.2f} %" if isinstance(skin, ReducedSkin) else "full"
    return made, each, name, np.array(seen)


def compare(path: Path, folder: Path) -> str:
    """One row of the second table."""
    choice = palmfield.load(path).skin.rig.choice
    if choice.name == "full":
        return f"| {path.stem} | {choice.why} | | | | | | |"
    made, each, name, small = motion(path, "reduced", folder)
    full_made, full_each, _, full = motion(path, "wedges", folder)
    most = int(np.abs(full).max(axis=0).argmax())
    surface = np.linalg.norm(small - full) / np.linalg.norm(full)
    peak = np.linalg.norm(small[:, most] - full[:, most]) / np.linalg.norm(full[:, most])
    return (
        f"| {path.stem} | {name} | {made:.1f} | {1e3 * each:.0f} | {full_made:.1f} | {1e3 * full_each:.0f} "
        f"| {100 * surface:.2f} | {100 * peak:.2f} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", type=Path)
    parser.add_argument("--compare", action="store_true")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "bench" / "scenes.md")
    arguments = parser.parse_args()
    scenes = arguments.scenes or sorted(p for p in SCENES.glob("*.xml") if not p.name.startswith("plain_"))
    head = [
        "# The shipped scenes",
        "",
        f"`python scripts/bench_scenes.py`, {processor()}, {os.cpu_count()} cores, commit {git_commit()}; yardstick "
        f"(ten products of 1000 x 1000) {yardstick_s():.2f} s. One run each, wall time of the whole command, compiled "
        "kernels cached. Errors in percent of the displacement: mesh, time step, small model, cut edge of the layer.",
        "",
        "| scene | wall [s] | memory [MiB] | unknowns | steps | peak ARP [Pa] | force [mN] | peak [um] | rms [um] "
        "| mesh % | step % | reduction % | edge % | skin |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    with tempfile.TemporaryDirectory() as folder:
        rows = [measure(scene, Path(folder)) for scene in scenes]
        if arguments.compare:
            rows += [
                "",
                f"The small model against the whole layer, the first {1e3 * COMPARED_S:g} ms: seconds to make each, "
                "milliseconds for a simulated one, and the difference of the displacement, L2 over these times, over "
                "the surface and where it is largest. The whole layer has its own error of the time step in it, about "
                "1 % over the surface while a sudden load is young.",
                "",
                "| scene | small model | made [s] | a ms [ms] | whole made [s] | a ms [ms] | surface % | peak % |",
                "|---|---|---|---|---|---|---|---|",
                *(compare(scene, Path(folder)) for scene in scenes),
            ]
    arguments.out.write_text("\n".join(head + rows) + "\n")
    print("\n".join(head + rows))


if __name__ == "__main__":
    main()
