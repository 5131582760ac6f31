"""Motion that the keys of a scene define, from a file or a function."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from palmfield.config import MotionConfig
from palmfield.errors import SceneError, naming
from palmfield.files import read_toml, reading
from palmfield.hand.articulated import ArticulatedHand, articulate, checked_angles
from palmfield.hand.poses import named_pose, posed_surface
from palmfield.hand.preset import HandPreset, load_preset
from palmfield.hand.skinning import SkinnedHand
from palmfield.motion.alignment import read_alignment
from palmfield.motion.keyframes import Curve, keyframes
from palmfield.motion.pose import HandPose, numbers
from palmfield.motion.prediction import resample
from palmfield.motion.rates import RateCourse
from palmfield.motion.retarget import retarget
from palmfield.motion.tracking import Stream, read_stream
from palmfield.motion.trajectory import from_callable, read_trajectory
from palmfield.transforms import IDENTITY, Transform

FARTHEST_m = 10.0
"""Largest distance of a hand from an array; larger values indicate a wrong unit."""
KEY_FIELDS = ("time_s", "position_m", "quaternion", "turn_deg", "pose", "joints_deg")
DEFAULT_HAND = "open_men_p50"


@dataclass(frozen=True)
class HandMotion:
    """Motion of a hand.

    hand: articulated hand, None for a rigid hand
    at: function from scene time [s] to the pose
    rates: function from scene time [s] to the derivatives of the pose; None if the accelerations may jump
    """

    hand: ArticulatedHand | None
    at: Callable[[float], HandPose]
    rates: RateCourse | None = None


def motion_of(config: MotionConfig, array: Transform = IDENTITY) -> HandMotion:
    """Return the motion that the keys of a scene define. array: frame of the first array of the scene in the world

    Raises SceneError for files and functions that cannot be read or found.
    """
    hand = None if config.hand is None else articulate(load_preset(config.hand))
    joints = hand or articulate(load_preset(DEFAULT_HAND))
    if config.keyframes is not None:
        source: Any = read_keyframes(Path(config.keyframes), joints, config.hand, config.interpolation == "smooth")
    elif config.trajectory is not None:
        source = read_trajectory(config.trajectory, joints)
    elif config.tracking is not None:
        source = retarget(joints, _tracked(config, array))
    else:
        assert config.function is not None
        source = from_callable(config.function, joints)
    start, rates = config.start_s, getattr(source, "rates", None)
    if isinstance(source, Curve) and not source.smooth:
        rates = None
    if start == 0.0:
        return HandMotion(hand, source, rates)
    return HandMotion(hand, lambda t: source(t - start), rates and (lambda t: rates(t - start)))


def tracker_frame(
    array: Transform, alignment: str | Path | None, up: str | None, origin_m: Sequence[float] = (0.0, 0.0, 0.0)
) -> Transform:
    """Return the pose of the tracker frame in the world of a scene, whose first array is at `array`.

    alignment: file of `palmfield track align`
    up: vertical axis of the tracker, used without an alignment
    origin_m: origin of the tracker [m], used without an alignment
    Raises SceneError for an alignment that cannot be read.
    """
    if alignment is not None:
        position, rotation = read_alignment(alignment).transform
        return Transform(array.points(position), array.rotation @ rotation)
    turn = Rotation.from_euler("x", 90.0 if up == "y" else 0.0, degrees=True)
    return Transform(np.array(origin_m), turn.as_matrix())


def _tracked(config: MotionConfig, array: Transform) -> Stream:
    """Return the recorded stream in the world of the scene.

    If ahead_s is set, it is predicted as a live system would do.
    """
    assert config.tracking is not None
    stream = read_stream(config.tracking)
    frame = tracker_frame(array, config.tracking_alignment, config.tracking_up, config.tracking_origin_m)
    turn = Rotation.from_matrix(frame.rotation)
    turned = turn * Rotation.from_quat(stream.quaternions.reshape(-1, 4), scalar_first=True)
    stream = replace(
        stream,
        positions=frame.points(stream.positions),
        quaternions=turned.as_quat(scalar_first=True).reshape(stream.quaternions.shape),
    )
    if config.ahead_s == 0.0:
        return stream
    clock = np.unique(stream.times_s)
    return resample(stream, clock[:-1], ahead_s=config.ahead_s).stream


def read_keyframes(path: Path, hand: ArticulatedHand, preset: str | None, smooth: bool = False) -> Curve:
    """Read a TOML file of keyframes, which has one [[key]] table per key.

    A key has time_s and position_m. Optional are an orientation, as quaternion (w, x, y, z) or turn_deg (rotation
    vector), a named pose, and joints_deg (angles that differ from this pose).

    preset: name of an articulated hand, whose skin must not intersect itself at any key; None for a rigid hand
    smooth: see `Curve`
    Raises SceneError with the number of the key and the field.
    """
    with reading(f"keyframes {path}", SceneError, "a TOML file of tables [[key]]"):
        keys = read_toml(path).get("key", [])
    if not isinstance(keys, list) or len(keys) < 2:
        raise SceneError(f"keyframes {path}: give two tables [[key]] or more, each with time_s and position_m")
    turns, poses = [], []
    for number, key in enumerate(keys, start=1):
        where = f"keyframes {path}: key {number}"
        if not isinstance(key, dict):
            raise SceneError(f"{where} is {key!r}; give tables [[key]], each with time_s and position_m")
        unknown = [name for name in key if name not in KEY_FIELDS]
        if unknown:
            raise SceneError(f"{where}: field '{unknown[0]}' is unknown; allowed: {', '.join(KEY_FIELDS)}")
        if "time_s" not in key or "position_m" not in key:
            raise SceneError(f"{where}: time_s or position_m is missing; give both")
        if preset is None and ("pose" in key or "joints_deg" in key):
            raise SceneError(
                f"{where}: pose and joints_deg need an articulated hand: name the preset of that hand", mends=("hand",)
            )
        numbers(key["time_s"], (), f"{where}: time_s")
        place = numbers(key["position_m"], (3,), f"{where}: position_m")
        if (far := float(np.linalg.norm(place))) > FARTHEST_m:
            raise SceneError(
                f"{where}: position_m is {key['position_m']}, {far:g} m away; allowed: metres, at most {FARTHEST_m:g} "
                "from the origin"
            )
        turns.append(_turn(key, where))
        poses.append(_angles(key, hand, where))
    if preset is not None:
        _check_skin(path, preset, poses)
    times, places = [key["time_s"] for key in keys], [key["position_m"] for key in keys]
    return keyframes(hand, times, places, np.array(turns), poses, smooth)


def _turn(key: Mapping[str, Any], where: str) -> list[float]:
    if "quaternion" in key and "turn_deg" in key:
        raise SceneError(f"{where}: quaternion and turn_deg both set the rotation; give one")
    if "turn_deg" not in key:
        wxyz: list[float] = numbers(key.get("quaternion", [1.0, 0.0, 0.0, 0.0]), (4,), f"{where}: quaternion").tolist()
        return wxyz
    turn = numbers(key["turn_deg"], (3,), f"{where}: turn_deg")
    quaternion: list[float] = Rotation.from_rotvec(turn, degrees=True).as_quat(scalar_first=True).tolist()
    return quaternion


def _angles(key: Mapping[str, Any], hand: ArticulatedHand, where: str) -> dict[str, float]:
    bent = key.get("joints_deg", {})
    if not isinstance(bent, dict):
        raise SceneError(f"{where}: joints_deg is {bent!r}; give angles [deg] by joint")
    own = {name: float(numbers(angle, (), f"{where}: joints_deg: {name}")) for name, angle in bent.items()}
    with naming(where):
        angles = named_pose(hand, key.get("pose", "relaxed")) | own
        checked_angles(hand, angles)
        return angles


def _check_skin(path: Path, preset: str, poses: list[dict[str, float]]) -> None:
    hand = load_preset(preset).model_dump_json()
    for number, pose in enumerate(poses, start=1):
        if fault := _fault(hand, tuple(pose.items())):
            raise SceneError(f"keyframes {path}: key {number}: {fault}")


@lru_cache(maxsize=256)
def _fault(hand: str, pose: tuple[tuple[str, float], ...]) -> str:
    """Return why the skin of a preset (JSON) does not allow a pose, or "". The result is cached for later calls."""
    try:
        posed_surface(_skinned(hand), dict(pose))
    except SceneError as error:
        return f"{error}"
    return ""


@lru_cache(maxsize=1)
def _skinned(hand: str) -> SkinnedHand:
    return SkinnedHand(HandPreset.model_validate_json(hand))
