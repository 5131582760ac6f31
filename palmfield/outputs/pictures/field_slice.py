"""The pressure in a plane through the focus and the middle of the first array."""

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from palmfield.acoustics.field import pressure
from palmfield.acoustics.phased_array import ArrayInstance
from palmfield.acoustics.placement import placed
from palmfield.config.array import ArrayConfig
from palmfield.errors import OutputError
from palmfield.outputs.frames import axes as axes_of
from palmfield.outputs.frames import foci_at, nearest, pose_at, to_local, to_world
from palmfield.outputs.pictures.asked import Asked, limits_of
from palmfield.outputs.recorded_keys import keys_of
from palmfield.outputs.schema import has_records, instances
from palmfield.transforms import IDENTITY, Placement
from palmfield.types import Air, Array, Complex, Float

SIDE_M = 0.12
"""Half the width of the slice."""
STEP_M = 0.0012
"""A seventh of a wavelength."""
BEYOND_M = 0.08
"""So far beyond the focus the slice goes."""
BEGINS_M = 0.01
"""So far before the array it begins: nearer than that the far field of a transducer is none."""
REACH_M = 0.3
"""Where nothing sounds, or nothing has a focus, the slice goes so far."""


def field_slice(result: xr.DataTree, asked: Asked) -> Figure:
    """Amplitude of the incident pressure in the x z plane of the first array that sounds, through the focus.

    As the arrays would sound in free air, with nothing in the way; the amplitudes and phases are those of the drive, so
    that the ringing of transducers is not in it. Transducers are those of the result: calibrated, tilted or one by one.
    Raises OutputError for a result of an earlier version with layout sites or csv, or a calibration, which it doesn't
    tell in full.
    """
    arrays = {
        name: array for name, array in instances(result, "array").items() if has_records(array, "drive_amplitude")
    }
    if not arrays:
        raise OutputError("the result holds no drives of an array; run at least one step")
    loud = {name: array["drive_amplitude"].values.sum(axis=1) for name, array in arrays.items()}
    first = max(loud, key=lambda name: float(loud[name].max()))
    times = arrays[first]["frame_time"].values
    index = int(loud[first].argmax()) if asked.time_s is None else nearest(times, asked.time_s)
    time_s = float(times[index])
    frame = pose_at(arrays[first], time_s)
    foci = _foci(result, time_s, frame)
    focus = foci.mean(axis=0) if len(foci) else np.array([0.0, 0.0, REACH_M - BEYOND_M])
    across = np.arange(-SIDE_M, SIDE_M + STEP_M, STEP_M) + focus[0]
    ahead = np.arange(BEGINS_M, focus[2] + BEYOND_M, STEP_M)
    x, z = np.meshgrid(across, ahead)
    points = to_world(np.column_stack([x.ravel(), np.full(x.size, focus[1]), z.ravel()]), frame)
    total: Complex = np.zeros(len(points), complex)
    for name, array in arrays.items():
        if not array["drive_amplitude"].values[nearest(array["frame_time"].values, time_s)].any():
            continue
        total += _sound(name, array, points, time_s)
    size = np.abs(total).reshape(x.shape)
    figure = Figure(figsize=(5.6, 5.6), layout="constrained")
    panel = figure.subplots()
    low, high = limits_of(asked, 0.0, float(size.max()))
    drawn = panel.pcolormesh(1e3 * across, 1e3 * ahead, size, cmap="magma", vmin=low, vmax=high, shading="nearest")
    if len(foci):
        panel.plot(1e3 * foci[:, 0], 1e3 * foci[:, 2], "+", color="white", ms=10, mew=1.4)
    panel.set(xlabel="array x [mm]", ylabel="array z [mm]", aspect="equal")
    panel.grid(visible=False)
    where = f"y = {1e3 * focus[1]:.0f} mm, {1e3 * time_s:.2f} ms"
    panel.set_title(f"Incident pressure at {where},\nin free air: {size.max():.0f} Pa at most")
    figure.colorbar(drawn, ax=panel, shrink=0.85, label="peak amplitude [Pa]")
    return figure


def _foci(result: xr.DataTree, time_s: float, frame: Float) -> Float:
    """Focal points that sound then [m], in the first array's frame, shape (n, 3)."""
    found = [np.empty((0, 3))]
    for stimulus in instances(result, "stimulus").values():
        if has_records(stimulus, "foci"):
            found.append(foci_at(stimulus, nearest(stimulus["time"].values, time_s)))
    return to_local(np.concatenate(found), frame)


def _sound(name: str, array: xr.Dataset, points: Float, time_s: float) -> Complex:
    """Complex amplitude [Pa] of one array at points of the world [m], shape (n, 3) -> (n,)."""
    config = keys_of(ArrayConfig, name, array)
    pose = pose_at(array, time_s)
    here = placed(_transducers(name, array, config), pose[:3], axes_of(pose).T)
    index = nearest(array["frame_time"].values, time_s)
    drive = array["drive_amplitude"].values[index] * np.exp(1j * array["drive_phase"].values[index])
    air = Air(config.temperature_C, config.humidity_percent, config.pressure_Pa)
    return pressure(points, here, drive.astype(complex), air, device="cpu", warn=False).pressure.astype(complex)


def _transducers(name: str, group: xr.Dataset, config: ArrayConfig) -> Array:
    """An array's transducers in its own frame, as the result has them; from its keys if it is of an earlier version."""
    if "transducer_p0" in group:
        phase = np.exp(1j * group["transducer_phase"].values)
        table = None
        if "off_axis_angle" in group:
            table = np.column_stack([group["off_axis_angle"].values, group["off_axis_level"].values])
        return Array(
            name,
            group["transducer_position"].values,
            group["transducer_direction"].values,
            1.0,
            piston_radius_m=float(group["piston_radius"].item()),
            gain=group["transducer_p0"].values * phase,
            directivity_table=table,
        )
    for key, found in (("layout", config.layout in ("sites", "csv")), ("calibration", config.calibration is not None)):
        if found:
            raise OutputError(
                f"array '{name}' has {key} {getattr(config, key)!r}, which this result, of an earlier version, doesn't "
                "hold in full: run the scene again"
            )
    return ArrayInstance(config, Placement.of(IDENTITY)).array()
