"""Options of a picture, and the selection of data from a result by these options."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Literal, NamedTuple, cast

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from palmfield.errors import OutputError, did_you_mean, refuse_unknown
from palmfield.outputs.frames import check_time, drive_frame, in_world, nearest
from palmfield.outputs.motion import extremes
from palmfield.outputs.schema import RECORDS, has_records, instances
from palmfield.outputs.skin_view import probe_vertices
from palmfield.types import Float

Quantity = Literal["displacement", "velocity"]
IN_MICRO = 1e6
UNITS: dict[Quantity, str] = {"displacement": "µm", "velocity": "µm/s"}
"""Units equal to 1e-6 of the SI unit of the quantity."""
FAR_M = 0.01
"""Largest distance of a requested place from the skin [m]."""
MISS_SHOWN_M = 5e-4
"""Distance between requested place and vertex above which a picture states it [m]."""


@dataclass(frozen=True)
class Options:
    """Options of a picture.

    time_s: requested time [s]; None for the default time of the kind
    places: points in the world at the start of the run [m]; the nearest vertex to each is used
    limits: limits of the colours or the axis, in the unit of the picture
    skin: name of the skin, if there are several
    quantity: quantity of the motion of the skin along its outward normal
    observer: name of the observer of levels; None for all observers with a value
    """

    time_s: float | None = None
    places: tuple[tuple[float, float, float], ...] = ()
    limits: tuple[float, float] | None = None
    skin: str | None = None
    quantity: Quantity = "displacement"
    observer: str | None = None


ALL = frozenset(one.name for one in fields(Options))
Draw = Callable[[xr.DataTree, Options], Figure]


class Kind(NamedTuple):
    """A kind of picture.

    draw: function that draws it; raises OutputError or MeasurementError if the result lacks data
    about: description in one sentence
    heeds: options of `Options` that change the picture, default all
    unit: unit of its limits
    place: order in lists: sound (1 to 9), maps of the skin (10 to 19), motion over time (20 to 29)
    """

    draw: Draw
    about: str
    heeds: frozenset[str] = ALL
    unit: str = ""
    place: int = 99

    @classmethod
    def of_motion(cls, draw: Draw, about: str, *more: str, place: int, unit: str = "µm or µm/s") -> "Kind":
        """Return a kind of picture that shows the motion of a skin; more: further options that it uses."""
        return cls(draw, about, frozenset({"places", "limits", "skin", "quantity", *more}), unit, place)


def parse_options(
    time_ms: float | None,
    places_mm: Sequence[str],
    limits: str | None,
    skin: str | None,
    quantity: str,
    observer: str | None,
) -> Options:
    """Parse options of a command line: times in ms, places "X,Y,Z" in mm, limits "LOW,HIGH".

    Raises OutputError for an unknown quantity, and for texts that do not have the right number of finite numbers.
    """
    refuse_unknown(OutputError, "--quantity has value {}", quantity, UNITS)
    in_mm = [_numbers("--place", text, 3) for text in places_mm]
    ends = None if limits is None else _numbers("--limits", limits, 2)
    if ends is not None and not ends[0] < ends[1]:
        raise OutputError(f"--limits has value '{limits}'; allowed: a lower number, then a higher one")
    time_s = None if time_ms is None else 1e-3 * time_ms
    places = tuple((1e-3 * x, 1e-3 * y, 1e-3 * z) for x, y, z in in_mm)
    between = None if ends is None else (ends[0], ends[1])
    return Options(time_s, places, between, skin, cast(Quantity, quantity), observer)


def _numbers(option: str, text: str, count: int) -> list[float]:
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != count or not np.isfinite(values).all():
        raise OutputError(f"{option} has value '{text}'; allowed: {count} numbers separated by commas")
    return values


def chosen_names(result: xr.DataTree, options: Options) -> list[str]:
    """Return the names of all skins, or of the requested skin. Raises OutputError for an unknown name."""
    skins = list(instances(result, "skin"))
    if options.skin is None:
        return skins
    if options.skin not in skins:
        near = did_you_mean(options.skin, skins)
        raise OutputError(f"--skin has value '{options.skin}'{near}; the result has: {', '.join(skins) or 'no skin'}")
    return [options.skin]


def chosen_skin(result: xr.DataTree, options: Options, variable: str) -> tuple[str, xr.Dataset]:
    """Return name and group of the requested skin, which must have a variable over time.

    Raises OutputError if no skin has the variable, if several have it and none is requested, and for an unknown name.
    """
    skins = instances(result, "skin")
    recorded = {name: skins[name] for name in chosen_names(result, options) if has_records(skins[name], variable)}
    if not recorded:
        raise OutputError(f"the result contains no {variable} of a skin; run at least one step with it")
    return next(iter(recorded.items()))


def chosen_time(skin: xr.Dataset, options: Options, otherwise: int) -> int:
    """Return the requested index along `time`. Raises OutputError for a time outside the run."""
    times: Float = skin["time"].values
    if options.time_s is None:
        return otherwise
    check_time("--time", options.time_s, float(times[0]), float(times[-1]))
    return nearest(times, options.time_s)


def chosen_frame(result: xr.DataTree, array: xr.Dataset, options: Options) -> tuple[int, float]:
    """Return the index along `frame_time` of the drive at the requested time, and this time.

    The default is the time of the loudest drive. Raises OutputError for a time outside the run.
    """
    starts: Float = array["frame_time"].values
    if options.time_s is None:
        loudest = int(array["drive_amplitude"].values.sum(axis=1).argmax())
        return loudest, float(starts[loudest])
    coords = result.coords
    ends = [float(coords[name].values[-1]) for name in RECORDS if name in coords and coords[name].size]
    check_time("--time", options.time_s, float(starts[0]), max(ends))
    return drive_frame(array, options.time_s), options.time_s


def chosen_vertices(result: xr.DataTree, name: str, skin: xr.Dataset, options: Options) -> list[tuple[int, str]]:
    """Return vertices and their descriptions: those nearest to the requested places, or around the largest motion.

    Raises OutputError for a place that is not on the skin.
    """
    if not options.places:
        rest = skin["rest_position"].values
        found = probe_vertices(rest, extremes(skin, options.quantity).peak)
        return [(v, "largest motion" if far == 0 else f"{1e3 * far:.1f} mm away") for v, far in found]
    begins = float(skin["time"].values[0])
    vertices = in_world(skin, instances(result, "body").get(name), begins)
    out = []
    for place in options.places:
        away = np.linalg.norm(vertices - np.array(place), axis=1)
        vertex = int(away.argmin())
        given = ", ".join(f"{1e3 * x:g}" for x in place)
        if away[vertex] > FAR_M:
            middle = ", ".join(f"{1e3 * x:.0f}" for x in vertices.mean(axis=0))
            raise OutputError(
                f"--place has value {given} mm, {1e3 * away[vertex]:.3g} mm from skin '{name}'; allowed: at most "
                f"{1e3 * FAR_M:g} mm (the centre of the skin is at {middle} mm)"
            )
        off = f", vertex {1e3 * away[vertex]:.1f} mm away" if away[vertex] > MISS_SHOWN_M else ""
        out.append((vertex, f"({given}) mm{off}"))
    return out


def limits_of(options: Options, low: float, high: float) -> tuple[float, float]:
    """Return the requested limits, or else `low` and `high`. Equal limits are widened."""
    if options.limits is not None:
        return options.limits
    return low, high if high > low else low + 1e-9
