"""The kinds of pictures, by name: what `palmfield plot` can draw."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import xarray as xr
from matplotlib.figure import Figure

from palmfield.errors import OutputError
from palmfield.outputs.pictures.asked import Asked, chosen_names
from palmfield.outputs.pictures.courses import course, spectrogram, spectrum
from palmfield.outputs.pictures.drives import drives
from palmfield.outputs.pictures.field_slice import field_slice
from palmfield.outputs.pictures.maps import level_map_of, motion_map, rms_map
from palmfield.outputs.pictures.wavefronts import wavefronts
from palmfield.outputs.plots import pressure_picture


class Kind(NamedTuple):
    """draw: raises OutputError or MeasurementError where the result doesn't hold what it needs; about: a sentence

    heeds: what of `Asked` changes the picture; unit: of its limits
    """

    draw: Callable[[xr.DataTree, Asked], Figure]
    about: str
    heeds: frozenset[str]
    unit: str = ""


def _pressure(result: xr.DataTree, asked: Asked) -> Figure:
    """Peak pressure amplitude and ARP on each skin when loudest, or at a time, seen from the array that it faces."""
    return pressure_picture(result, chosen_names(result, asked), asked.time_s)


MOTION = frozenset({"places", "limits", "skin", "quantity"})
MICRO = "µm or µm/s"
KINDS = {
    "pressure": Kind(
        _pressure, "peak pressure and ARP on each skin when they are largest", frozenset({"time_s", "skin"})
    ),
    "field": Kind(
        field_slice,
        "incident pressure in a plane through array and focus, in free air",
        frozenset({"time_s", "limits"}),
        "Pa",
    ),
    "drives": Kind(drives, "phase and amplitude of each transducer", frozenset({"time_s"})),
    "motion": Kind(motion_map, "normal displacement or velocity of the skin at a time", MOTION | {"time_s"}, MICRO),
    "rms": Kind(rms_map, "root mean square of the skin's motion over the run", MOTION, MICRO),
    "levels": Kind(
        level_map_of,
        "level above threshold on the skin, by observer",
        frozenset({"places", "limits", "skin", "observer"}),
        "dB SL",
    ),
    "course": Kind(course, "the skin's motion over time at a few places", MOTION, MICRO),
    "spectrum": Kind(spectrum, "its amplitude spectrum", MOTION, MICRO),
    "spectrogram": Kind(spectrogram, "its power over time and frequency", MOTION, "dB"),
    "wavefronts": Kind(wavefronts, "motion along a line over the skin, over time", MOTION, MICRO),
}
OPTIONS = {
    "time_s": "--time",
    "places": "--place",
    "limits": "--limits",
    "skin": "--skin",
    "quantity": "--quantity",
    "observer": "--observer",
}


def check_heeded(kinds: Sequence[str], asked: Asked) -> None:
    """Raises OutputError where none of the kinds heeds what is asked, and for limits of kinds with several units."""
    for name, option in OPTIONS.items():
        if getattr(asked, name) != getattr(Asked(), name) and not any(name in KINDS[kind].heeds for kind in kinds):
            able = [kind for kind, one in KINDS.items() if name in one.heeds]
            raise OutputError(f"{option} changes nothing in {', '.join(kinds)}; it is for: {', '.join(able)}")
    units = list(dict.fromkeys(KINDS[kind].unit for kind in kinds if "limits" in KINDS[kind].heeds))
    if asked.limits is not None and len(units) > 1:
        raise OutputError(f"--limits would be of several units ({', '.join(units)}); name kinds of one unit")
