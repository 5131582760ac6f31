"""The kinds of pictures, by name: what `palmfield plot` can draw."""

from collections.abc import Callable
from typing import NamedTuple

import xarray as xr
from matplotlib.figure import Figure

from palmfield.outputs.pictures.asked import Asked
from palmfield.outputs.pictures.courses import course, spectrogram, spectrum
from palmfield.outputs.pictures.drives import drives
from palmfield.outputs.pictures.field_slice import field_slice
from palmfield.outputs.pictures.maps import level_map_of, motion_map, rms_map
from palmfield.outputs.pictures.wavefronts import wavefronts
from palmfield.outputs.plots import pressure_picture


class Kind(NamedTuple):
    """draw: raises OutputError or MeasurementError where the result doesn't hold what it needs; about: a sentence"""

    draw: Callable[[xr.DataTree, Asked], Figure]
    about: str


def _pressure(result: xr.DataTree, asked: Asked) -> Figure:
    """Peak pressure amplitude and ARP on each skin at its loudest instant, seen from the array that it faces."""
    return pressure_picture(result)


KINDS = {
    "pressure": Kind(_pressure, "peak pressure and ARP on each skin when they are largest"),
    "field": Kind(field_slice, "incident pressure in a plane through array and focus, in free air"),
    "drives": Kind(drives, "phase and amplitude of each transducer"),
    "motion": Kind(motion_map, "normal displacement or velocity of the skin at a time"),
    "rms": Kind(rms_map, "root mean square of the skin's motion over the run"),
    "levels": Kind(level_map_of, "level above threshold on the skin, by observer"),
    "course": Kind(course, "the skin's motion over time at a few places"),
    "spectrum": Kind(spectrum, "its amplitude spectrum"),
    "spectrogram": Kind(spectrogram, "its power over time and frequency"),
    "wavefronts": Kind(wavefronts, "motion along a line over the skin, over time"),
}
