"""Scenarios with moving hands on a GPU against the CPU: sensors after some steps, and seconds a step.

python scripts/check_gpu_scenes.py [--device cuda:0] [--steps 30]
"""

import argparse
import time

import numpy as np

import palmfield
from palmfield.data import folder

NAMES = ("approach_withdraw", "two_hands", "follow_fingertip", "trace_shape")


def rows(name: str, device: str, steps: int) -> tuple[np.ndarray, float]:
    """Sensors of the steps, and seconds a step after the first."""
    sim = palmfield.Simulation(folder("mjcf") / "scenes" / f"{name}.xml", device=device)
    sensors = []
    began = 0.0
    for number in range(steps):
        if number == 1:
            began = time.perf_counter()
        sim.step()
        sensors.append(sim.data.sensordata.copy())
    return np.array(sensors), (time.perf_counter() - began) / (steps - 1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cuda:0")
    parser.add_argument("--steps", type=int, default=30)
    arguments = parser.parse_args()
    for name in NAMES:
        (cpu, slow), (gpu, fast) = (rows(name, device, arguments.steps) for device in ("cpu", arguments.device))
        size = np.abs(cpu).max(axis=0)
        difference = np.abs(gpu - cpu).max(axis=0) / np.where(size > 0.0, size, 1.0)
        print(f"{name}: largest difference {difference.max():.1e} of each channel's largest; "
              f"{1e3 * slow:.0f} ms a step on the CPU, {1e3 * fast:.0f} ms on the GPU")  # fmt: skip


if __name__ == "__main__":
    main()
