"""What a user should know of a scene's arrays before the run: numbers that look as if in another unit."""

import numpy as np

from palmfield.acoustics.layouts import LAYOUTS
from palmfield.acoustics.transducer import ANY_P0
from palmfield.simulation.model import HapticModel, array_instances
from palmfield.simulation.validate import pitch_m

TOUCHING = 0.99
"""Of two pistons' radii, below which their middles are doubted."""
DRY_PERCENT = 1.0
"""No room is drier: below it the humidity is taken for a share."""
MEDIAN_GAIN = 2.0
"""Transducers whose middle one is so many times louder or softer than p0 have their level in the wrong place."""
FAR_OFF_M = 0.05
"""A board that a calibration moves farther was measured in another frame, or in another unit."""
WIDE = 10.0
"""Ends of a range whose ratio is more say that nothing was measured."""
UNLIKELY = 3.0
"""So many times beyond what is known of any transducer a p0 is doubted."""


def array_advice(model: HapticModel) -> list[str]:
    """Warnings of arrays."""
    return _unlikely_p0(model) + _crowded(model) + _dry(model) + _calibrations(model)


def _unlikely_p0(model: HapticModel) -> list[str]:
    """Whether p0 is far from that of any transducer that is known: most likely it is in another unit."""
    result = []
    known = [ANY_P0, *(layout.p0 for layout in LAYOUTS.values())]
    least, most = min(one.low for one in known), max(one.high for one in known)
    for array, instance in zip(model.spec.arrays, array_instances(model.spec), strict=True):
        p0, whence = instance.p0.value, instance.p0.source
        if least / UNLIKELY <= p0 <= UNLIKELY * most:
            continue
        result.append(
            f"p0 of array '{array.name}' is {p0:g} Pa m ({whence}), that of known transducers {least:g} to {most:g}: "
            "look at the unit, which is pascals at 1 m, peak, at full drive"
        )
    return result


def _crowded(model: HapticModel) -> list[str]:
    """Whether transducers of an array stand in one another: places in another unit, or pistons of another size."""
    result = []
    for array, part in zip(model.spec.arrays, model.arrays.parts, strict=True):
        apart, wide = pitch_m(part.positions), 2.0 * part.piston_radius_m
        if apart < TOUCHING * wide:
            result.append(
                f"transducers of array '{array.name}' are {1e3 * apart:.3g} mm apart, and their pistons "
                f"{1e3 * wide:.3g} mm wide: look at the unit of their places, or set piston_radius_m"
            )
    return result


def _dry(model: HapticModel) -> list[str]:
    """Whether the air is drier than any room: most likely its humidity is a share."""
    return [
        f"humidity_percent of array '{array.name}' is {array.config.humidity_percent:g}, drier than any room: look at "
        "the unit, which is percent"
        for array in model.spec.arrays
        if 0.0 < array.config.humidity_percent <= DRY_PERCENT
    ]


def _calibrations(model: HapticModel) -> list[str]:
    """Whether a laboratory's calibration says what no board is like: levels and places in another unit."""
    result = []
    for array, instance in zip(model.spec.arrays, array_instances(model.spec), strict=True):
        known = instance.calibration
        if known is None:
            continue
        says = f"the calibration of array '{array.name}'"
        if known.elements is not None:
            middle = float(np.median(np.array(known.elements.gain)[np.array(known.elements.enabled)]))
            if not 1.0 / MEDIAN_GAIN <= middle <= MEDIAN_GAIN:
                result.append(
                    f"{says} has gains about {middle:.3g}, which are relative to p0: put the level into p0, or leave "
                    "them at about 1"
                )
        off_m = float(np.linalg.norm(known.pose.offset_m))
        if off_m > FAR_OFF_M:
            result.append(
                f"{says} has its board {off_m:.3g} m off: look at the unit, which is metres, and at the frame"
            )
        if known.p0 is not None and known.p0.high > WIDE * known.p0.low:
            result.append(
                f"{says} has a p0 of {known.p0.low:g} to {known.p0.high:g} Pa m, so wide that it says nothing: measure "
                "it again"
            )
    return result
