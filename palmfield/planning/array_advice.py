"""Advice on the arrays of a scene before the run: numbers that seem to be in another unit."""

import numpy as np

from palmfield.acoustics.layouts import LAYOUTS
from palmfield.acoustics.transducer import ANY_P0
from palmfield.simulation.model import HapticModel, array_instances
from palmfield.simulation.validate import pitch_m

TOUCHING = 0.99
"""Share of two pistons' radii below which the distance of their centres is doubtful."""
DRY_PERCENT = 1.0
"""No room is drier: a lower humidity was probably given as a share."""
MEDIAN_GAIN = 2.0
"""Factor of the median transducer's level relative to p0 beyond which the level is in the wrong key."""
FAR_OFF_M = 0.05
"""A calibration that moves a board farther was measured in another frame, or in another unit."""
WIDE = 10.0
"""Ratio of a range's ends beyond which it is not a measurement."""
UNLIKELY = 3.0
"""Factor beyond the values of real transducers from which a p0 is doubtful."""


def array_advice(model: HapticModel) -> list[str]:
    """Warnings of arrays."""
    return _unlikely_p0(model) + _crowded(model) + _dry(model) + _calibrations(model)


def _unlikely_p0(model: HapticModel) -> list[str]:
    """Whether p0 is far from that of any real transducer: most likely it is in another unit."""
    result = []
    known = [ANY_P0, *(layout.p0 for layout in LAYOUTS.values())]
    least, most = min(one.low for one in known), max(one.high for one in known)
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
    """Whether transducers of an array overlap: places in another unit, or pistons of another size."""
    result = []
    for array, part in zip(model.spec.arrays, model.arrays.parts, strict=True):
        apart, wide = pitch_m(part.positions), 2.0 * part.piston_radius_m
        if apart < TOUCHING * wide:
            result.append(
                f"transducers of array '{array.name}' are {1e3 * apart:.3g} mm apart, but their pistons are "
                f"{1e3 * wide:.3g} mm wide: check the unit of the positions, or set piston_radius_m"
            )
    return result


def _dry(model: HapticModel) -> list[str]:
    """Whether the air is drier than any room: most likely its humidity is a share."""
    return [
        f"humidity_percent of array '{array.name}' is {array.config.humidity_percent:g}, drier than any room: "
        "check the unit (percent)"
        for array in model.spec.arrays
        if 0.0 < array.config.humidity_percent <= DRY_PERCENT
    ]


def _calibrations(model: HapticModel) -> list[str]:
    """Whether a laboratory's calibration has values unlike any board: levels and places in another unit."""
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
                    f"{says} has gains of about {middle:.3g}; gains are relative to p0: put the level into p0, and "
                    "keep gains near 1"
                )
        off_m = float(np.linalg.norm(known.pose.offset_m))
        if off_m > FAR_OFF_M:
            result.append(f"{says} displaces the board by {off_m:.3g} m: check the unit (metres) and the frame")
        if known.p0 is not None and known.p0.high > WIDE * known.p0.low:
            result.append(
                f"{says} has a p0 of {known.p0.low:g} to {known.p0.high:g} Pa m, which is too wide to be useful: "
                "measure it again"
            )
    return result
