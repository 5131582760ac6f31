"""Draw the pressure in a plane through the focus and the centre of the first array."""

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from palmfield.outputs.frames import pose_at, to_local, to_world
from palmfield.outputs.pictures.options import Kind, Options, chosen_frame, limits_of
from palmfield.outputs.sound import driven_arrays, sound_at, sounding_foci
from palmfield.outputs.style import beyond

SIDE_M = 0.12
"""Half the width of the slice [m]."""
STEP_M = 0.0012
"""Spacing of points [m], a seventh of a wavelength."""
BEYOND_M = 0.08
"""Distance by which the slice extends beyond the focus [m]."""
BEGINS_M = 0.01
"""Distance at which the slice begins, from the array [m]. Closer points are not in the far field of a transducer."""
REACH_M = 0.3
"""Length of the slice if there is no sound, or no focus [m]."""


def field_slice(result: xr.DataTree, options: Options) -> Figure:
    """Draw the amplitude of the incident pressure through the loudest focus of the array with the highest drive, in its
    x-z plane.

    This is the field in free air, without obstacles. Amplitudes and phases are those of the drive, so ring-up is not
    included. Transducers are read from the result, with calibration and tilt.
    Raises OutputError for a result of an earlier version with layout sites or csv, or with a calibration, which it does
    not store completely.
    """
    arrays = driven_arrays(result)
    loud = {name: array["drive_amplitude"].values.sum(axis=1) for name, array in arrays.items()}
    first = max(loud, key=lambda name: float(loud[name].max()))
    _, time_s = chosen_frame(result, arrays[first], options)
    frame = pose_at(arrays[first], time_s)
    places = sounding_foci(result, time_s, first)
    foci = to_local(places, frame)
    focus = np.array([0.0, 0.0, REACH_M - BEYOND_M])
    if len(foci):
        focus = foci[np.abs(sound_at(arrays, places, time_s)).argmax()]
    across = np.arange(-SIDE_M, SIDE_M + STEP_M, STEP_M) + focus[0]
    ahead = np.arange(BEGINS_M, focus[2] + BEYOND_M, STEP_M)
    x, z = np.meshgrid(across, ahead)
    points = to_world(np.column_stack([x.ravel(), np.full(x.size, focus[1]), z.ravel()]), frame)
    size = np.abs(sound_at(arrays, points, time_s)).reshape(x.shape)
    figure = Figure(figsize=(5.6, 5.6), layout="constrained")
    panel = figure.subplots()
    low, high = limits_of(options, 0.0, float(size.max()))
    drawn = panel.pcolormesh(1e3 * across, 1e3 * ahead, size, cmap="magma", vmin=low, vmax=high, shading="nearest")
    if len(foci):
        panel.plot(1e3 * foci[:, 0], 1e3 * foci[:, 2], "+", color="white", ms=10, mew=1.4)
    panel.set(xlabel="array x [mm]", ylabel="array z [mm]", aspect="equal")
    panel.grid(visible=False)
    where = f"y = {1e3 * focus[1]:.0f} mm, {1e3 * time_s:.2f} ms"
    panel.set_title(f"Incident pressure at {where},\nin free air: maximum {size.max():.0f} Pa")
    figure.colorbar(drawn, ax=panel, shrink=0.85, label="peak amplitude [Pa]", extend=beyond(size, low, high))
    return figure


ABOUT = "incident pressure in a plane through array and focus, in free air"
KINDS = {"field": Kind(field_slice, ABOUT, frozenset({"time_s", "limits"}), "Pa", 2)}
