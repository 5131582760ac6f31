"""The sound of a result's arrays in free air, computed again from its drives."""

import numpy as np
import xarray as xr

from palmfield.acoustics.field import pressure
from palmfield.acoustics.phased_array import ArrayInstance
from palmfield.acoustics.placement import placed
from palmfield.config.array import ArrayConfig
from palmfield.errors import OutputError
from palmfield.outputs.frames import axes, foci_at, nearest, pose_at
from palmfield.outputs.recorded_keys import keys_of
from palmfield.outputs.schema import has_records, instances
from palmfield.transforms import IDENTITY, Placement
from palmfield.types import Air, Complex, Float


def driven_arrays(result: xr.DataTree) -> dict[str, xr.Dataset]:
    """The arrays of which a result holds drives. Raises OutputError where there are none."""
    arrays = {
        name: array for name, array in instances(result, "array").items() if has_records(array, "drive_amplitude")
    }
    if not arrays:
        raise OutputError("the result holds no drives of an array; run at least one step")
    return arrays


def sounding_foci(result: xr.DataTree, time_s: float) -> Float:
    """Focal points that sound at a time, in the world [m], shape (n, 3)."""
    found = [np.empty((0, 3))]
    for stimulus in instances(result, "stimulus").values():
        if has_records(stimulus, "foci"):
            found.append(foci_at(stimulus, nearest(stimulus["time"].values, time_s)))
    return np.concatenate(found)


def sound_at(arrays: dict[str, xr.Dataset], points: Float, time_s: float) -> Complex:
    """Complex amplitude [Pa] of the arrays' sound at points of the world [m], shape (n, 3) -> (n,), at a time [s].

    arrays: of `driven_arrays`. With nothing in the way; amplitudes and phases are those of the drive, so that the
    ringing of transducers is not in it. Raises OutputError for arrays whose transducers the result doesn't tell in full
    (layouts sites and csv, calibrations).
    """
    total: Complex = np.zeros(len(points), complex)
    for name, array in arrays.items():
        if array["drive_amplitude"].values[nearest(array["frame_time"].values, time_s)].any():
            total += _sound(name, array, points, time_s)
    return total


def _sound(name: str, array: xr.Dataset, points: Float, time_s: float) -> Complex:
    config = keys_of(ArrayConfig, name, array)
    for key, found in (("layout", config.layout in ("sites", "csv")), ("calibration", config.calibration is not None)):
        if found:
            raise OutputError(
                f"array '{name}' has {key} {getattr(config, key)!r}, which a result does not hold in full; the field "
                "is drawn of layouts by name without calibration"
            )
    pose = pose_at(array, time_s)
    own = ArrayInstance(config, Placement.of(IDENTITY)).array()
    here = placed(own, pose[:3], axes(pose).T)
    index = nearest(array["frame_time"].values, time_s)
    drive = array["drive_amplitude"].values[index] * np.exp(1j * array["drive_phase"].values[index])
    air = Air(config.temperature_C, config.humidity_percent, config.pressure_Pa)
    return pressure(points, here, drive.astype(complex), air, device="cpu", warn=False).pressure.astype(complex)
