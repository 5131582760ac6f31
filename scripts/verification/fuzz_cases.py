"""Malformed inputs drawn by hypothesis: values of keys, inconsistent keys, scenes and meshes."""

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
import trimesh
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from small_scene import small_scene_texts

from palmfield.config import CONFIGS, Config

PLAIN, HAPTIC = small_scene_texts(0.01, array={"p0_Pa_m": 2}, skin={"side": None})
NEEDED: dict[str, dict[str, str]] = {
    "palmfield.skin": {"patch_site": "centre"},
    "palmfield.motion": {"keyframes": "motion.toml"},
}
"""Keys without which the configuration of a module is incomplete."""
DISC = {"shape": "disc", "radius_m": "0.02", "thickness_m": "0.008"}
AM = {"modulation": "am", "am_quantity": "arp", "am_frequency_Hz": "100", "am_depth": "1"}
CIRCLE = {"path": "circle", "path_diameter_m": "0.02", "path_rate_Hz": "50"}
NO_NUMBERS = ("nan", "inf", "-inf", "abc", "1 mm", "12mm", "1,5", "0x10", "--1", "1e", "one")
BYTES = st.one_of(st.sampled_from(sorted(b'<>/="& -.0123456789aexn')), st.integers(32, 126), st.integers(0, 255))
"""Changes of bytes, most of which let a reader continue and fail later."""
EXTREMES = ("0", "-1", "1e308", "-1e308", "1e-300", "nan", "inf", "1e9", "-0.0", "99999999999999999999", "")


@dataclass(frozen=True)
class Case:
    """One malformed input.

    kind: keys, rules, scene, mesh; fault: its fault; forbidden: whether a rule certainly refuses it
    files: contents by name; values: keys of `plugin`, for kinds without files
    """

    kind: str
    fault: str
    forbidden: bool
    files: dict[str, bytes] = field(default_factory=dict)
    plugin: str = ""
    values: dict[str, str] = field(default_factory=dict)


def drawn(kinds: dict[str, int], chosen_seed: int) -> list[Case]:
    """Return this number of different cases of each kind; equal for equal seeds."""
    result: list[Case] = []
    for kind, count in kinds.items():
        own: dict[str, Case] = {}
        for again in range(50):
            if len(own) < count:
                _collect(STRATEGIES[kind], count, chosen_seed + 1000 * again, own)
        result += list(own.values())[:count]
    return result


def _collect(strategy: st.SearchStrategy[Case], count: int, chosen_seed: int, known: dict[str, Case]) -> None:
    """Add the cases that a strategy draws."""

    @seed(chosen_seed)
    @settings(
        max_examples=count,
        phases=[Phase.generate],
        deadline=None,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(strategy)
    def collect(case: Case) -> None:
        known.setdefault(repr(case), case)

    collect()


# -- values of keys ------------------------------------------------------------------------------------------------


@cache
def _schemas(model: type[Config]) -> dict[str, Any]:
    return dict(model.model_json_schema()["properties"])


def _wrong_values(model: type[Config], key: str) -> st.SearchStrategy[str] | None:
    """Return texts that the declaration of a key forbids; None for a key that allows any text."""
    schema = _schemas(model)[key]
    options = [o for o in schema.get("anyOf", [schema]) if o.get("type") != "null"]
    option: dict[str, Any] = options[0]
    if "enum" in option:
        words = set(option["enum"]) | {name.partition("=")[2] for name in (*model.renamed, *model.refused)}
        near = [word[:-1] for word in option["enum"]] + [word.upper() + "x" for word in option["enum"]]
        other = st.text(st.characters(min_codepoint=33, max_codepoint=0x2FF), min_size=1, max_size=12)
        return st.one_of(st.sampled_from(near), other).filter(lambda text: text not in words)
    if option.get("type") == "array":
        return _wrong_lists(option)
    if option.get("type") not in ("number", "integer"):
        return None
    wrong = [st.sampled_from(NO_NUMBERS)]
    low, high = (
        option.get("exclusiveMinimum", option.get("minimum")),
        option.get("exclusiveMaximum", option.get("maximum")),
    )
    if low is not None:
        wrong.append(st.floats(max_value=low, exclude_max="minimum" in option, allow_infinity=False).map(repr))
    if high is not None:
        wrong.append(st.floats(min_value=high, exclude_min="maximum" in option, allow_infinity=False).map(repr))
    if option["type"] == "integer":
        wrong.append(st.sampled_from(("1.5", "2.000001", "1e1")))
    return st.one_of(wrong)


def _wrong_lists(option: dict[str, Any]) -> st.SearchStrategy[str] | None:
    if option.get("maxItems") == 3:
        counts = st.sampled_from((1, 2, 4, 7)).map(lambda n: " ".join(["0.1"] * n))
        return st.one_of(counts, st.sampled_from(NO_NUMBERS).map(lambda word: f"0 {word} 0.1"))
    item = option["items"]
    if item.get("type") == "string":
        return None
    wrong = list(NO_NUMBERS)
    if item.get("type") == "integer":
        wrong += ["-1", "1 -2", "1.5"]
    if "exclusiveMinimum" in item:
        wrong += ["0", "0.5 -0.5", "0.5 0"]
    return st.sampled_from(wrong)


@st.composite
def wrong_keys(draw: Callable[..., Any]) -> Case:
    """Draw one key with a forbidden value, or one that does not exist."""
    model = draw(st.sampled_from(CONFIGS))
    values = dict(NEEDED.get(model.plugin, {}))
    if draw(st.integers(0, 9)) == 0:
        letters = st.text(st.characters(min_codepoint=97, max_codepoint=122), min_size=1, max_size=12)
        key = draw(st.one_of(letters, st.sampled_from(list(model.model_fields)).map(lambda name: name + "m")))
        if key not in model.model_fields:
            return Case("keys", "unknown key", True, plugin=model.plugin, values={**values, key: "1"})
    known = {key: wrong for key in model.model_fields if (wrong := _wrong_values(model, key)) is not None}
    key = draw(st.sampled_from(sorted(known)))
    return Case("keys", "value", True, plugin=model.plugin, values={**values, key: draw(known[key])})


# -- keys that don't fit together ----------------------------------------------------------------------------------

POSITIVE = st.floats(1e-3, 0.5).map(repr)
RULES: dict[str, tuple[str, st.SearchStrategy[dict[str, str]]]] = {
    "am keys missing": (
        "stimulus",
        st.sampled_from(sorted(AM)[:3]).map(lambda gone: {key: AM[key] for key in AM if key != gone}),
    ),
    "path key without path": ("stimulus", st.sampled_from(("path_diameter_m", "path_width_m", "path_rate_Hz")).flatmap(
        lambda key: POSITIVE.map(lambda value: {key: value}))),
    "path without its size": ("stimulus", st.sampled_from(("circle", "line", "zigzag", "square", "z", "lissajous")).map(
        lambda path: {"path": path, "path_rate_Hz": "10"})),
    "path without a rate": ("stimulus", POSITIVE.map(lambda d: {"path": "circle", "path_diameter_m": d})),
    "rate and speed": ("stimulus", POSITIVE.map(lambda v: {**CIRCLE, "path_speed_m_s": v})),
    "stray key of another path": ("stimulus", POSITIVE.map(lambda h: {**CIRCLE, "path_height_m": h})),
    "level set twice": ("stimulus", POSITIVE.map(lambda a: {"arp_peak_Pa": "5", "drive_amplitude": a})),
    "burst key without bursts": ("stimulus", POSITIVE.map(lambda s: {"burst_length_s": s})),
    "burst longer than its period": ("stimulus", POSITIVE.map(
        lambda s: {"burst_window": "hann", "burst_length_s": repr(2 * float(s)), "burst_period_s": s})),
    "stop before start": ("stimulus", POSITIVE.map(lambda s: {"start_s": repr(2 * float(s)), "stop_s": s})),
    "foci in part": ("stimulus", st.integers(1, 20).filter(lambda n: n % 3 or n == 3).map(
        lambda n: {"foci_m": " ".join(["0.01"] * n)})),
    "arrays twice": ("stimulus", st.sampled_from("abc").map(lambda name: {"arrays": f"{name} {name}"})),
    "on_skin without a path there": ("stimulus", st.sampled_from("abc").map(lambda name: {"on_skin": name})),
    "focus too far": ("stimulus", st.floats(10.1, 1e6).map(lambda z: {"focus_m": f"0 0 {z!r}"})),
    "ratio of one": ("stimulus", st.integers(1, 9).map(lambda n: {
        "path": "lissajous", "path_width_m": "0.01", "path_height_m": "0.01", "path_rate_Hz": "5", "path_ratio": str(n),
    })),
    "disc without size": ("skin", st.sampled_from(("radius_m", "thickness_m")).map(
        lambda gone: {key: DISC[key] for key in DISC if key != gone})),
    "key of another shape": ("skin", st.sampled_from(
        (("mesh", "x.obj"), ("mesh_unit", "mm"), ("hand", "open_men_p05"), ("depth_m", "0.004"),
         ("patch_radius_m", "0.01"), ("patch_site", "centre"))).map(lambda one: {**DISC, one[0]: one[1]})),
    "size of a disc": ("skin", st.sampled_from(("radius_m", "thickness_m")).flatmap(
        lambda key: st.floats(0.001, 1.0).map(lambda value: {"patch_site": "centre", key: repr(value)}))),
    "mesh without its file": ("skin", st.sampled_from(("mesh", "rigged")).map(
        lambda shape: {"shape": shape, "patch_site": "centre"})),
    "mesh without a unit": ("skin", st.sampled_from(("a.obj", "a.stl", "a.ply")).map(
        lambda name: {"shape": "mesh", "mesh": name, "patch_site": "centre"})),
    "no patch": ("skin", st.sampled_from(("hand", "articulated")).map(lambda shape: {"shape": shape})),
    "half a foundation": ("skin", POSITIVE.map(lambda k: {**DISC, "foundation_normal_Pa_m": k})),
    "springs without stiffness": ("skin", POSITIVE.map(
        lambda k: {**DISC, "base": "springs", "base_normal_Pa_m": k})),
    "stiffness without springs": ("skin", POSITIVE.map(lambda k: {**DISC, "base_normal_Pa_m": k})),
    "shares that don't add up": ("skin", st.floats(0.01, 0.9).filter(lambda a: abs(a - 0.5) > 1e-3).map(
        lambda a: {**DISC, "materials": "palm palm", "shares": f"{a!r} 0.5"})),
    "a share for each": ("skin", st.integers(2, 5).map(
        lambda n: {**DISC, "materials": "palm", "shares": " ".join([repr(1.0 / n)] * n)})),
    "both materials": ("skin", POSITIVE.map(
        lambda _: {**DISC, "material": "palm", "materials": "palm palm", "shares": "0.5 0.5"})),
    "a layer that flies": ("skin", st.sampled_from(("free", "roller", "absorbing")).map(
        lambda side: {**DISC, "base": "free", "side": side})),
    "roller on a hand": ("skin", st.just({"patch_site": "centre", "side": "roller"})),
    "obstacles without shadows": ("skin", st.sampled_from("abc").map(lambda name: {**DISC, "obstacles": name})),
    "edges without shadows": ("skin", st.sampled_from(("rays", "knife_edge")).map(
        lambda edges: {**DISC, "shadow_edges": edges})),
    "half a range of p0": ("array", POSITIVE.map(lambda p: {"p0_low_Pa_m": p})),
    "p0 outside its range": ("array", st.floats(3.0, 5.0).map(
        lambda p: {"p0_Pa_m": "2", "p0_low_Pa_m": repr(p), "p0_high_Pa_m": "6"})),
    "sites without their layout": ("array", st.sampled_from("abc").map(lambda name: {"sites": name})),
    "no motion": ("motion", st.just({"body": "hand_target"})),
    "two motions": ("motion", st.sampled_from(("trajectory", "tracking", "function")).map(
        lambda key: {"keyframes": "a.toml", key: "b"})),
    "tracking key without tracking": ("motion", POSITIVE.map(lambda s: {"keyframes": "a.toml", "ahead_s": s})),
}  # fmt: skip
"""For each rule, its plugin and keys that break it."""


@st.composite
def broken_rules(draw: Callable[..., Any]) -> Case:
    """Draw keys that are allowed one by one, but not together."""
    rule = draw(st.sampled_from(sorted(RULES)))
    plugin, values = RULES[rule]
    return Case("rules", rule, True, plugin=f"palmfield.{plugin}", values=draw(values))


# -- scenes --------------------------------------------------------------------------------------------------------

Files = dict[str, str]
FORBIDDEN_EDITS: dict[str, tuple[str, str, str]] = {
    "unknown element": ("plain.xml", "<geom type", "<goem type"),
    "unknown attribute": ("plain.xml", "<geom type", "<geom typ"),
    "words for numbers": ("plain.xml", 'size="0.02 0.004"', 'size="wide"'),
    "not closed": ("plain.xml", "</body>", ""),
    "closed twice": ("plain.xml", "</body>", "</body></body>"),
    "name twice": ("plain.xml", '<site name="centre"', '<site name="centre"/><site name="centre"'),
    "no include": ("scene.xml", "plain.xml", "plane.xml"),
    "included twice": ("scene.xml", '<include file="plain.xml"/>', '<include file="plain.xml"/>' * 2),
    "includes itself": ("plain.xml", "<worldbody>", '<include file="plain.xml"/><worldbody>'),
    "another root": ("scene.xml", "mujoco", "mjcf"),
    "attribute twice": ("plain.xml", 'name="pad"', 'name="pad" name="pad"'),
    "plugin misspelt": ("scene.xml", "palmfield.stimulus", "palmfield.stimuli"),
    "key misspelt": ("scene.xml", "radius_m", "radius_mm"),
    "key twice": ("scene.xml", '<config key="body"', '<config key="body" value="pad"/><config key="body"'),
    "key without value": ("scene.xml", 'key="radius_m" value="0.02"', 'key="radius_m"'),
    "key with an empty value": ("scene.xml", 'key="radius_m" value="0.02"', 'key="radius_m" value=""'),
    "no body": ("scene.xml", 'value="pad"', 'value="paw"'),
    "no material": ("scene.xml", "ecoflex_00-10", "ecoflex"),
    "no site": ("scene.xml", 'objname="centre"', 'objname="center"'),
    "sensor without objtype": ("scene.xml", ' objtype="site" objname="centre"', ""),
    "sensor off the skin": ("plain.xml", '<site name="centre"', '<site name="centre" pos="0 0 0.03"'),
    "sensor of no instance": ("scene.xml", 'instance="skin"', 'instance="skn"'),
    "instance twice": ("scene.xml", '<instance name="driver">', '<instance name="driver"/><instance name="driver">'),
    "two arrays in one place": ("scene.xml", '<instance name="array">', '<instance name="b"/><instance name="array">'),
    "no array": ("scene.xml", "palmfield.array", "palmfield.motion"),
    "focus behind": ("scene.xml", "0 0 0.12", "0 0 -0.12"),
    "focus in millimetres": ("scene.xml", "0 0 0.12", "0 0 120"),
    "body in the array": ("plain.xml", 'pos="0 0 0.12"', 'pos="0 0 -0.001"'),
    "no timestep": ("scene.xml", 'timestep="0.001"', 'timestep="0"'),
    "negative timestep": ("scene.xml", 'timestep="0.001"', 'timestep="-0.001"'),
    "no duration": ("scene.xml", 'data="0.01"', 'data="0"'),
    "duration twice": ("scene.xml", "<custom>", '<custom><numeric name="palmfield_duration_s" data="1"/>'),
    "setting misspelt": ("scene.xml", "palmfield_device", "palmfield_devise"),
    "instance without a name": ("scene.xml", '<instance name="driver">', '<instance name="">'),
    "no device": ("scene.xml", 'data="cpu"', 'data="gpu"'),
    "step that doesn't divide": ("scene.xml", 'value="0.0005"', 'value="0.0003"'),
    "elements without end": ("scene.xml", 'value="0.006"', 'value="1e-9"'),
    "a body nowhere": ("plain.xml", 'pos="0 0 0.12"', 'pos="nan 0 0.12"'),
    "a body at infinity": ("plain.xml", 'pos="0 0 0.12"', 'pos="0 0 inf"'),
    "an axis that is none": ("plain.xml", 'axis="1 0 0"', 'axis="0 0 0"'),
    "text between elements": ("scene.xml", "<custom>", "<custom> wait"),
    "text in place of a scene": ("scene.xml", HAPTIC, "hello"),
    "nothing": ("scene.xml", HAPTIC, ""),
    "two roots": ("scene.xml", "</mujoco>", "</mujoco><mujoco/>"),
    "entity": ("scene.xml", 'value="pad"', 'value="&pad;"'),
    "massless": ("plain.xml", "<geom type", '<body><joint/></body><geom type'),
}  # fmt: skip
"""Faulty edits: a file, a text in it, and its replacement."""


@st.composite
def broken_scenes(draw: Callable[..., Any]) -> Case:
    """Draw a scene with one known fault, or with texts, numbers or bytes changed at random."""
    files: Files = {"plain.xml": PLAIN, "scene.xml": HAPTIC}
    way = draw(st.sampled_from(("known", "known", "bytes", "numbers", "lines")))
    if way == "known":
        fault = draw(st.sampled_from(sorted(FORBIDDEN_EDITS)))
        file, old, new = FORBIDDEN_EDITS[fault]
        files[file] = files[file].replace(old, new)
        comment = f"<!-- {draw(st.integers(0, 999))} -->\n"
        # Where nothing is left, nothing may be added
        files["plain.xml"] += comment if file != "plain.xml" or files[file] else ""
        return Case("scene", fault, True, files={name: text.encode() for name, text in files.items()})
    file = draw(st.sampled_from(sorted(files)))
    if way == "numbers":
        numbers = list(re.finditer(r"(?<![\w.])-?\d+\.?\d*(?:e-?\d+)?(?![\w.])", files[file]))
        found = draw(st.sampled_from(numbers))
        new = draw(st.sampled_from(EXTREMES))
        changed = files[file][: found.start()] + new + files[file][found.end() :]
        return _random_scene(files, file, changed.encode(), f"number {new or 'left out'}")
    if way == "lines":
        lines = files[file].splitlines(keepends=True)
        one, other = draw(st.integers(0, len(lines) - 1)), draw(st.integers(0, len(lines) - 1))
        if draw(st.booleans()):
            lines[one], lines[other] = lines[other], lines[one]
            return _random_scene(files, file, "".join(lines).encode(), "lines changed places")
        lines.insert(other, lines[one])
        return _random_scene(files, file, "".join(lines).encode(), "a line twice")
    data = bytearray(files[file].encode())
    for _ in range(draw(st.integers(1, 4))):
        place = draw(st.integers(0, max(len(data) - 1, 0)))
        what = draw(st.sampled_from(("change", "drop", "insert", "cut")))
        if what == "change":
            data[place : place + 1] = bytes([draw(BYTES)])
        elif what == "drop":
            del data[place : place + draw(st.integers(1, 30))]
        elif what == "insert":
            data[place:place] = bytes(draw(st.lists(BYTES, min_size=1, max_size=8)))
        else:
            del data[max(place, 1) :]
    return _random_scene(files, file, bytes(data), "bytes changed")


def _random_scene(files: Files, file: str, data: bytes, fault: str) -> Case:
    contents = {name: text.encode() for name, text in files.items()}
    return Case("scene", fault, False, files=contents | {file: data})


# -- meshes --------------------------------------------------------------------------------------------------------

BALL = trimesh.creation.icosphere(subdivisions=2, radius=0.04)
KINDS = ("obj", "stl", "ply", "glb")


def written(mesh: trimesh.Trimesh, kind: str) -> bytes:
    data = mesh.export(file_type=kind)
    return data.encode() if isinstance(data, str) else bytes(data)


def _obj(vertices: np.ndarray, faces: np.ndarray) -> bytes:
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    return "\n".join([*lines, *(f"f {a} {b} {c}" for a, b, c in faces.tolist())]).encode()


@st.composite
def broken_meshes(draw: Callable[..., Any]) -> Case:
    """Draw a ball of 40 mm as OBJ, STL, PLY or GLB, with one known fault, or with bytes changed at random."""
    vertices, faces = np.array(BALL.vertices), np.array(BALL.faces) + 1
    if draw(st.booleans()):
        fault = draw(st.sampled_from(sorted(MESH_FAULTS)))
        number = draw(st.integers(0, len(vertices) - 1))
        return Case("mesh", fault, True, files={"mesh.obj": MESH_FAULTS[fault](vertices, faces, number)})
    kind = draw(st.sampled_from(KINDS))
    data = bytearray(written(BALL, kind))
    what = draw(st.sampled_from(("cut", "bytes", "head", "nothing", "another format")))
    if what == "cut":
        del data[draw(st.integers(1, len(data) - 1)) :]
    elif what == "bytes":
        for _ in range(draw(st.integers(1, 30))):
            data[draw(st.integers(0, len(data) - 1))] = draw(BYTES)
    elif what == "head":
        data[: draw(st.integers(1, 40))] = draw(st.binary(max_size=40))
    elif what == "nothing":
        data = bytearray(draw(st.binary(max_size=3)))
    else:
        kind = draw(st.sampled_from([other for other in KINDS if other != kind]))
    return Case("mesh", f"{what}", what == "nothing", files={f"mesh.{kind}": bytes(data)})


def _with(value: float) -> Callable[[np.ndarray, np.ndarray, int], bytes]:
    def changed(vertices: np.ndarray, faces: np.ndarray, number: int) -> bytes:
        vertices[number, number % 3] = value
        return _obj(vertices, faces)

    return changed


def _with_index(vertices: np.ndarray, faces: np.ndarray, number: int) -> bytes:
    faces[number, 0] = len(vertices) + 1 + number
    return _obj(vertices, faces)


MESH_FAULTS: dict[str, Callable[[np.ndarray, np.ndarray, int], bytes]] = {
    "a vertex that is no number": _with(float("nan")),
    "a vertex at infinity": _with(float("inf")),
    "a face of no vertex": _with_index,
    "no faces": lambda vertices, faces, number: _obj(vertices[: number + 1], faces[:0]),
    "no size": lambda vertices, faces, number: _obj(0.0 * vertices + number, faces),
    "a flat ball": lambda vertices, faces, number: _obj(vertices * [1.0, 1.0, 0.0] + number, faces),
    "as large as a town": lambda vertices, faces, number: _obj(vertices * 1e4 * (1 + number), faces),
    "as small as a cell": lambda vertices, faces, number: _obj(vertices * 1e-5 / (1 + number), faces),
}

STRATEGIES: dict[str, st.SearchStrategy[Case]] = {
    "keys": wrong_keys(),
    "rules": broken_rules(),
    "scene": broken_scenes(),
    "mesh": broken_meshes(),
}
