"""Samples of a tracked hand as lines of JSON for a socket, with the names of OpenXR or LeapC.

openxr: {"convention": "openxr", "time_s": 1.25, "hand": "right", "joints": {"wrist": {"position": [x, y, z],
    "orientation": [x, y, z, w], "radius": 0.03}, ...}}, names as in XrHandJointEXT with or without XR_HAND_JOINT_ and
    _EXT, metres, w last
leapc: {"convention": "leapc", "timestamp": 1250000, "hand": "right", "palm": {"position": [x, y, z]}, "arm":
    {"next_joint": [x, y, z]}, "thumb": {"bones": [{"prev_joint": [x, y, z], "next_joint": [...], "rotation":
    [x, y, z, w], "width": 18.0}, ...]}, "index": ..., "middle": ..., "ring": ..., "pinky": ...}, the four bones of
    LEAP_DIGIT from metacarpal to distal, microseconds and millimetres
In both, y is up and -z points away from the user. A sample of a lost hand has "hand": null.
"""

import json
import math
from itertools import pairwise
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from palmfield.hand.preset import DIGITS
from palmfield.motion.joints import (
    ALL_FLAGS,
    FARTHEST_M,
    JOINTS,
    ORIENTATION_VALID,
    POSITION_TRACKED,
    POSITION_VALID,
    USUAL_M,
)
from palmfield.motion.line_listener import BadLine, read_object
from palmfield.types import Float, Int

Convention = Literal["openxr", "leapc"]
CONVENTIONS: tuple[str, ...] = get_args(Convention)
LEAP_DIGITS = {"thumb": "thumb", "index": "index", "middle": "middle", "ring": "ring", "pinky": "little"}
LEAP_SCALE_M, LEAP_TICK_S = 1e-3, 1e-6
RADIUS_M = 0.01
"""Default radius of a joint."""


class Sample(NamedTuple):
    """A sample of one hand. time_s: time on the clock of the tracker [s]; others as in
    `palmfield.motion.tracking.Stream`
    """

    time_s: float
    positions: Float
    quaternions: Float
    radii: Float
    flags: Int


def read_sample(line: str | bytes) -> Sample:
    """Read the sample in a line. Raises BadLine of kind garbled, convention, joints, numbers, lost or unit."""
    value = read_object(line)
    convention = value.get("convention")
    if convention not in CONVENTIONS:
        raise BadLine("convention", f"convention is {convention!r}; allowed: {', '.join(CONVENTIONS)}")
    time_s = _time(value, convention)
    if value.get("hand", "right") is None:
        raise BadLine("lost", "the tracker sees no hand")
    try:
        joints = _openxr(value) if convention == "openxr" else _leapc(value)
    except (KeyError, TypeError, AttributeError) as error:
        raise BadLine("joints", f"{convention} lacks {error}; see `palmfield track --help`") from None
    count = len(JOINTS)
    positions, quaternions = np.zeros((count, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    radii, flags = np.full(count, RADIUS_M), np.zeros(count, np.int32)
    for name, (place, turn, radius) in joints.items():
        number = JOINTS.index(name)
        positions[number] = _numbers(place, 3, name)
        flags[number] = POSITION_VALID | POSITION_TRACKED
        if turn is not None:
            x, y, z, w = _numbers(turn, 4, name)
            length = math.hypot(x, y, z, w)
            if length < 1e-6:
                raise BadLine("numbers", f"orientation of {name} has length {length:g}")
            quaternions[number] = np.array([w, x, y, z]) / length
            flags[number] = ALL_FLAGS
        if radius is not None:
            radii[number] = max(float(_numbers([radius], 1, name)[0]), 1e-4)
    _check_size(positions, flags)
    return Sample(time_s, positions, quaternions, radii, flags)


def write_sample(sample: Sample, convention: Convention = "openxr", hand: str = "right") -> str:
    """Return the line of a sample, without line end. A sample without valid joints is written as a lost hand."""
    valid = (sample.flags & POSITION_VALID) != 0
    head: dict[str, Any] = {"convention": convention}
    if convention == "openxr":
        head["time_s"] = sample.time_s
    else:
        head["timestamp"] = round(sample.time_s / LEAP_TICK_S)
    if not valid.any():
        return json.dumps({**head, "hand": None})
    head["hand"] = hand
    if convention == "openxr":
        joints = {}
        for number, name in enumerate(JOINTS):
            if valid[number]:
                joints[name] = {"position": sample.positions[number].tolist(), "radius": float(sample.radii[number])}
                if sample.flags[number] & ORIENTATION_VALID:
                    joints[name]["orientation"] = sample.quaternions[number][[1, 2, 3, 0]].tolist()
        return json.dumps({**head, "joints": joints})
    return json.dumps({**head, **_as_leapc(sample)})


Joint = tuple[Any, Any, Any]


def _openxr(value: dict[str, Any]) -> dict[str, Joint]:
    joints: dict[str, Joint] = {}
    for key, one in value["joints"].items():
        name = key.lower().removeprefix("xr_hand_joint_").removesuffix("_ext")
        if name not in JOINTS:
            raise BadLine("joints", f"joint '{key}' is not one of the 26 joints of OpenXR")
        joints[name] = one["position"], one.get("orientation"), one.get("radius")
    return joints


def _leapc(value: dict[str, Any]) -> dict[str, Joint]:
    """Return the OpenXR joints of a LEAP_HAND.

    The joint of a bone that is nearer to the wrist has the name of the bone. In LeapC the metacarpal of the thumb has
    no length; its proximal bone is the metacarpal of OpenXR.
    """
    joints: dict[str, Joint] = {
        "palm": (_metres(value["palm"]["position"]), value["palm"].get("orientation"), None),
        "wrist": (_metres(value["arm"]["next_joint"]), value["arm"].get("rotation"), None),
    }
    for leap, digit in LEAP_DIGITS.items():
        bones = value[leap]["bones"]
        if len(bones) != 4:
            raise BadLine("joints", f"{leap} has {len(bones)} bones; LEAP_DIGIT has 4")
        for bone, place in zip(bones[_first(digit) :], _places(digit), strict=True):
            width = bone.get("width")
            radius = None if width is None else 0.5 * LEAP_SCALE_M * float(width)
            joints[f"{digit}_{place}"] = _metres(bone["prev_joint"]), bone.get("rotation"), radius
        last = bones[-1]
        joints[f"{digit}_tip"] = _metres(last["next_joint"]), last.get("rotation"), None
    return joints


def _as_leapc(sample: Sample) -> dict[str, Any]:
    at = {name: (sample.positions[number] / LEAP_SCALE_M).tolist() for number, name in enumerate(JOINTS)}
    turns = {name: sample.quaternions[number][[1, 2, 3, 0]].tolist() for number, name in enumerate(JOINTS)}
    widths = {name: 2.0 * float(sample.radii[number]) / LEAP_SCALE_M for number, name in enumerate(JOINTS)}
    value: dict[str, Any] = {
        "palm": {"position": at["palm"], "orientation": turns["palm"]},
        "arm": {"next_joint": at["wrist"], "rotation": turns["wrist"]},
    }
    for leap, digit in LEAP_DIGITS.items():
        names = [f"{digit}_{place}" for place in (*_places(digit), "tip")]
        bones = [
            {"prev_joint": at[name], "next_joint": at[after], "rotation": turns[name], "width": widths[name]}
            for name, after in pairwise(names)
        ]
        if _first(digit):
            bones.insert(0, {**bones[0], "next_joint": at[names[0]]})
        value[leap] = {"bones": bones}
    return value


def _places(digit: str) -> tuple[str, ...]:
    assert digit in DIGITS
    return ("metacarpal", "proximal", "distal") if digit == "thumb" else (
        "metacarpal", "proximal", "intermediate", "distal",
    )  # fmt: skip


def _first(digit: str) -> int:
    """Return the number of the bone of a LEAP_DIGIT that is the first bone in OpenXR."""
    return 1 if digit == "thumb" else 0


def _metres(place: Any) -> Float:
    return LEAP_SCALE_M * _numbers(place, 3, "a joint")


def _numbers(values: Any, count: int, what: str) -> Float:
    try:
        numbers = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise BadLine("numbers", f"{what} has {values!r}; give {count} numbers") from None
    if numbers.shape != (count,) or not np.isfinite(numbers).all():
        raise BadLine("numbers", f"{what} has {values!r}; give {count} finite numbers")
    return numbers


def _time(value: dict[str, Any], convention: str) -> float:
    key = "time_s" if convention == "openxr" else "timestamp"
    time = value.get(key)
    if not isinstance(time, float) or not math.isfinite(time):
        raise BadLine("numbers", f"{key} is {time!r}; give a number")
    return time * (1.0 if convention == "openxr" else LEAP_TICK_S)


def _check_size(positions: Float, flags: Int) -> None:
    """Raise BadLine for sizes that are not those of a hand in metres."""
    valid = (flags & POSITION_VALID) != 0
    if not valid.any():
        raise BadLine("lost", "no joint has a position")
    farthest = float(np.abs(positions[valid]).max())
    if farthest > FARTHEST_M:
        raise BadLine("unit", f"a joint is {farthest:.3g} m away; give metres (openxr) or millimetres (leapc)")
    wrist, tip = JOINTS.index("wrist"), JOINTS.index("middle_tip")
    if valid[wrist] and valid[tip]:
        length = float(np.linalg.norm(positions[tip] - positions[wrist]))
        if not USUAL_M[0] < length < USUAL_M[1] and length > 0.0:
            raise BadLine("unit", f"the hand is {length:.3g} m long; give metres (openxr) or millimetres (leapc)")
