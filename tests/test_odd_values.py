"""Odd values of what palmfield's packages export: an answer, or an error of palmfield's own in one line."""

import importlib
import warnings
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import numpy as np
import pytest

from palmfield.acoustics import layout
from palmfield.config.stimulus import StimulusConfig
from palmfield.errors import PalmfieldError
from palmfield.hand import load_preset
from palmfield.instruments import Plate, Scale
from palmfield.perception import OBSERVERS
from palmfield.skin import Sheet, Slab, Spot, preset
from palmfield.types import Air

T = np.linspace(0.0, 0.1, 201)
S = np.sin(2.0 * np.pi * 100.0 * T)
X = np.linspace(-0.02, 0.02, 21)
MAP = np.exp(-(X[:, None] ** 2 + X**2) / 5e-3**2)
MAPS = MAP * np.cos(2.0 * np.pi * 100.0 * T)[:, None, None]
INSIDE = MAP > 0.5
PLACES = np.column_stack([X, 0.0 * X, 0.0 * X])
BALL = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1.0]]) * 0.02
FACES = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]], np.int32)
OBSERVER = next(iter(OBSERVERS.values())) if isinstance(OBSERVERS, dict) else OBSERVERS[0]
SLAB = Slab((Sheet(preset("palm"), 0.01),), shape="disc", side="free", radius_m=0.02)
SPOT = Spot(0.01, [0.0], [100.0])


@cache
def array() -> Any:
    return layout("uhev1")


AIR = Air()
CALLS: dict[str, dict[str, Any]] = {
    "metrics.amplitude_spectrum": {"time_s": T, "signal": S},
    "metrics.area_above": {"values": MAP, "x_m": X, "y_m": X, "level": 0.5},
    "metrics.average_residual_energy": {"density": MAP, "x_m": X, "y_m": X, "inside": INSIDE},
    "metrics.co_rotating_average": {
        "times_s": T, "values": np.ones((201, 3, 8)), "turn_Hz": 50.0, "angles_rad": [0.0, 1.0],
    },
    "metrics.energy_density": {"times_s": T, "normal_velocity": MAPS, "window_s": (0.0, 0.05)},
    "metrics.focal_energy_ratio": {"density": MAP, "x_m": X, "y_m": X, "inside": INSIDE},
    "metrics.half_width": {"at_m": X, "values": MAP[10], "level": 0.5},
    "metrics.harmonics": {"time_s": T, "signal": S, "fundamental_Hz": 100.0, "count": 2},
    "metrics.last_periods": {"times_s": T, "frequency_Hz": 100.0, "periods": 3},
    "metrics.level_depth": {"depth_m": X + 0.1, "values": np.linspace(1.0, 0.1, 21), "reference_m": 0.09, "level": 0.5},
    "metrics.mach_angle": {
        "normal_velocity": MAP, "x_m": X, "y_m": X, "focus_x_m": 0.0, "distances_m": (0.005, 0.015), "skip_m": 0.002,
    },
    "metrics.mean_value": {"times_s": T, "values": S, "window_s": (0.0, 0.05)},
    "metrics.mse": {"map_a": MAP, "map_b": MAP + 0.1},
    "metrics.overshoot": {"times_s": T, "values": S + 1.0, "steady": 1.0, "window_s": (0.0, 0.05)},
    "metrics.peak": {"times_s": T, "values": S, "window_s": (0.0, 0.05)},
    "metrics.peak_to_peak": {"times_s": T, "values": S, "window_s": (0.0, 0.05)},
    "metrics.radial_profile": {"values": S[:21], "points_m": PLACES, "radii_m": [0.0, 0.01, 0.02]},
    "metrics.rms": {"times_s": T, "values": S, "window_s": (0.0, 0.05)},
    "metrics.rms_map": {"times_s": T, "values": MAPS, "window_s": (0.0, 0.05)},
    "metrics.settling_time": {
        "times_s": T, "values": 1.0 - np.exp(-T / 0.005), "steady": 1.0, "band": 0.1, "start_s": 0.0, "end_s": 0.09,
    },
    "metrics.spectral_centroid": {"time_s": T, "signal": S, "band_Hz": (10.0, 500.0)},
    "metrics.spectral_peaks": {
        "frequency_Hz": np.arange(50.0), "amplitude": np.abs(np.sin(np.arange(50.0))), "most": 2,
    },
    "metrics.spot_diameter": {"values": MAP, "x_m": X, "y_m": X, "level_of_peak": 0.2},
    "metrics.ssim": {
        "map_a": MAP, "map_b": MAP * 0.9, "data_range": 1.0, "sigma": 1.5, "radius": 5, "k1": 0.01, "k2": 0.03,
    },
    "metrics.steady_value": {"times_s": T, "values": S, "window_s": (0.0, 0.05)},
    "metrics.strip": {"x_m": X, "y_m": X, "path_m": [[-0.01, 0.0], [0.01, 0.0]], "width_m": 0.005},
    "metrics.strongest_line": {"time_s": T, "signal": S, "band_Hz": (10.0, 500.0)},
    "metrics.wake_area": {"normal_velocity": MAP, "x_m": X, "y_m": X, "threshold": 0.1},
    "metrics.wake_length": {"normal_velocity": MAP, "x_m": X, "y_m": X, "focus_x_m": 0.0, "threshold": 0.1},
    "perception.detection_probability": {"level_dB_SL": [0.0, 3.0], "slope": 2.0, "guess": 0.5, "lapse": 0.01},
    "perception.direction_share": {"apart": 1.0, "noise": 1.0},
    "perception.level_course": {
        "times_s": T, "displacement_m": 1e-6 * S[:, None], "observer": OBSERVER, "integration_s": 0.05,
    },
    "perception.level_dB_SL": {
        "observer": OBSERVER, "frequencies": [200.0], "peak_amplitudes_m": [1e-6], "area_m2": 1e-4,
        "duration_s": 0.5,
    },
    "perception.line_amplitude": {"time": T, "x": S, "f": 100.0, "periods": 3},
    "perception.line_amplitudes": {"time": T, "x": S[:, None], "f": 100.0, "periods": 3},
    "perception.noise_for": {"separations": [1.0, 2.0], "share": 0.75},
    "perception.summed_gain": {"envelope": np.ones(20), "step_s": 0.01, "tau_s": 0.1},
    "perception.threshold_m": {"observer": OBSERVER, "f_Hz": [100.0, 200.0], "area_m2": 1e-4, "duration_s": 0.5},
    "instruments.disc_grid": {"radius_m": 0.02, "pitch_m": 0.005},
    "instruments.highpass": {"signal": S, "rate_Hz": 2000.0, "cutoff_Hz": 50.0, "order": 2},
    "instruments.integrated": {"signal": S, "rate_Hz": 2000.0},
    "instruments.line_grid": {"length_m": 0.02, "count": 5, "azimuth_deg": 10.0},
    "instruments.lowpass": {"signal": S, "rate_Hz": 2000.0, "cutoff_Hz": 500.0, "order": 2},
    "instruments.mesh_force": {"arp": np.ones(6), "vertices": BALL, "faces": FACES, "plate": Plate()},
    "instruments.rectangle_grid": {"width_m": 0.02, "height_m": 0.01, "pitch_m": 0.005},
    "instruments.sampled": {"times_s": T, "signal": S, "at_s": [0.01, 0.02]},
    "instruments.scale_reading": {"times_s": T, "force_N": np.column_stack([S, S, S]), "settings": Scale()},
    "stimulus.burst": {"times": T, "window": "hann", "length_s": 0.01, "period_s": 0.02, "count": 2},
    "stimulus.circle": {"diameter_m": 0.02},
    "stimulus.line": {"length_m": 0.02, "direction_deg": 30.0},
    "stimulus.lissajous": {"width_m": 0.02, "height_m": 0.01, "a": 1, "b": 2, "phase_deg": 10.0},
    "stimulus.onsets": {"start_s": 0.0, "end_s": 0.1, "length_s": 0.01, "period_s": 0.02, "count": 3},
    "stimulus.polyline": {"points": [[0.0, 0.0], [0.01, 0.0], [0.01, 0.01]]},
    "stimulus.square": {"side_m": 0.02},
    "stimulus.z_shape": {"width_m": 0.02, "height_m": 0.01},
    "stimulus.zigzag": {"width_m": 0.02, "height_m": 0.01, "turns": 3},
    "stimulus.frame_at": {"config": StimulusConfig(), "t": 0.01},
    "acoustics.layout": {"name": "uhev1", "p0_Pa_m": 2.0},
    "acoustics.boundary_mesh": {"vertices": BALL, "faces": FACES, "wavelength_m": 0.02},
    "acoustics.pressure": {
        "points": [[0.0, 0.0, 0.2]], "array": array, "drive": np.ones(256), "air": AIR, "device": "cpu",
    },
    "drive.board_named": {"name": "ultraino"},
    "drive.bottle": {"array": array, "air": AIR, "point": [0.0, 0.0, 0.2]},
    "drive.frame_times": {"stimuli": [StimulusConfig()], "duration_s": 0.1, "step_s": 0.01},
    "drive.solve_foci": {
        "points": [[0.0, 0.0, 0.2], [0.03, 0.0, 0.2]], "array": array, "air": AIR, "amplitudes": [1.0, 1.0],
        "iterations": 3, "seed": 1,
    },
    "drive.twin_trap": {"array": array, "air": AIR, "point": [0.0, 0.0, 0.2], "azimuth_rad": 0.1},
    "drive.vortex": {"array": array, "air": AIR, "point": [0.0, 0.0, 0.2], "order": 1},
    "hand.face_samples": {"vertices": BALL, "faces": FACES},
    "hand.hand_surface": {"preset": lambda: load_preset("open_men_p50"), "edge_m": 0.004},
    "hand.load_preset": {"name_or_path": "open_men_p50"},
    "skin.preset": {"name": "palm"},
    "skin.choices": {"body": SLAB, "load": SPOT, "times": [0.01], "at": [[0.0, 0.0]], "accuracy": 0.1, "device": "cpu"},
    "skin.solve": {
        "body": SLAB, "load": SPOT, "times": [0.01, 0.02], "at": [[0.0, 0.0]], "accuracy": 0.1, "device": "cpu",
    },
    "skin.static": {"body": SLAB, "load": SPOT, "at": [[0.0, 0.0]], "accuracy": 0.1},
    "skin.Sheet": {"material": preset("palm"), "thickness_m": 0.01},
    "skin.Slab": {"sheets": (Sheet(preset("palm"), 0.01),), "shape": "disc", "side": "free", "radius_m": 0.02},
    "skin.Spot": {"fwhm_m": 0.01, "times_s": [0.0, 0.1], "peak_Pa": [1.0, 0.0], "centre_m": [[0.0, 0.0], [0.0, 0.0]]},
    "skin.Branch": {"shear_Pa": 1e4, "time_s": 1e-3},
    "skin.Springs": {"normal_Pa_m": 1e6, "tangential_Pa_m": 1e6, "normal_Pa_s_m": 1.0, "tangential_Pa_s_m": 1.0},
    "drive.Pole": {"f0_Hz": 4e4, "Q": 20.0},
}  # fmt: skip
"""By name: arguments that are right; a function stands for an argument that takes time to make."""
OF_NUMBERS = (float("nan"), float("inf"), -float("inf"), -1.0, 0.0, 1e30, 1e-30, 2.5)
OF_TEXTS = ("", "x", "../x", "nan", "\0")


def odd_arrays(value: Any) -> Iterator[Any]:
    right = np.asarray(value)
    yield []
    yield float("nan")
    yield [[], []]
    yield right[:1]
    yield right[..., None]
    yield np.ravel(right)[:-1]
    if right.dtype != bool:
        for bad in (np.nan, np.inf):
            one = right.astype(complex if np.iscomplexobj(right) else float)
            one.flat[-1] = bad
            yield one
        yield -right
        yield 0 * right


def odd(value: Any) -> list[Any]:
    if isinstance(value, bool) or callable(value):
        return []
    if isinstance(value, int | float):
        return list(OF_NUMBERS)
    if isinstance(value, str):
        return list(OF_TEXTS)
    if isinstance(value, tuple) and all(isinstance(one, float) for one in value):
        return [value[::-1], (np.nan, 1.0), (0.0, np.inf), (0.0, 0.0), (-1.0, -2.0)]
    if isinstance(value, np.ndarray) or (isinstance(value, list) and not isinstance(value[0], StimulusConfig)):
        return list(odd_arrays(value))
    return []


def made(arguments: dict[str, Any]) -> dict[str, Any]:
    return {
        key: value() if callable(value) and not hasattr(value, "model_fields") else value
        for key, value in arguments.items()
    }


def called(name: str) -> Callable[..., Any]:
    package, _, function = name.partition(".")
    found: Callable[..., Any] = getattr(importlib.import_module(f"palmfield.{package}"), function)
    return found


def raw(function: Callable[..., Any], arguments: dict[str, Any]) -> str | None:
    """What is wrong with what becomes of a call; None where it is right."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        try:
            function(**arguments)
        except PalmfieldError as error:
            return None if str(error) and "\n" not in str(error).strip() else f"several lines: {error}"
        except Exception as error:
            return f"{type(error).__name__}: {error}"
    return None


@pytest.mark.parametrize("name", CALLS)
def test_odd_values_are_refused_by_name_or_taken(name: str) -> None:
    function, right = called(name), made(CALLS[name])
    function(**right)
    found = []
    for key, value in right.items():
        for number, one in enumerate(odd(value)):
            words = raw(function, right | {key: one})
            if words is not None:
                found.append(f"{key} #{number} {str(one)[:60]!r}: {words[:200]}")
    assert not found, "\n".join(found)


@pytest.mark.parametrize("size", [{"shape": "box", "side": "roller", "size_m": (1e-8, 1e-8)}, {"shape": "infinite"}])
def test_bodies_too_small_for_any_solver_are_refused(size: dict[str, Any]) -> None:
    with pytest.raises(PalmfieldError, match="is 1e-08 m; allowed"):
        Slab((Sheet(preset("palm"), 1e-8),), **size)
