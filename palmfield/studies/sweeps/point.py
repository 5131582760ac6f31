"""Results that a sweep stores for one point: numbers of a run, and a few quantities over time."""

import math
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from palmfield.estimate.sensation_levels import felt_levels
from palmfield.estimate.summary import drive_levels, estimated_errors
from palmfield.perception.registry import ALL_OBSERVERS
from palmfield.session.duration import step_count
from palmfield.session.preview import Preview
from palmfield.session.recorder import world_with
from palmfield.session.simulation import Simulation
from palmfield.studies.sweeps.watch import Watched
from palmfield.types import Float

Numbers = dict[str, NDArray[Any]]
"""Values by variable (`palmfield.studies.sweeps.variables`), without the dimensions of the design."""


def sensor_names(scene: Simulation | Preview) -> list[str]:
    """Return the names of the sensors on all skins, in the order of their skins."""
    world = world_with(scene.data)
    return [sensor.name for skin in scene.runtime.binding.skins for sensor in world.sensors(skin.instance)]


def measured(simulation: Simulation, duration_s: float, times: Float, errors: bool) -> list[Numbers]:
    """Run a simulation and return the numbers of its worlds; each world is a point.

    duration_s: simulated time [s]; times: times of courses, from the start of the run [s], shape (t,)
    errors: whether the error of the displacement is estimated, which takes longer than most runs
    Raises SceneError and DeviceError of the run.
    """
    started = time.perf_counter()
    model = simulation.runtimes[0].model
    steps = step_count(duration_s, model.spec.timestep_s)
    watched = Watched(simulation, steps)
    for _ in range(steps):
        simulation.step()
        watched.step()
    points = [_point(watched, world, times, errors) for world in range(len(watched.runtimes))]
    spent = time.perf_counter() - started
    return [point | {"wall_time": np.array(spent / len(points))} for point in points]


def _point(watched: Watched, world: int, times: Float, errors: bool) -> Numbers:
    """Return the numbers of one world."""
    model = watched.runtimes[world].model
    rows = [_skin(watched, world, number, times) for number in range(len(model.skins))]
    result: Numbers = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    result["sensor_displacement"] = watched.sensors[:, world].T.astype(np.float32)
    result["drive_level"] = np.array(drive_levels(model, watched.loudest[world]))
    if errors:
        estimates = [_estimate(watched, world, number) for number in range(len(model.skins))]
        result["displacement_error"] = np.array([error for error, _ in estimates])
        result["displacement_error_missing"] = np.array([reason for _, reason in estimates], dtype=object)
    result["substep"] = np.array(model.step_s)
    return result


def _skin(watched: Watched, world: int, number: int, times: Float) -> dict[str, Any]:
    """Return the numbers of one skin in one world."""
    displacement, velocity = watched.motion[number][world].swapaxes(0, 1)
    sizes = np.maximum(displacement.max(axis=0), -displacement.min(axis=0))
    vertex = int(sizes.argmax())
    moved, moves = (part[:, vertex].astype(np.float64) for part in (displacement, velocity))
    model, work = watched.runtimes[world].model, watched.runtimes[world].work
    loudest, arp = watched.loudest[world][number], watched.arp[world, number]
    levels = felt_levels(
        *(model, number, loudest, work.radiation, work.reference, watched.times, displacement, arp),
        begun_s=watched.begun_s,
    )
    frequency = levels.get("main_frequency_Hz")
    last = np.zeros(len(watched.times), bool)
    if frequency is not None:  # None if the sound is not periodic
        last = watched.times > watched.times[-1] - 1.0 / frequency + 1e-9
    force = watched.forces[:, world, number]
    return {
        "peak_displacement": float(sizes[vertex]),
        "peak_velocity": float(max(velocity.max(), -velocity.min())),
        "rms_displacement": _rms(moved),
        "rms_displacement_without_mean": float(moved.std()),
        "rms_displacement_last_period": _rms(moved[last]),
        "rms_velocity": _rms(moves),
        "rms_velocity_last_period": _rms(moves[last]),
        "peak_arp": float(watched.peak_arp[world, number]),
        "loudest_position": model.skins[number].nodes[0][vertex],
        "normal_displacement": resampled(watched.times, moved, times).astype(np.float32),
        "peak_force": float(np.linalg.norm(force, axis=1).max()),
        "mean_force": force.mean(axis=0),
        "main_frequency": _number(frequency),
        "level": _by_observer(levels, "level_{}_dB_SL"),
        "level_all_lines": _by_observer(levels, "level_all_lines_{}_dB_SL"),
        "level_with_area": _by_observer(levels, "level_area_{}_dB_SL"),
        "level_why": np.array([levels.get(f"level_{name}_why", "") for name in ALL_OBSERVERS], dtype=object),
    }


def _by_observer(levels: dict[str, Any], key: str) -> Float:
    """Return one number for each observer, NaN if there is none."""
    return np.array([_number(levels.get(key.format(name))) for name in ALL_OBSERVERS])


def _estimate(watched: Watched, world: int, number: int) -> tuple[float, str]:
    """Return the relative error of the displacement of a skin, or why there is none."""
    loudest = watched.loudest[world][number]
    if loudest is None or not np.any(watched.motion[number][world, :, 0]):
        return math.nan, "no sound"
    errors = estimated_errors(watched.runtimes[world], number, loudest)
    return (math.nan, errors) if isinstance(errors, str) else (errors["displacement_error_relative"], "")


def resampled(own: Float, values: Float, times: Float) -> Float:
    """Resample a time series by a cubic spline; at its own times the values are unchanged.

    own, times: rising, shapes (n,) and (t,); values: shape (n,). NaN after the last of `own`.
    """
    if len(own) == len(times) and np.allclose(own, times, rtol=0.0, atol=1e-9):
        return values
    if len(own) < 4:
        return np.interp(times, own, values, right=math.nan)
    result: Float = CubicSpline(own, values)(times)
    return np.where(times > own[-1] + 1e-9, math.nan, result)


def _rms(values: Float) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else math.nan


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)
