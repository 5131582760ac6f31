"""Compute the sound of the arrays of a result in free air, from its drives."""

import numpy as np
import xarray as xr

from palmfield.acoustics.directivities import FORMS
from palmfield.acoustics.field import pressure
from palmfield.acoustics.phased_array import ArrayInstance
from palmfield.acoustics.placement import placed
from palmfield.config.array import ArrayConfig
from palmfield.errors import OutputError
from palmfield.outputs.frames import arrays_of, axes, drive_frame, foci_at, nearest, pose_at
from palmfield.outputs.recorded_keys import keys_of
from palmfield.outputs.schema import has_records, instances
from palmfield.transforms import IDENTITY, Placement
from palmfield.types import Air, Array, Complex, Float


def driven_arrays(result: xr.DataTree) -> dict[str, xr.Dataset]:
    """Return the arrays with drives in a result. Raises OutputError if there are none."""
    listed = instances(result, "array").items()
    arrays = {name: array for name, array in listed if has_records(array, "drive_amplitude")}
    if not arrays:
        raise OutputError("the result contains no drives of an array; run at least one step")
    return arrays


def sounding_foci(result: xr.DataTree, time_s: float, array: str | None = None) -> Float:
    """Return active focal points at a time, in the world [m], shape (n, 3). array: only those of this array"""
    found = [np.empty((0, 3))]
    for stimulus in instances(result, "stimulus").values():
        of_it = array is None or array in arrays_of(stimulus, list(instances(result, "array")))
        if of_it and has_records(stimulus, "foci"):
            found.append(foci_at(stimulus, nearest(stimulus["time"].values, time_s)))
    return np.concatenate(found)


def sound_at(arrays: dict[str, xr.Dataset], points: Float, time_s: float) -> Complex:
    """Return the complex amplitude [Pa] of all arrays at points in the world [m], shape (n, 3) -> (n,), at a time [s].

    arrays: as returned by `driven_arrays`. Obstacles are ignored. Amplitudes and phases are those of the drive, so
    ring-up is not included. Transducers are read from the result, with calibration and tilt. Raises OutputError for a
    result of an earlier version with layout sites or csv, or with a calibration, which it does not store completely.
    """
    total: Complex = np.zeros(len(points), complex)
    for name, array in arrays.items():
        index = drive_frame(array, time_s)
        if array["drive_amplitude"].values[index].any():
            total += _sound(name, array, points, time_s, index)
    return total


def _sound(name: str, array: xr.Dataset, points: Float, time_s: float, index: int) -> Complex:
    """Return the complex amplitude [Pa] of one array at points in the world [m], shape (n, 3) -> (n,)."""
    config = keys_of(ArrayConfig, name, array)
    pose = pose_at(array, time_s)
    here = placed(_transducers(name, array, config), pose[:3], axes(pose).T)
    drive = array["drive_amplitude"].values[index] * np.exp(1j * array["drive_phase"].values[index])
    air = Air(config.temperature_C, config.humidity_percent, config.pressure_Pa)
    return pressure(points, here, drive.astype(complex), air, device="cpu", warn=False).pressure.astype(complex)


def _transducers(name: str, group: xr.Dataset, config: ArrayConfig) -> Array:
    """Return the transducers of an array in its own frame.

    They come from the result, or for an earlier version from its keys.
    """
    if "transducer_p0" in group:
        gain = group["transducer_p0"].values * np.exp(1j * group["transducer_phase"].values)
        table, radius_m = None, float(group["piston_radius"].item())
        if "off_axis_angle" in group:
            table = np.column_stack([group["off_axis_angle"].values, group["off_axis_level"].values])
        places, directions = group["transducer_position"].values, group["transducer_direction"].values
        sounds = Array(name, places, directions, 1.0, piston_radius_m=radius_m, gain=gain, directivity_table=table)
        return FORMS[config.directivity].of(sounds) if config.directivity in FORMS else sounds
    for key, found in (("layout", config.layout in ("sites", "csv")), ("calibration", config.calibration is not None)):
        if found:
            raise OutputError(
                f"array '{name}' has {key} {getattr(config, key)!r}, which this result of an earlier version does "
                "not store completely: run the scene again"
            )
    return ArrayInstance(config, Placement.of(IDENTITY)).array()
