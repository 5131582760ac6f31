"""Sample the sound of a scene over its play, for safety estimates."""

import logging
from collections.abc import Iterator

import numpy as np

from palmfield.acoustics.exposure import radiated_power_W
from palmfield.acoustics.phased_array import PhasedArray
from palmfield.engine.scene_runtime import SceneRuntime
from palmfield.estimate.array_inputs import p0_band_at
from palmfield.hardware.safety.exposure import Exposure, SoundMoment, at_head, check_head, with_band
from palmfield.session.preview import Preview
from palmfield.simulation.posed_scene import PosedScene
from palmfield.types import Complex, Float

LOG = logging.getLogger(__name__)
MOMENTS = 96
"""Number of sampled moments of a play. They are shifted irregularly, so that they are not synchronous with a period."""
GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)


def moments_of(count: int, duration_s: float) -> Float:
    """Return rising times, one in each of `count` equal intervals of a duration [s]."""
    number = np.arange(count)
    return (number + np.modf((number + 1) * GOLDEN)[0]) * duration_s / count


def drives_over(view: Preview, duration_s: float) -> Iterator[tuple[float, SceneRuntime, PosedScene, Complex]]:
    """Yield for each time of `moments_of`: the time [s], runtime, pose, and drive of all transducers, shape (N,)."""
    for time_s, runtime, posed in view.posed_at(moments_of(MOMENTS, duration_s).tolist()):
        runtime.work.emission.begin(posed, time_s)
        yield time_s, runtime, posed, runtime.work.emission.commanded(posed, np.array([time_s]))[0]


def sound_of(drives: list[tuple[PhasedArray, Complex]]) -> list[SoundMoment]:
    """Return the moments that are not silent."""

    def moment(arrays: PhasedArray, drive: Complex) -> SoundMoment:
        return SoundMoment(lambda points: arrays.field.pressure(points, drive).pressure, 1.0 / len(drives))

    return [moment(arrays, drive) for arrays, drive in drives if drive.any()]


def scene_at_head(view: Preview, duration_s: float) -> Exposure:
    """Return the sound at the head that the keys of the driver define, with the band due to the range of p0.

    The errors are those of `palmfield.hardware.safety.exposure.at_head`.
    """
    model = view.runtime.model
    drives = [(posed.arrays, drive) for *_, posed, drive in drives_over(view, duration_s)]
    loudest = at_head(sound_of(drives), model.spec.driver, model.arrays.array.positions)
    return banded(view, drives, loudest)


def warn_at_head(view: Preview, duration_s: float) -> None:
    """Log warnings about the sound at the head, if the keys of the driver define a head.

    Raises DeviceError if the level is above key head_limit_dB, and the errors of `scene_at_head`.
    """
    driver = view.runtime.spec.driver
    for line in check_head(scene_at_head(view, duration_s), driver) if driver.head_m is not None else ():
        LOG.warning(line)


def banded(view: Preview, drives: list[tuple[PhasedArray, Complex]], loudest: Exposure) -> Exposure:
    """Add the bands due to the range of p0, at the loudest moment."""
    if loudest.peak_Pa <= 0.0:
        return loudest
    loudness = [abs(arrays.pressure64(loudest.place[None], drive)[0]) for arrays, drive in drives]
    arrays, drive = drives[int(np.argmax(loudness))]
    return with_band(loudest, p0_band_at(view.runtime.model, arrays, drive, loudest.place))


def power_W(arrays: PhasedArray, drive: Complex) -> float:
    """Return the sound power of all arrays [W]."""
    return sum(
        radiated_power_W(part, drive[own], arrays.air) for part, own in zip(arrays.parts, arrays.slices, strict=True)
    )
