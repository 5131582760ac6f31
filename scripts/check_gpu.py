"""The GPU against the CPU and the float64 twin: error and speed of the field, and the main example on both.

    python scripts/check_gpu.py [--out docs/bench/gpu.md] [--commit HASH]

Needs a CUDA device. A pair is one transducer and one point; times are medians of 7 with the results back on the host.
"""

import argparse
import statistics
import time
from pathlib import Path

import mujoco
import numpy as np
import warp as wp

import palmfield
from palmfield.acoustics.arrays import layout
from palmfield.acoustics.field import FieldEvaluator
from palmfield.acoustics.focus import focus
from palmfield.acoustics.reference import pressure64
from palmfield.device import resolve
from palmfield.engine.register import register
from palmfield.types import Air

ROOT = Path(__file__).resolve().parents[1]
SCENE = ROOT / "mjcf" / "scenes" / "palm_am200.xml"


def field_rows(device: str) -> list[str]:
    array, air = layout("uhev1"), Air()
    drive = focus(array, air, np.array([0.02, -0.01, 0.2]))
    rng = np.random.default_rng(1)
    points = rng.uniform([-0.1, -0.1, 0.05], [0.1, 0.1, 0.4], (1_000_003, 3)).astype(np.float32)
    exact = pressure64(points[:20_003], array, drive, air, gradient=True)
    rows = []
    for where in (device, "cpu"):
        evaluator = FieldEvaluator(array, air, where)
        for gradient in (False, True):
            evaluator.pressure(points, drive, gradient)
            times = []
            for _ in range(7):
                start = time.perf_counter()
                field = evaluator.pressure(points, drive, gradient)
                times.append(time.perf_counter() - start)
            got = field.gradient if gradient else field.pressure
            wanted = exact[1] if gradient else exact[0]
            error = np.linalg.norm(got[:20_003] - wanted) / np.linalg.norm(wanted)
            speed = len(points) * len(array) / statistics.median(times) / 1e9
            rows.append(f"| {where} | {'p + gradient' if gradient else 'p'} | {speed:.2f} | {error:.1e} |")
    return rows


def sensor(device: str, steps: int = 20) -> tuple[np.ndarray, float]:
    scene = palmfield.load(SCENE, device=device)
    mujoco.mj_step(scene.model, scene.data)
    start = time.perf_counter()
    for _ in range(steps - 1):
        mujoco.mj_step(scene.model, scene.data)
    seconds = (time.perf_counter() - start) / (steps - 1)
    mujoco.mj_forward(scene.model, scene.data)
    return scene.data.sensordata.copy(), seconds


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--commit", default="unknown", help="what the table says was measured")
    arguments = parser.parse_args()
    register()
    device = resolve("cuda:0")
    lines = [
        "# The GPU beside the CPU",
        "",
        f"`python scripts/check_gpu.py`, {wp.get_device(device).name}, Warp {wp.__version__}, commit "
        f"{arguments.commit}. 1,000,003 points, 256 transducers, pistons with absorption; time with the "
        "transfer of the results; error against the float64 twin over 20,003 points.",
        "",
        "| device | what | G pairs/s | rel-L2 |",
        "|---|---|---|---|",
        *field_rows(device),
        "",
    ]
    (gpu, gpu_s), (cpu, cpu_s) = sensor(device), sensor("cpu")
    difference = np.abs(gpu - cpu) / np.maximum(np.abs(cpu), 1e-12)
    lines += [
        "`palm_am200` after 20 ms in plain `mj_step`, the skin solved on the CPU in both cases:",
        "",
        f"- sensor on {device}: {np.array2string(gpu, precision=6)}",
        f"- sensor on cpu: {np.array2string(cpu, precision=6)}",
        f"- largest relative difference of force and displacement: {difference[2:4].max():.1e}",
        f"- a step of 1 ms takes {1e3 * gpu_s:.1f} ms with the field on {device}, {1e3 * cpu_s:.1f} ms on the CPU",
    ]
    text = "\n".join(lines) + "\n"
    print(text)
    if arguments.out:
        arguments.out.write_text(text)


if __name__ == "__main__":
    main()
