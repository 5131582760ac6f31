"""Warn of values of arrays that seem to be in another unit."""

import numpy as np

from palmfield.acoustics.layouts import LAYOUTS
from palmfield.acoustics.transducer import ANY_P0
from palmfield.simulation.model import HapticModel, array_instances
from palmfield.simulation.validate import pitch_m

TOUCHING = 0.99
"""Distance of two transducers, relative to the piston diameter, below which they overlap."""
DRY_PERCENT = 1.0
"""Lowest plausible humidity; a lower one was probably given as a fraction."""
MEDIAN_GAIN = 2.0
"""Median gain of transducers above which the level was probably put into gains instead of p0."""
FAR_OFF_M = 0.05
"""Largest plausible displacement of a board by a calibration; beyond it frame or unit are probably wrong [m]."""
WIDE = 10.0
"""Ratio of the ends of a range above which it is not a useful measurement."""
UNLIKELY = 3.0
"""Factor outside the values of real transducers from which p0 is implausible."""


def array_advice(model: HapticModel) -> list[str]:
    """Return warnings on arrays."""
    return _unlikely_p0(model) + _crowded(model) + _dry(model) + _calibrations(model)


def _unlikely_p0(model: HapticModel) -> list[str]:
    """Warn if p0 is far from that of any real transducer, probably because of the unit."""
    result = []
    typical = [ANY_P0, *(layout.p0 for layout in LAYOUTS.values())]
    least, most = min(one.low for one in typical), max(one.high for one in typical)
    for array, instance in zip(model.spec.arrays, array_instances(model.spec), strict=True):
        p0, whence = instance.p0.value, instance.p0.source
        if least / UNLIKELY <= p0 <= UNLIKELY * most:
            continue
        result.append(
            f"p0 of array '{array.name}' is {p0:g} Pa m ({whence}); known transducers have {least:g} to {most:g}: "
            "check the unit (peak pressure in Pa at 1 m at full drive)"
        )
    return result


def _crowded(model: HapticModel) -> list[str]:
    """Warn if transducers of an array overlap, because of the unit of positions or the piston radius."""
    result = []
    for array, part in zip(model.spec.arrays, model.arrays.parts, strict=True):
        pitch, wide = pitch_m(part.positions), 2.0 * part.piston_radius_m
        if pitch < TOUCHING * wide:
            result.append(
                f"transducers of array '{array.name}' are {1e3 * pitch:.3g} mm apart, but their pistons are "
                f"{1e3 * wide:.3g} mm wide: check the unit of the positions, or set piston_radius_m"
            )
    return result


def _dry(model: HapticModel) -> list[str]:
    """Warn if the air is drier than any room, probably because the humidity is a fraction."""
    return [
        f"humidity_percent of array '{array.name}' is {array.config.humidity_percent:g}, drier than any room: "
        "check the unit (percent)"
        for array in model.spec.arrays
        if 0.0 < array.config.humidity_percent <= DRY_PERCENT
    ]


def _calibrations(model: HapticModel) -> list[str]:
    """Warn if a calibration has implausible values, probably because of the unit of levels or positions."""
    result = []
    for array, instance in zip(model.spec.arrays, array_instances(model.spec), strict=True):
        one = instance.calibration
        if one is None:
            continue
        what = f"the calibration of array '{array.name}'"
        if one.elements is not None:
            middle = float(np.median(np.array(one.elements.gain)[np.array(one.elements.enabled)]))
            if not 1.0 / MEDIAN_GAIN <= middle <= MEDIAN_GAIN:
                result.append(
                    f"{what} has gains of about {middle:.3g}; gains are relative to p0: put the level into p0, and "
                    "keep gains near 1"
                )
        off_m = float(np.linalg.norm(one.pose.offset_m))
        if off_m > FAR_OFF_M:
            result.append(f"{what} displaces the board by {off_m:.3g} m: check the unit (metres) and the frame")
        if one.p0 is not None and one.p0.high > WIDE * one.p0.low:
            result.append(
                f"{what} has a p0 of {one.p0.low:g} to {one.p0.high:g} Pa m, which is too wide to be useful: "
                "measure it again"
            )
    return result
