"""Wall time, peak memory and results of the shipped scenes, each in a process of its own; writes docs/bench/scenes.md.

python scripts/bench_scenes.py [SCENE ...] [--out docs/bench/scenes.md]
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from palmfield.bench.field import git_commit
from palmfield.bench.table import processor

ROOT = Path(__file__).resolve().parents[1]
SCENES = ROOT / "mjcf" / "scenes"


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
        f"| {100 * s['step_error_relative']:.1f} | {100 * s['edge_error_relative']:.1f} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", type=Path)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "bench" / "scenes.md")
    arguments = parser.parse_args()
    scenes = arguments.scenes or sorted(p for p in SCENES.glob("*.xml") if not p.name.startswith("plain_"))
    head = [
        "# The shipped scenes",
        "",
        f"`python scripts/bench_scenes.py`, {processor()}, {os.cpu_count()} cores, commit {git_commit()}; yardstick "
        f"(ten products of 1000 x 1000) {yardstick_s():.2f} s. One run each, wall time of the whole command, compiled "
        "kernels cached. Errors in percent of the displacement: mesh, time step, cut edge of the skin layer.",
        "",
        "| scene | wall [s] | memory [MiB] | unknowns | steps | peak ARP [Pa] | force [mN] | peak [um] | rms [um] "
        "| mesh % | step % | edge % |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    with tempfile.TemporaryDirectory() as folder:
        rows = [measure(scene, Path(folder)) for scene in scenes]
    arguments.out.write_text("\n".join(head + rows) + "\n")
    print("\n".join(head + rows))


if __name__ == "__main__":
    main()
