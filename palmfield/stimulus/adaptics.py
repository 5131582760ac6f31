"""Patterns of the design tool Adaptics (.adaptics files, JSON): their evaluation to a table of foci.

A pattern has keyframes at times [ms] with positions [mm], intensities 0..1 and brushes, which are small shapes that the
focus draws around the position. Numbers can be parameters or formulas. The evaluation follows the Adaptics engine:
playback speed and jumps give the pattern time; keyframes give position, intensity and brush; the position is scaled,
rotated and translated; brush and AM, at playback time, are added last. A pause holds the position until its time. The
engine jumps at its first sample after a keyframe; here a jump has no such delay.
"""

import json
import math
import operator
import re
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from palmfield.errors import SceneError, did_you_mean, naming, refuse_unknown
from palmfield.stimulus.autd3_stm import MM, json_of
from palmfield.stimulus.focus_table import FocusTable, Quantity
from palmfield.stimulus.focus_table_file import HIGHEST_RATE_HZ, MOST_ROWS, focus_table
from palmfield.types import Float

FORMAT, REVISIONS = "MidAirHapticsAnimationFileFormat", ("0.1.0-alpha.3", "0.1.0-alpha.2", "0.0.10-alpha.1")
"""The revisions that the Adaptics engine reads, the one that palmfield writes first."""
RATES_HZ = (1000.0, 2000.0, 4000.0, 5000.0, 8000.0, 10e3, 20e3, 40e3)
"""Default rates of tables: whole fractions of 40 kHz, as AUTD3 units need."""
SAMPLES = 10
"""Smallest number of samples in a period of AM or of a brush at the default rate, up to 40 kHz."""
TICK_MS, LONGEST_S = 1e-6, 3600.0
"""Difference below which times are equal [ms]; limit of durations [s]."""
CALCULATE = {"add": operator.add, "subtract": operator.sub, "multiply": operator.mul, "divide": operator.truediv}
COMPARE = {"lt": operator.lt, "lt_eq": operator.le, "gt": operator.gt, "gt_eq": operator.ge}
INTENSITIES = {"constant": ("value",), "random": ("min", "max")}
BRUSHES = {
    "circle": ("radius", "am_freq"),
    "line": ("length", "thickness", "rotation", "am_freq"),
    "lissajous": ("x_scale", "y_scale", "rotation", "a", "b", "d", "am_freq"),
}
KEYFRAMES = {"standard": ("coords", "cjumps"), "pause": ("cjumps",), "stop": ()}


@dataclass(frozen=True)
class Sampling:
    """Settings for the conversion of an Adaptics pattern to a table of foci.

    rate_Hz: default: the lowest of RATES_HZ with SAMPLES samples in each period of AM and brushes, at most 40 kHz
    duration_s: default: until a stop, or else the last keyframe; later the pattern keeps its last values
    parameters: values; default: of the file; quantity: of the intensities, which the format does not define
    """

    rate_Hz: float | None = None
    duration_s: float | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)
    quantity: Quantity = "amplitude"


class _Part(NamedTuple):
    """A value of a file and its place, for messages. All methods raise SceneError for values of another kind."""

    value: Any
    place: str

    def refused(self, allowed: str) -> SceneError:
        return SceneError(f"{self.place or 'content'}: {json.dumps(self.value)[:60]}; allowed: {allowed}")

    def fields(self, needed: Sequence[str], optional: Sequence[str] = ()) -> dict[str, "_Part"]:
        names = (*needed, *optional)
        if not isinstance(self.value, dict):
            raise self.refused(f"an object with {', '.join(names) or 'nothing'}")
        for name in (*needed, *self.value):
            if name not in self.value or name not in names:
                fault = "missing" if name in names else f"unknown{did_you_mean(name, names)}"
                raise SceneError(f"{self.of(name).place}: {fault}; allowed: {', '.join(names) or 'no fields'}")
        return {name: self.of(name) for name in names if self.value.get(name) is not None or name in needed}

    def of(self, name: object) -> "_Part":
        return _Part(self.value.get(name), f"{self.place}.{name}".lstrip("."))

    def kind(self, name: str, allowed: Sequence[str]) -> str:
        if not isinstance(self.value, dict):
            raise self.refused("an object")
        return self.of(name).word(allowed)

    def entries(self) -> list["_Part"]:
        if not isinstance(self.value, list):
            raise self.refused("a list")
        return [_Part(one, f"{self.place}.{number}") for number, one in enumerate(self.value)]

    def number(self, least: float = -math.inf) -> float:
        number = float(self.value) if isinstance(self.value, int | float) and self.value is not True else math.nan
        if not (math.isfinite(number) and number >= least):
            raise self.refused(f"a finite number{f' of at least {least:g}' if math.isfinite(least) else ''}")
        return number

    def word(self, allowed: Sequence[str]) -> str:
        if self.value not in allowed:
            raise self.refused(" | ".join(allowed))
        return str(self.value)

    def choice(self, kinds: Mapping[str, Sequence[str]], *optional: str) -> tuple[str, dict[str, "_Part"]]:
        fields = self.fields(("name", "params"))
        name = fields["name"].word(list(kinds))
        return name, fields["params"].fields(kinds[name], optional)

    def linear(self) -> bool:
        return self.choice({"linear": (), "step": ()})[0] == "linear"

    def result(self, known: Mapping[str, float]) -> float:
        """Return the value of a number, a parameter or a formula."""
        kind, value = self.fields(("type", "value")).values()
        match kind.word(("f64", "param", "dynamic", "formula", "constant", "parameter", "negate", *CALCULATE)):
            case "f64" | "constant":
                return value.number()
            case "param" | "dynamic" | "parameter":
                return value.parameter(known)
            case "formula":
                return value.result(known)
            case "negate":
                return -value.result(known)
        if len(terms := value.entries()) != 2:
            raise value.refused("a list of two terms")
        left, right = (one.result(known) for one in terms)
        result = math.nan if kind.value == "divide" and right == 0.0 else float(CALCULATE[kind.value](left, right))
        if not math.isfinite(result):
            raise SceneError(f"{self.place}: {kind.value} of {left:g} and {right:g} has no finite result")
        return result

    def parameter(self, known: Mapping[str, float]) -> float:
        if not isinstance(self.value, str) or self.value not in known:
            raise self.refused(f"{', '.join(known) or 'no parameter'}; or give --set-parameter NAME=VALUE")
        return known[self.value]


class _Node(NamedTuple):
    """Numbers at a keyframe [ms]. moving: they change linearly until the next node if `linear`; fixed: they do not"""

    time: float
    moving: Sequence[float]
    linear: bool = False
    fixed: Sequence[float] = ()


def read_adaptics(file: Path, sampling: Sampling | None = None) -> FocusTable:
    """Read a pattern and evaluate it as a held table in the frame of the array.

    Random intensities are the same in every call.
    Raises SceneError, with the place in the file, for an invalid file, for parameters, rates and durations out of
    range, unknown parameters, formulas without a finite result, jumps without end, and errors of `focus_table`.
    """
    content = json_of(file)
    with naming(f"{file}"):
        return table_of_pattern(content, sampling or Sampling())


def table_of_pattern(content: object, sampling: Sampling) -> FocusTable:
    """Evaluate the content of a file, see `read_adaptics`."""
    top = _Part(content, "")
    fixed = {"$DATA_FORMAT": top.kind("$DATA_FORMAT", (FORMAT,)), "$REVISION": top.kind("$REVISION", REVISIONS)}
    parts = top.fields((*fixed, "name", "keyframes", "pattern_transform", "user_parameter_definitions"))
    known = _parameters(parts["user_parameter_definitions"], sampling.parameters, json.dumps(content))
    whole = parts["pattern_transform"].fields(("geometric_transforms", "intensity_factor", "playback_speed"))
    speed = whole["playback_speed"].result(known)
    if speed <= 0.0:
        raise SceneError(f"pattern_transform.playback_speed: {speed:g}; allowed: above 0")
    frames = _keyframes(parts["keyframes"])
    places, levels, brushes = _nodes(frames, known)
    rate = _usual_rate_Hz(brushes) if sampling.rate_Hz is None else sampling.rate_Hz
    if not 0.0 < rate <= HIGHEST_RATE_HZ:
        raise SceneError(f"--rate has value {rate:g}; allowed: above 0, at most {HIGHEST_RATE_HZ:g}")
    begins, end_ms = _course(frames, known, speed, 1e3 / rate, sampling.duration_s)
    count = math.ceil(end_ms * 1e-3 * rate - 1e-6)
    if not 1 <= count <= MOST_ROWS:
        raise SceneError(f"the pattern has {count} samples ({end_ms:g} ms at {rate:g} Hz); allowed: 1 to {MOST_ROWS}; "
                         "give another --duration or --rate")  # fmt: skip
    played: Float = np.arange(count) / (1e-3 * rate)
    part = np.searchsorted(begins[:, 0], played + TICK_MS, "right") - 1
    at = begins[part, 1] + speed * (played - begins[part, 0])

    moves = whole["geometric_transforms"].fields(("translate", "rotation", "scale"))
    scale, shift = ([x.result(known) for x in moves[name].fields("xyz").values()] for name in ("scale", "translate"))
    now, then, _ = _between(places, at)
    x, y, z = ((now + then) * scale).T
    flat = (x + 1j * y) * np.exp(1j * math.radians(moves["rotation"].result(known)))
    now, then, row = _between(brushes, at)
    wide, high, turned, am_Hz = (now + then).T
    along_x, along_y, a, b, d, stm_Hz = np.array([node.fixed for node in brushes])[row].T
    phase = 2.0 * np.pi * (played * 1e-3 * stm_Hz % 1.0)
    drawn = wide * along_x * np.sin(a * phase + d) + 1j * high * along_y * np.sin(b * phase)
    flat += drawn * np.exp(1j * turned)
    points = (np.stack([flat.real, flat.imag, z], axis=1) + shift)[:, None] / MM
    now, then, _ = _between(levels, at)
    chance = np.random.default_rng(0).random((2, count))
    loud = now[:, 0] + chance[0] * now[:, 1] + then[:, 0] + chance[1] * then[:, 1]
    loud *= whole["intensity_factor"].result(known) * (0.5 + 0.5 * np.cos(2.0 * np.pi * am_Hz * played * 1e-3))
    # Rounded, because a sum of shares can exceed 1 in the last digit
    return focus_table(
        played * 1e-3, points, np.round(loud, 12)[:, None], rate_Hz=rate, quantity=sampling.quantity,
        named=lambda index, column: f"at {played[index]:g} ms, {column}",
    ).without_repeats()  # fmt: skip


def _keyframes(part: _Part) -> list[dict[str, _Part]]:
    frames = []
    for one in part.entries():
        kind = one.kind("type", list(KEYFRAMES))
        frames.append(one.fields(("type", "time", *KEYFRAMES[kind]), () if kind == "stop" else ("brush", "intensity")))
    if not frames:
        raise part.refused("one or more keyframes")
    return sorted(frames, key=lambda frame: frame["time"].number(0.0))


def _nodes(frames: Sequence[Mapping[str, _Part]], known: Mapping[str, float]) -> tuple[list[_Node], ...]:
    """Return positions [mm], intensities (lowest, range), and brushes: sizes along x and y, rotation, AM frequency.

    Before the first keyframe: the origin, full intensity, no brush. Brushes of different kinds have no transition.
    """
    places, levels = [_Node(-1.0, (0.0, 0.0, 0.0))], [_Node(-1.0, (1.0, 0.0))]
    brushes, kinds = [_Node(-1.0, (0.0, 0.0, 0.0, 0.0), False, (1.0, 1.0, 1.0, 1.0, 0.0, 0.0))], [""]
    for frame in frames:
        time = frame["time"].number()
        places.append(places[-1]._replace(time=time))
        if "coords" in frame:
            own = frame["coords"].fields(("coords", "transition"))
            position = [x.number() for x in own["coords"].fields("xyz").values()]
            places[-1] = _Node(time, position, own["transition"].linear())
        if "intensity" in frame:
            own = frame["intensity"].fields(("intensity", "transition"))
            ends = [one.result(known) for one in own["intensity"].choice(INTENSITIES)[1].values()]
            levels.append(_Node(time, (ends[0], ends[-1] - ends[0]), own["transition"].linear()))
        if "brush" in frame:
            own = frame["brush"].fields(("brush", "transition"))
            kind, params = own["brush"].choice(BRUSHES, "stm_freq")
            moving, fixed = _shape(kind, {name: one.result(known) for name, one in params.items()})
            brushes.append(_Node(time, moving, own["transition"].linear(), fixed))
            kinds.append(kind)
    alike = [kind == following for kind, following in pairwise([*kinds, ""])]
    return places, levels, [one._replace(linear=one.linear and same) for one, same in zip(brushes, alike, strict=True)]


def _shape(kind: str, given: Mapping[str, float]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return sizes [mm], rotation [rad] and AM [Hz] of a brush; and factors, a, b, d and STM [Hz]."""
    am, stm = given["am_freq"], given.get("stm_freq", 100.0)
    if kind == "circle":
        return (given["radius"], given["radius"], 0.0, am), (1.0, 1.0, 1.0, 1.0, 0.5 * math.pi, stm)
    if kind == "line":
        # From the middle to an end; the thickness has no effect
        sizes = given["length"], 0.0, math.radians(given["rotation"]), am
        return sizes, (1.0, 0.0, 1.0, 1.0, 0.5 * math.pi, stm)
    # The engine has no transition between sizes of this brush, and reads its rotation in radians
    fixed = given["x_scale"], given["y_scale"], given["a"], given["b"], given["d"], stm
    return (1.0, 1.0, given["rotation"], am), fixed


def _usual_rate_Hz(brushes: Sequence[_Node]) -> float:
    fastest = 0.0
    for (wide, high, _, am_Hz), (along_x, along_y, a, b, _, stm_Hz) in ((one.moving, one.fixed) for one in brushes):
        drawn = max(abs(a) * (wide * along_x != 0.0), abs(b) * (high * along_y != 0.0))
        fastest = max(fastest, abs(am_Hz), abs(stm_Hz) * drawn)
    return next((rate for rate in RATES_HZ if rate >= SAMPLES * fastest), RATES_HZ[-1])


def _course(
    frames: Sequence[Mapping[str, _Part]], known: Mapping[str, float], speed: float, sample_ms: float,
    limit_s: float | None,
) -> tuple[Float, float]:  # fmt: skip
    """Return playback and pattern time [ms] of the start and of each jump, (n, 2), and the playback time of the end."""
    if limit_s is not None and not 0.0 < limit_s < LONGEST_S:
        raise SceneError(f"--duration has value {limit_s:g}; allowed: seconds above 0, below {LONGEST_S:g}")
    times, stops = [frame["time"].number() for frame in frames], [frame["type"].value == "stop" for frame in frames]
    # Time, whether it is a stop (which comes after jumps), place, target
    events: list[tuple[float, bool, str, float]] = []
    for frame, time, stop, following in zip(frames, times, stops, [*times[1:], math.inf], strict=True):
        if stop and following > time:
            events.append((time, True, "", time))
        targets = [_target(jump, known) for jump in frame["cjumps"].entries()] if not stop else []
        events += [(time, False, frame["cjumps"].place, target) for target in targets if target is not None][:1]
    events.sort(key=lambda event: event[:2])
    most_ms = min(math.inf if limit_s is None else 1e3 * limit_s, (MOST_ROWS + 1) * sample_ms)
    played, at, seen = 0.0, 0.0, dict[str, float]()
    begins = [(played, at)]
    while played < most_ms:
        behind, coming = bisect_right(times, at), bisect_right(events, at, key=lambda event: event[0])
        if behind and stops[behind - 1]:
            return np.array(begins), played
        if coming == len(events):
            rest_ms = max(times[-1] - at, 0.0) / speed
            return np.array(begins), min(played + rest_ms if limit_s is None else math.inf, most_ms)
        time, stop, place, target = events[coming]
        played, at = played + (time - at) / speed, target
        if stop:
            continue
        loop_ms = played - seen.get(place, -math.inf)
        if loop_ms < sample_ms or (limit_s is None and math.isfinite(loop_ms)):
            fault = "progress of time" if loop_ms < sample_ms else "end"
            raise SceneError(f"{place}: the jump from {time:g} to {target:g} ms repeats without {fault} with these "
                             "parameters; set others, or for a jump with progress --duration")  # fmt: skip
        seen[place] = played
        begins.append((played, at))
    return np.array(begins), most_ms


def _target(part: _Part, known: Mapping[str, float]) -> float | None:
    """Return the target of a conditional jump [ms] if its condition is met."""
    jump = part.fields(("condition", "jump_to"))
    condition = jump["condition"].fields(("parameter", "value", "operator"))
    holds = COMPARE[condition["operator"].choice(dict.fromkeys(COMPARE, ()))[0]]
    target = jump["jump_to"].number(0.0)
    return target if holds(condition["parameter"].parameter(known), condition["value"].number()) else None


def _between(nodes: Sequence[_Node], at: Float) -> tuple[Float, Float, NDArray[np.intp]]:
    """Return weighted numbers of the nodes before and after pattern times [ms], shape (n, k), and rows of the first."""
    times, moving = np.array([node.time for node in nodes]), np.array([node.moving for node in nodes])
    row = np.searchsorted(times, at + TICK_MS, "right") - 1
    following = np.minimum(row + 1, len(nodes) - 1)
    length = times[following] - times[row]
    linear = np.array([node.linear for node in nodes])[row] & (length > 0.0)
    share = np.where(linear, np.clip((at - times[row]) / np.where(linear, length, 1.0), 0.0, 1.0), 0.0)[:, None]
    return (1.0 - share) * moving[row], share * moving[following], row


def _parameters(part: _Part, given: Mapping[str, float], text: str) -> dict[str, float]:
    known: dict[str, float] = {}
    # Parameters that are used need no definition
    used = re.findall(r'"(?:value|parameter)": ("(?:[^"\\]|\\.)*")', text)
    ranges = dict.fromkeys(map(json.loads, used), (-math.inf, math.inf))
    for name in part.fields(list(part.value) if isinstance(part.value, dict) else ()):
        own = part.of(name).fields(("default", "step"), ("min", "max"))
        low, high = (own[end].number() if end in own else inf for end, inf in (("min", -math.inf), ("max", math.inf)))
        # The engine limits defaults to the range, too
        known[name], ranges[name] = min(max(own["default"].number(), low), high), (low, high)
    for name, value in given.items():
        if not ranges:
            raise SceneError(f"--set-parameter names '{name}', but the pattern has no parameters; omit it")
        refuse_unknown(SceneError, "--set-parameter names {}", name, ranges)
        low, high = ranges[name]
        if not (low <= value <= high and math.isfinite(value)):
            raise SceneError(f"--set-parameter {name} has value {value:g}; allowed: finite, from {low:g} to {high:g}")
        known[name] = value
    return known
