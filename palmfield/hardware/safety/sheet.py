"""Compute all numbers of the safety sheet of a scene: sound at head and hand, maps of levels, audible sound, limits."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from palmfield.acoustics.exposure import OCCUPATIONAL_DB, PUBLIC_DB, REFERENCE_PA, ball_points
from palmfield.acoustics.phased_array import PhasedArray
from palmfield.config import DriverConfig
from palmfield.drive.board import Board
from palmfield.errors import DeviceError
from palmfield.hardware.safety.byproduct import COUNT, RATE_HZ, Byproduct, byproduct, rung
from palmfield.hardware.safety.exposure import Exposure, SoundMoment, at_head, check_head, peaks_at
from palmfield.hardware.safety.scene_sound import MOMENTS, banded, drives_over, moments_of, power_W, sound_of
from palmfield.outputs.safety_picture import LevelCourse, LevelMap
from palmfield.session.preview import Preview
from palmfield.simulation.model import array_instances
from palmfield.simulation.posed_scene import PosedScene
from palmfield.simulation.radiation import Radiation
from palmfield.types import Complex, Estimate, Float

GRID = 61
"""Number of points across the sphere of a head."""
COURSE_SPACING_M = 20e-3
"""Spacing of the points in the sphere of a head at which the level over time is computed [m]."""
DEFAULT_HEAD_M = (0.0, -0.35, 0.45)
"""Default position of a head in the array frame [m]: a person sits in front of an array that faces up."""


def levels_dB(peaks_Pa: Float) -> Float:
    """Return the sound pressure levels of peak pressures, of the same shape; -inf for silence."""
    with np.errstate(divide="ignore"):
        return np.asarray(20.0 * np.log10(np.asarray(peaks_Pa) / (np.sqrt(2.0) * REFERENCE_PA)))


def head_map(moments: Sequence[SoundMoment], driver: DriverConfig, point: Exposure, transducers: Float) -> LevelMap:
    """Map the sphere of a head in the plane through its centre, the array centre and its loudest point.

    transducers: positions [m], shape (n, 3)
    """
    assert driver.head_m is not None
    middle, radius = np.array(driver.head_m), driver.head_radius_m
    along = middle - transducers.mean(axis=0)
    along /= np.linalg.norm(along)
    across = point.place - middle
    across = across - (across @ along) * along
    if np.linalg.norm(across) < 1e-9:
        across = np.cross(along, np.eye(3)[int(np.abs(along).argmin())])
    across /= np.linalg.norm(across)
    steps = np.linspace(-radius, radius, GRID)
    plane = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    plane = plane[np.linalg.norm(plane, axis=1) <= radius * (1.0 + 1e-9)]
    peaks, _ = peaks_at(moments, middle + plane[:, :1] * across + plane[:, 1:] * along)
    loudest = np.array([(point.place - middle) @ across, (point.place - middle) @ along])
    own = {} if driver.head_limit_dB is None else {"head_limit_dB": driver.head_limit_dB}
    limits = {"public": PUBLIC_DB, "at work": OCCUPATIONAL_DB, **own}
    axes = "across, through the loudest point", "away from the array"
    return LevelMap("head", plane, levels_dB(peaks), loudest, point.level_dB, limits, axes)


def skin_map(name: str, points: Float, peaks_Pa: Float, point: Exposure) -> LevelMap:
    """Map a skin in the plane of its two largest extents.

    points: points of the skin at its loudest moment [m], shape (n, 3)
    """
    middle = points.mean(axis=0)
    wide = np.linalg.svd(points - middle, full_matrices=False)[2][:2]
    places = (points - middle) @ wide.T
    loudest = (point.place - middle) @ wide.T
    axes = "along the skin", "across it"
    return LevelMap(name, places, levels_dB(peaks_Pa), loudest, point.level_dB, {}, axes)


def course(
    times_s: Float, moments: Sequence[SoundMoment | None], driver: DriverConfig, head: Exposure, skins: dict[str, Float]
) -> LevelCourse:
    """Compute the levels during a play.

    moments: one moment for each time, None for silence
    skins: peak pressures [Pa] at each of these times
    """
    assert driver.head_m is not None
    ball = ball_points(np.array(driver.head_m), driver.head_radius_m, COURSE_SPACING_M)
    points = np.concatenate([head.place[None], ball])
    peaks = [0.0 if one is None else float(np.abs(one.pressure(points)).max()) for one in moments]
    levels = {"head": levels_dB(np.array(peaks)), **{name: levels_dB(own) for name, own in skins.items()}}
    return LevelCourse(times_s, levels)


class AtHand(NamedTuple):
    """Sound at a skin: its name, the incident sound at its loudest point, and the largest ARP there [Pa]."""

    skin: str
    loudest: Exposure
    arp_Pa: float


@dataclass(frozen=True)
class SafetySheet:
    """Numbers of `palmfield safety` for a scene. Levels are those of the commanded sound, without ring-up.

    head_declared: whether the scene defines a head
    head_warnings: warnings for users about the head, in words
    distance_m: distance of the head sphere from the beam; 0 if the beam enters the sphere, and byproduct is then None
    sounding_share: fraction of the moments with sound
    p0: p0 of each array
    moves: whether hands or arrays move
    maps, course: levels at the head, on the skins, and over the play, for the picture
    """

    scene: str
    duration_s: float
    driver: DriverConfig
    board: Board
    p0: dict[str, Estimate]
    head_declared: bool
    head: Exposure
    head_warnings: tuple[str, ...]
    hands: tuple[AtHand, ...]
    distance_m: float
    byproduct: Byproduct | None
    sounding_share: float
    carrier_Hz: float
    moves: bool
    maps: tuple[LevelMap, ...]
    course: LevelCourse


class _Loudest(NamedTuple):
    """The loudest moment at a skin up to now. place: its loudest point [m], shape (3,)"""

    peak_Pa: float
    place: Float
    points: Float
    posed: PosedScene
    radiation: Radiation
    drive: Complex
    time_s: float


def safety_sheet(view: Preview, duration_s: float) -> SafetySheet:
    """Compute the numbers of a play of `duration_s` [s].

    Raises SceneError if transducers are closer to the head than head_radius_m, and the errors of modules in a step.
    """
    model = view.runtime.model
    times = moments_of(MOMENTS, duration_s)
    loudest: list[_Loudest | None] = [None] * len(model.skins)
    drives: list[tuple[PhasedArray, Complex]] = []
    squares = np.zeros(len(model.skins))
    at_skins = [np.zeros(len(skin.quadrature[0])) for skin in view.runtime.posed.skins]
    over_play = np.zeros((len(model.skins), MOMENTS))
    for time_s, runtime, posed, drive in drives_over(view, duration_s):
        drives.append((posed.arrays, drive))
        if not drive.any():
            continue
        for number, best in enumerate(loudest):
            points = posed.skins[number].quadrature[0]
            peaks = np.abs(posed.arrays.field.pressure(points, drive).pressure)
            most = int(peaks.argmax())
            at_skins[number] = np.maximum(at_skins[number], peaks)
            over_play[number, len(drives) - 1] = peaks[most]
            squares[number] += 0.5 * float(peaks[most]) ** 2 / MOMENTS
            if peaks[most] > (0.0 if best is None else best.peak_Pa):
                at = points[most].copy(), points.copy(), posed, runtime.work.radiation, drive, time_s
                loudest[number] = _Loudest(float(peaks[most]), *at)
    driver = model.spec.driver
    placed = driver if driver.head_m is not None else driver.model_copy(update={"head_m": DEFAULT_HEAD_M})
    moments = sound_of(drives)
    head = banded(view, drives, at_head(moments, placed, model.arrays.array.positions))
    hands, maps = [], [head_map(moments, placed, head, model.arrays.array.positions)]
    for number, best in enumerate(loudest):
        name = model.skins[number].spec.name
        if best is None:
            hands.append(AtHand(name, Exposure(np.zeros(3), 0.0, 0.0), 0.0))
            continue
        point = Exposure(best.place, best.peak_Pa, float(squares[number]))
        arp = best.radiation.on(best.posed, number, "quadrature", best.drive).arp
        hands.append(AtHand(name, banded(view, [(best.posed.arrays, best.drive)], point), float(arp.max())))
        maps.append(skin_map(name, best.points, at_skins[number], point))
    first = max((best for best in loudest if best is not None), key=lambda best: best.peak_Pa, default=None)
    distance, sound = _audible(view, placed, first)
    on = sum(bool(drive.any()) for _, drive in drives) / len(drives)
    skins = {skin.spec.name: own for skin, own in zip(model.skins, over_play, strict=True)}
    p0 = {array.name: one.p0 for array, one in zip(model.spec.arrays, array_instances(model.spec), strict=True)}
    return SafetySheet(
        view.name, duration_s, placed, model.board, p0, driver.head_m is not None, head, _head_warnings(head, placed),
        tuple(hands), distance, sound, on, model.arrays.array.frequency_Hz, view.moves, tuple(maps),
        course(times, [sound_of([one])[0] if one[1].any() else None for one in drives], placed, head, skins),
    )  # fmt: skip


def _head_warnings(head: Exposure, driver: DriverConfig) -> tuple[str, ...]:
    try:
        return tuple(check_head(head, driver))
    except DeviceError as error:
        return (f"palmfield drive refuses this scene: {error}",)


def _audible(view: Preview, driver: DriverConfig, loudest: _Loudest | None) -> tuple[float, Byproduct | None]:
    """Return the distance of the head from the beam [m], and the audible by-product there.

    The by-product is that of the loudest moment at the head.
    """
    if loudest is None:
        return math.inf, Byproduct(-math.inf, -math.inf, 0.0)
    posed, emission = loudest.posed, view.runtime.work.emission
    assert driver.head_m is not None
    begin = posed.arrays.array.positions.mean(axis=0)
    along, to_head = loudest.place - begin, np.array(driver.head_m) - begin
    share = min(1.0, max(0.0, float(to_head @ along) / float(along @ along)))
    distance = float(np.linalg.norm(to_head - share * along)) - driver.head_radius_m
    if distance <= 0.0:
        return 0.0, None
    drives = emission.commanded(posed, loudest.time_s + np.arange(COUNT) / RATE_HZ)
    # The pressure there, transducer by transducer
    row = np.array(
        [posed.arrays.pressure64(loudest.place[None], one)[0] for one in np.eye(drives.shape[1], dtype=complex)]
    )
    carrier = posed.arrays.array.frequency_Hz
    quality = min(one.quality.value for one in array_instances(view.runtime.model.spec))
    pressures = drives @ row
    power = power_W(posed.arrays, drives[int(np.abs(pressures).argmax())])
    intensity = np.abs(rung(pressures, carrier, quality)) ** 2
    most = float(intensity.max())
    shape = intensity / most if most > 0.0 else intensity
    along_m = share * float(np.linalg.norm(along))
    return distance, byproduct(power * shape, distance, posed.arrays.air, carrier, along_m)
