"""Simulated readings of an imaginary board, to test a calibration without hardware."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from palmfield.acoustics.arrays import LAYOUTS
from palmfield.acoustics.calibration_file import Calibration, Elements, Pose, calibrated, write_calibration
from palmfield.acoustics.focus import compensate, focus
from palmfield.acoustics.phased_array import only
from palmfield.acoustics.reference import pressure64
from palmfield.drive.calibration.frequency_sweep import response_at
from palmfield.drive.calibration.plate_scale import plate_force
from palmfield.drive.calibration.readings import XYZ
from palmfield.errors import OutputError
from palmfield.files import made_folder
from palmfield.tables import write_table
from palmfield.types import Air, Array, Complex, Estimate, Float

FOCUS_M = (0.0, 0.0, 0.15)
PLATE_M = (0.1, 0.1)
PLACES = 8
RESONANCE_HZ, QUALITY = 40_300.0, 22.0
TRUTH = "truth.json"
NOISE = 0.01


def rehearse(array: Array, folder: Path, seed: int) -> list[Path]:
    """Write a file of readings of each kind, and TRUTH with the true parameters; return the paths.

    Half of the transducers are inverted; phases differ by 10 deg and gains by 8 % (sd); 2 % are silent. The microphone
    is 1 mm off (sd), the air 1 K, and a wall reflects 10 % of the sound.
    array: the layout; folder: made if missing. Raises OutputError for a folder with other content.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise OutputError(f"{folder} already exists and is not empty: choose another folder")
    made_folder(folder)
    random = np.random.default_rng(seed)
    truth = _strange_board(array, random)
    write_calibration(folder / TRUTH, truth)
    files = [folder / TRUTH]
    for name, columns in _readings(array, truth, random).items():
        files.append(folder / f"{name}.csv")
        write_table(files[-1], list(columns), np.column_stack(list(columns.values())))
    return files


def _strange_board(array: Array, random: np.random.Generator) -> Calibration:
    count = len(array)
    enabled = np.ones(count, bool)
    enabled[random.choice(count, max(count // 50, 1), replace=False)] = False
    phase, gain = np.radians(random.normal(0.0, 10.0, count)), random.normal(1.0, 0.08, count)
    zeros = (0.0,) * count
    return Calibration(
        layout=array.name,
        p0=Estimate(array.p0_Pa_m, array.p0_Pa_m, array.p0_Pa_m, "measured", "an imaginary board"),
        quality=Estimate(QUALITY, QUALITY, QUALITY, "measured", "an imaginary board"),
        resonance_Hz=Estimate(RESONANCE_HZ, RESONANCE_HZ, RESONANCE_HZ, "measured", "an imaginary board"),
        elements=Elements(
            enabled=tuple(enabled.tolist()),
            polarity=tuple(np.where(random.random(count) < 0.5, -1, 1).tolist()),
            phase_rad=tuple(np.where(enabled, phase - phase[enabled].mean(), 0.0).tolist()),
            phase_sd_rad=zeros,
            gain=tuple(np.where(enabled, gain / gain[enabled].mean(), 0.0).tolist()),
            gain_sd=zeros,
        ),
        pose=Pose(offset_m=(1.2e-3, -0.8e-3, 2.0e-3)),
    )


def _readings(array: Array, truth: Calibration, random: np.random.Generator) -> dict[str, dict[str, Float]]:
    elements = truth.elements
    assert elements is not None
    assumed, real = Air(), Air(temperature_C=20.0 + float(random.normal()))
    moved = calibrated(array, truth)
    size = np.where(elements.enabled, elements.gain, 0.0) * np.array(elements.polarity)
    raw: Complex = size * np.exp(1j * np.array(elements.phase_rad))
    wide = 0.4 * float(np.ptp(array.positions[:, :2], axis=0).max())
    at = np.column_stack([random.uniform(-wide, wide, (PLACES, 2)), random.uniform(1.5 * wide, 3.0 * wide, PLACES)])
    each = _one_by_one(array, raw, at + random.normal(0.0, 1e-3, at.shape), real, random)
    number, place = np.tile(np.arange(len(array)), PLACES), np.repeat(np.arange(PLACES), len(array))
    # At this stage the driver has the wiring from the measurement of single transducers
    aimed = compensate(moved, focus(array, assumed, FOCUS_M))
    scan = np.array(FOCUS_M) + random.uniform(-1.0, 1.0, (60, 3)) * [0.012, 0.012, 0.04]
    amplitudes = np.abs(pressure64(scan, moved, aimed, real)[0])
    levels = np.repeat(np.linspace(0.1, 1.0, 10), 3)
    time = np.arange(0.0, 1800.0, 60.0)
    counted = {"element": number.astype(float), "layout_version": np.full(len(number), LAYOUTS[array.name].version)}
    return {
        "elements": counted | _places(at[place]) | _polar(each.ravel()),
        "level": {"level": levels, "pressure_Pa": 900.0 * levels * random.normal(1.0, NOISE, len(levels))},
        "plate": _on_scale(moved, aimed, assumed, random),
        "focus": _places(scan) | {"pressure_Pa": amplitudes * random.normal(1.0, NOISE, len(scan))},
        "sweep": _swept(moved, aimed, real, random),
        "warm_up": {
            "time_s": time,
            "pressure_Pa": 900.0 * (1.0 + 0.06 * np.exp(-time / 300.0)) * random.normal(1.0, 2e-3, len(time)),
        },
    }


def _one_by_one(array: Array, raw: Complex, at: Float, air: Air, random: np.random.Generator) -> Complex:
    """Return the pressures of each transducer alone, with an echo from a wall behind the microphone, (places, n)."""
    wall = 1.2 * float(at[:, 2].max())
    echo = at * [1.0, 1.0, -1.0] + [0.0, 0.0, 2.0 * wall]
    places, one = np.concatenate([at, echo]), np.ones(1, complex)
    sounds = [pressure64(places, only(array, np.array([n], np.int32)), one, air)[0] for n in range(len(array))]
    both = raw * np.array(sounds).T
    alone = both[: len(at)] + 0.1 * both[len(at) :]
    noise = random.normal(size=(2, *alone.shape)) * NOISE * np.abs(alone).max()
    return np.asarray(alone + noise[0] + 1j * noise[1])


def _on_scale(board: Array, aimed: Complex, air: Air, random: np.random.Generator) -> dict[str, Float]:
    distances = np.repeat(FOCUS_M[2] + np.linspace(0.0, 3.6e-3, 5), 10)
    on, time = np.tile([0.0, 1.0], 25), 4.0 * np.arange(50)
    at = {h: plate_force(board, air, aimed, PLATE_M, h) for h in np.unique(distances)}
    force = on * np.array([at[h] for h in distances]) * (1.0 + 0.15 * np.cos(4.0 * math.pi * distances / 8.58e-3))
    force += 2e-5 + 1e-7 * time
    return {
        "distance_m": distances, "time_s": time, "on": on,
        "force_N": force + random.normal(0.0, 0.01 * float(force.max()), len(force)),
    }  # fmt: skip


def _swept(board: Array, aimed: Complex, air: Air, random: np.random.Generator) -> dict[str, Float]:
    at = np.array(FOCUS_M) + random.uniform(-1.0, 1.0, (PLACES, 3)) * [3e-3, 3e-3, 10e-3]
    f = np.linspace(38e3, 42e3, 41)
    pole = response_at(f, RESONANCE_HZ, QUALITY)
    sound = pole * np.column_stack([pressure64(at, replace(board, frequency_Hz=float(x)), aimed, air)[0] for x in f])
    noise = random.normal(size=(2, *sound.shape)) * NOISE * np.abs(sound).max()
    return (
        _places(np.repeat(at, len(f), axis=0))
        | {"frequency_Hz": np.tile(f, len(at))}
        | _polar((sound + noise[0] + 1j * noise[1]).ravel())
    )


def _places(at: Float) -> dict[str, Float]:
    return dict(zip(XYZ, at.T, strict=True))


def _polar(pressure: Complex) -> dict[str, Float]:
    return {"pressure_Pa": np.abs(pressure), "phase_deg": np.degrees(np.angle(pressure))}
