"""Run the other programs, and write their results as reference arrays for tests/acoustics/test_peers.py.

    PYTHONPATH=.:scripts/bench PEERS/bin/python scripts/peers/write_reference.py

PEERS is the folder that scripts/peers/setup.py made. Every file contains inputs, outputs, versions and seconds.
"""

import importlib.metadata
import platform
import time
from pathlib import Path

import field_peers as peers
import numpy as np

from palmfield.acoustics.arrays import layout

TARGET = Path(__file__).resolve().parents[2] / "tests" / "data" / "peers"
SPEED_M_S = 340.0
FREQUENCY_HZ = 40e3
FOCUS_M = np.array([0.02, 0.01, 0.2])
SHIFTS = (0, 64, 128, 192)
"""Phases added to the last two units [1/256 turn]: the four magnitudes determine the phase between the two pairs."""


def versions(*names: str) -> str:
    return ", ".join(f"{name} {importlib.metadata.version(name)}" for name in ("numpy", *names))


def write(name: str, **arrays: object) -> None:
    TARGET.mkdir(parents=True, exist_ok=True)
    path = TARGET / f"{name}.npz"
    np.savez_compressed(path, python=platform.python_version(), **arrays)
    print(f"wrote {path}: {path.stat().st_size / 1000:.0f} kB")


def autd3_emulator() -> None:
    """Compute four focused units with random intensities: magnitudes in a box around the focus and in one far away."""
    array = layout("autd3_2x2")
    distance = np.linalg.norm(FOCUS_M - array.positions, axis=1)
    phase = np.round(-256.0 * FREQUENCY_HZ / SPEED_M_S * distance).astype(int) % 256
    intensity = np.random.default_rng(0).integers(0, 256, len(array)).astype(np.uint8)
    geometry = peers.emulator_geometry(array.positions)
    boxes = ((np.array([0.0, -0.0125, 0.18]), 0.00625), (np.array([-0.1, -0.05, 0.05]), 0.03125))
    steps = np.array([8, 8, 8])
    start = time.perf_counter()
    points, magnitudes = [], []
    for low, resolution in boxes:
        by_shift = []
        for shift in SHIFTS:
            shifted = phase.copy()
            shifted[2 * peers.UNIT :] += shift
            record = peers.emulator_record(geometry, (shifted % 256).astype(np.uint8), intensity, 1)
            field = peers.emulator_field(record, low, steps, resolution, SPEED_M_S)
            by_shift.append(peers.emulator_next(field))
        points.append(1e-3 * field.observe_points().to_numpy().astype(float))
        magnitudes.append(by_shift)
    width = peers.emulator_record(geometry, phase.astype(np.uint8), intensity, 1).pulse_width().to_numpy()[:, 0]
    theirs = [geometry.device(i).positions() for i in range(geometry.num_devices())]
    write(
        "autd3_emulator",
        points=np.concatenate(points),
        positions=1e-3 * np.concatenate(theirs).astype(float),
        phase=phase.astype(np.uint8),
        intensity=intensity,
        pulse_width=width,
        shifts=np.array(SHIFTS),
        magnitude=np.concatenate(magnitudes, axis=1).astype(np.float32),
        p0_Pa_m=peers.EMULATOR_P0_PA_M,
        sound_speed_m_s=SPEED_M_S,
        frequency_Hz=FREQUENCY_HZ,
        versions=versions("autd3-emulator", "autd3", "autd3-pattern"),
        seconds=time.perf_counter() - start,
    )


def levitate() -> None:
    """Compute pistons and omnidirectional point sources, for which the gradient of levitate is exact."""
    from levitate.materials import air
    from levitate.transducers import CircularPiston, PointSource

    air.c = SPEED_M_S
    random = np.random.default_rng(1)
    count, p0, radius = 120, 2.53, 4.5e-3
    positions = random.uniform([-0.1, -0.1, -0.01], [0.1, 0.1, 0.0], (count, 3))
    normals = random.uniform([-0.3, -0.3, 0.7], [0.3, 0.3, 1.3], (count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    drive = random.uniform(0.0, 1.0, count) * np.exp(2j * np.pi * random.uniform(size=count))
    points = random.uniform([-0.05, -0.05, 0.1], [0.05, 0.05, 0.4], (300, 3))
    start = time.perf_counter()
    piston = CircularPiston(radius, freq=FREQUENCY_HZ, p0=p0).pressure(positions.T, normals.T, points.T)
    point = PointSource(freq=FREQUENCY_HZ, p0=p0).pressure_derivs(positions.T, normals.T, points.T, orders=1)
    write(
        "levitate",
        points=points,
        positions=positions,
        normals=normals,
        drive=drive,
        piston=drive @ piston,
        point=drive @ point[0],
        point_gradient=np.tensordot(point[1:4], drive, ([1], [0])).T,
        piston_radius_m=radius,
        p0_Pa_m=p0,
        sound_speed_m_s=SPEED_M_S,
        frequency_Hz=FREQUENCY_HZ,
        versions=versions("levitate", "scipy"),
        seconds=time.perf_counter() - start,
    )


if __name__ == "__main__":
    autd3_emulator()
    levitate()
