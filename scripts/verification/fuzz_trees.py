"""Change elements, names, keys and values of shipped and small scenes at random; they stay well-formed.

python scripts/verification/fuzz_trees.py --cases 1000 --seed 29 --write docs/bench/fuzzing.md

Each case is the tree of a scene with one to three changes. Values have the right type, and most are within the declared
range of a key or at its ends. A refusal is then for the content of the scene.
"""

import argparse
import copy
import math
import random
import re
import sys
import time
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from fuzz import BAD, run_cases
from fuzz_cases import Case
from small_scene import ARRAYS, small_scene_texts

from palmfield.config import CONFIGS, Config
from palmfield.studies.bench.field import git_commit
from palmfield.studies.bench.table import keep_rows

SCENES = ARRAYS.parent / "scenes"
SHARE_OF_SHIPPED = 0.25
"""Share of shipped scenes; these are loaded and planned, and take seconds each."""
BY_PLUGIN = {config.plugin: config for config in CONFIGS}
AM = {"modulation": "am", "am_quantity": "arp", "am_frequency_Hz": 125, "am_depth": 0.5}
CIRCLE = {
    "path": "circle",
    "path_diameter_m": 0.01,
    "path_rate_Hz": 100,
    **dict.fromkeys(("modulation", *list(AM)[1:])),
}
SMALL: tuple[dict[str, dict[str, object]], ...] = (
    {},
    {"stimulus": CIRCLE},
    {"stimulus": {"foci_m": "0.01 0 0  -0.01 0 0"}, "array": {"response": "on"}},
    {"stimulus": AM, "array": {"layout": "uhev1", "quality": 20}, "skin": {"body_sound": "shadows"}},
    {
        "driver": {"board": "ultraino"},
        "array": {"layout": "ultraino"},
        "stimulus": {**CIRCLE, "path_rate_Hz": 5, "control_rate_Hz": 50},
    },
    {
        "skin": {"base": "free_slip"},
        "stimulus": {"burst_window": "hann", "burst_length_s": 0.004, "burst_period_s": 0.01},
    },
    {"skin": {"material": None, "materials": "palm finger_pad", "shares": "0.5 0.5"}},
    {"skin": {"solver": "spectral_elements"}, "stimulus": AM},
)
NUMBERS = ("0", "-1", "1e-9", "1e-3", "1000", "1e9", "-0.5", "0.5", "nan", "inf", "1e308", "90", "2")
FACTORS = (0.0, -1.0, 0.1, 10.0, 1000.0, 1e-3, 1.01, math.nan)
WORDS = ("", " ", "none", "x" * 70, "käse", "../x", "a b", "0", "world", "NaN", "true")
NUMERIC = re.compile(r"^\s*(-?\d[\d.e+-]*\s*)+$")
FRAMES = (
    {"pos": "0 0 0.03"}, {"euler": "0 0 90"}, {"euler": "180 0 0"}, {"quat": "0 0 0 0"}, {"pos": "0 0 -1"},
    {"axisangle": "1 0 0 30"}, {"pos": "1e6 0 0"}, {"xyaxes": "1 0 0 1 0 0"},
)  # fmt: skip
HEADING = "## Scenes that stay well-formed"
EXTRAS = """
mujoco <compiler angle="radian"/>
mujoco <compiler eulerseq="zyx" autolimits="false"/>
mujoco <compiler boundmass="1" boundinertia="1" balanceinertia="true"/>
mujoco <compiler inertiafromgeom="false"/>
mujoco <compiler discardvisual="true"/>
mujoco <compiler fusestatic="true"/>
mujoco <option gravity="0 0 0"/>
mujoco <option integrator="RK4"/>
mujoco <option integrator="implicitfast" timestep="0.002"/>
mujoco <option timestep="1e-6"/>
mujoco <option timestep="1"/>
mujoco <option density="1000" viscosity="1"/>
mujoco <option><flag sensor="disable"/></option>
mujoco <option><flag passive="disable"/></option>
mujoco <option><flag spring="disable" damper="disable" energy="enable"/></option>
mujoco <default><geom contype="0"/><site size="1"/></default>
mujoco <size memory="1K"/>
mujoco <size nuserdata="-1"/>
mujoco <statistic extent="0"/>
mujoco <visual><map znear="0"/></visual>
mujoco <keyframe><key time="-1"/></keyframe>
mujoco <custom><numeric name="palmfield_accuracy" data="0.05"/></custom>
mujoco <contact><exclude body1="pad" body2="world"/></contact>
worldbody <light/>
worldbody <camera/>
worldbody <body name="far" pos="5 5 5"><freejoint/><geom size="0.1"/></body>
worldbody <body name="near" pos="0 0 0.06"><geom size="0.02"/></body>
worldbody <geom type="plane" size="1 1 1"/>
worldbody <body mocap="true" name="ghost"/>
worldbody <site name="array"/>
worldbody <frame/>
worldbody <replicate count="3" offset="0.1 0 0"><site name="r"/></replicate>
sensor <clock name="clock"/>
sensor <user dim="2"/>
extension <plugin plugin="mujoco.pid"/>
extension <plugin plugin="palmfield.skin"><instance name="bare"/></plugin>
extension <plugin plugin="palmfield.motion"><instance name="m"><config key="function" value="x:y"/></instance></plugin>
""".strip().splitlines()
"""Additional elements by parent: all well-formed, few valid in every scene."""


def drawn_trees(count: int, seed: int, share_of_shipped: float = SHARE_OF_SHIPPED) -> list[Case]:
    """Return this number of different scenes; equal for equal seeds."""
    rng = random.Random(seed)
    shipped = [path for path in sorted(SCENES.glob("*.xml")) if "palmfield.skin" in path.read_text()]
    result: dict[str, Case] = {}
    while len(result) < count:
        if rng.random() < share_of_shipped:
            path = rng.choice(shipped)
            texts = {"scene.xml": _with_whole_paths(path.read_text())}
        else:
            plain, haptic = small_scene_texts(0.01, **rng.choice(SMALL))
            texts = {"plain.xml": plain, "scene.xml": haptic}
        trees = {name: ET.fromstring(text.strip()) for name, text in texts.items()}
        done = []
        for _ in range(rng.choice((1, 1, 1, 2, 2, 3))):
            name = rng.choice([*CHANGES, *OFTEN])
            if CHANGES[name](rng, trees[rng.choice(["scene.xml", *trees])]):
                done.append(name)
        files = {name: ET.tostring(tree) for name, tree in trees.items()}
        if done:
            result.setdefault(repr(files), Case("tree", " + ".join(sorted(done)), False, files=files))
    return list(result.values())


def _with_whole_paths(text: str) -> str:
    """Return the text of a shipped scene with the paths for another folder."""
    text = re.sub(r'file="(?!/)([^"]+)"', lambda found: f'file="{(SCENES / found[1]).resolve()}"', text)
    return re.sub(r'value="(\.\./[^"]+)"', lambda found: f'value="{(SCENES / found[1]).resolve()}"', text)


def right_value(rng: random.Random, config: type[Config], key: str) -> str:
    """Return a value of the type of a key, most often within its bounds or at their ends."""
    schema: dict[str, Any] = config.model_json_schema()["properties"][key]
    option = next((one for one in schema.get("anyOf", [schema]) if one.get("type") != "null"), schema)
    if "enum" in option:
        return str(rng.choice(option["enum"]))
    if option.get("type") in ("number", "integer"):
        return _number(rng, option, schema.get("default"))
    if option.get("type") == "array":
        item = option.get("items", {"type": "number"})
        count = option.get("maxItems") or rng.choice((0, 1, 2, 3, 6, 9))
        if item.get("type") == "string":
            return " ".join(rng.choice((*NAMES, "palm", "x")) for _ in range(count))
        return " ".join(_number(rng, item, rng.choice((0.0, 0.01, 0.1, 0.2))) for _ in range(count))
    return rng.choice((*NAMES, *WORDS, "palm", "open_men_p50", "autd3"))


NAMES = ("array", "stimulus", "skin", "driver", "pad", "centre", "hand", "palm_centre", "array uhev1")


def _number(rng: random.Random, option: dict[str, Any], usual: object) -> str:
    low, high = (
        option.get("minimum", option.get("exclusiveMinimum")),
        option.get("maximum", option.get("exclusiveMaximum")),
    )
    choices = [10.0 ** rng.uniform(-6, 6), rng.uniform(0.0, 1.0)]
    choices += [one for one in (low, high) if one is not None]
    if low is not None and high is not None:
        choices += [low + rng.random() * (high - low)] * 2
    if isinstance(usual, int | float):
        choices += [usual * factor for factor in (0.1, 0.5, 2.0, 10.0)] * 2
    chosen = rng.choice(choices)
    return str(round(chosen)) if option.get("type") == "integer" else repr(float(chosen))


# -- changes: each takes a tree and says whether it changed it -----------------------------------------------------


def _parents(tree: ET.Element) -> list[tuple[ET.Element, ET.Element]]:
    return [(parent, child) for parent in tree.iter() for child in parent]


def _instances(tree: ET.Element) -> list[tuple[str, ET.Element]]:
    found = [(plugin.get("plugin", ""), one) for plugin in tree.iter("plugin") for one in plugin.iter("instance")]
    return [(name, one) for name, one in found if name in BY_PLUGIN]


def _change_key(rng: random.Random, tree: ET.Element) -> bool:
    known = [(name, key) for name, one in _instances(tree) for key in one.iter("config")]
    known = [(name, key) for name, key in known if key.get("key") in BY_PLUGIN[name].model_fields]
    if not known:
        return False
    name, key = rng.choice(known)
    key.set("value", right_value(rng, BY_PLUGIN[name], key.get("key", "")))
    return True


def _add_key(rng: random.Random, tree: ET.Element) -> bool:
    if not (instances := _instances(tree)):
        return False
    name, one = rng.choice(instances)
    here = {key.get("key") for key in one.iter("config")}
    key = rng.choice([key for key in BY_PLUGIN[name].model_fields if key not in here])
    ET.SubElement(one, "config", key=key, value=right_value(rng, BY_PLUGIN[name], key))
    return True


def _key_of_another(rng: random.Random, tree: ET.Element) -> bool:
    if not (instances := _instances(tree)):
        return False
    name, one = rng.choice(instances)
    other = rng.choice([config for config in CONFIGS if config.plugin != name])
    key = rng.choice(list(other.model_fields))
    ET.SubElement(one, "config", key=key, value=right_value(rng, other, key))
    return True


def _remove(rng: random.Random, tree: ET.Element) -> bool:
    if not (pairs := _parents(tree)):
        return False
    parent, child = rng.choice(pairs)
    parent.remove(child)
    return True


def _double(rng: random.Random, tree: ET.Element) -> bool:
    if not (pairs := _parents(tree)):
        return False
    parent, child = rng.choice(pairs)
    again = copy.deepcopy(child)
    if rng.random() < 0.7:
        for one in again.iter():
            if "name" in one.attrib:
                one.set("name", one.get("name", "") + "_2")
    parent.append(again)
    return True


def _move(rng: random.Random, tree: ET.Element) -> bool:
    pairs = _parents(tree)
    if len(pairs) < 2:
        return False
    parent, child = rng.choice(pairs)
    inside = set(child.iter())
    target = rng.choice([one for one in tree.iter() if one not in inside])
    parent.remove(child)
    target.insert(rng.randint(0, len(target)), child)
    return True


def _reorder(rng: random.Random, tree: ET.Element) -> bool:
    several = [one for one in tree.iter() if len(one) > 1]
    if not several:
        return False
    parent = rng.choice(several)
    children = list(parent)
    rng.shuffle(children)
    parent[:] = children
    return True


def _scale(rng: random.Random, tree: ET.Element) -> bool:
    numeric = [(one, key) for one in tree.iter() for key, value in one.attrib.items() if NUMERIC.match(value)]
    if not numeric:
        return False
    one, key = rng.choice(numeric)
    numbers = one.get(key, "").split()
    if rng.random() < 0.5:
        numbers[rng.randrange(len(numbers))] = rng.choice(NUMBERS)
    else:
        factor = rng.choice(FACTORS)
        numbers = [repr(float(number) * factor) if _is_number(number) else number for number in numbers]
    if rng.random() < 0.1:
        numbers = numbers[:-1] if len(numbers) > 1 and rng.random() < 0.5 else [*numbers, "0.1"]
    one.set(key, " ".join(numbers))
    return True


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _rename(rng: random.Random, tree: ET.Element) -> bool:
    """Change a name or a reference: to a word, to another name, or to nothing."""
    texts = [(one, key) for one in tree.iter() for key, value in one.attrib.items() if not NUMERIC.match(value)]
    texts = [(one, key) for one, key in texts if key not in ("file", "plugin", "key")]
    if not texts:
        return False
    one, key = rng.choice(texts)
    if rng.random() < 0.25:
        del one.attrib[key]
    else:
        others = [other.get(own, "") for other, own in texts]
        one.set(key, rng.choice((*WORDS, *others)))
    return True


def _attribute_of_another(rng: random.Random, tree: ET.Element) -> bool:
    attributes = [(key, value) for one in tree.iter() for key, value in one.attrib.items()]
    if not attributes:
        return False
    one = rng.choice(list(tree.iter()))
    key, value = rng.choice(attributes)
    one.set(key, value)
    return True


def _add_element(rng: random.Random, tree: ET.Element) -> bool:
    section, _, text = rng.choice(EXTRAS).partition(" ")
    if section == tree.tag:
        tree.append(ET.fromstring(text))
        return True
    home = tree.find(section)
    (ET.SubElement(tree, section) if home is None else home).append(ET.fromstring(text))
    return True


def _wrap(rng: random.Random, tree: ET.Element) -> bool:
    """Put a body, site or geom into a frame, or replicate it."""
    wrapped = [(parent, child) for parent, child in _parents(tree) if child.tag in ("body", "site", "geom", "frame")]
    if not wrapped:
        return False
    parent, child = rng.choice(wrapped)
    place = list(parent).index(child)
    parent.remove(child)
    if rng.random() < 0.7:
        frame = ET.Element("frame", rng.choice(FRAMES))
    else:
        frame = ET.Element("replicate", count=str(rng.choice((1, 2, 5))), offset="0.05 0 0", sep="-")
    frame.append(child)
    parent.insert(place, frame)
    return True


def _graft(rng: random.Random, tree: ET.Element) -> bool:
    """Insert a part of a shipped scene, at a valid place or not."""
    path = rng.choice([path for path in sorted(SCENES.glob("*.xml")) if "palmfield.skin" in path.read_text()])
    other = ET.fromstring(_with_whole_paths(path.read_text()))
    section = rng.choice(list(other))
    if not len(section):
        tree.append(section)
        return True
    part = rng.choice(list(section))
    home = tree.find(section.tag)
    (ET.SubElement(tree, section.tag) if home is None else home).append(part)
    return True


OFTEN = ("key changed", "key added", "order") * 2
"""Changes that are made more often than others, most of which MuJoCo refuses."""
CHANGES: dict[str, Callable[[random.Random, ET.Element], bool]] = {
    "key changed": _change_key,
    "key added": _add_key,
    "key of another module": _key_of_another,
    "element removed": _remove,
    "element twice": _double,
    "element moved": _move,
    "order": _reorder,
    "numbers": _scale,
    "names": _rename,
    "attribute of another": _attribute_of_another,
    "element added": _add_element,
    "framed or replicated": _wrap,
    "graft": _graft,
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=29)
    parser.add_argument("--write", type=Path, help="markdown page, of which this is a section")
    arguments = parser.parse_args()
    start = time.monotonic()
    outcomes = run_cases(drawn_trees(arguments.cases, arguments.seed))
    names = sorted(set(CHANGES) | {name for one in outcomes for name in one.case.fault.split(" + ")})
    counts = {name: Counter(one.outcome for one in outcomes if name in one.case.fault.split(" + ")) for name in names}
    counts["all"] = Counter(one.outcome for one in outcomes)
    table = ["| change | refused | accepted | bad |", ""]
    for name, own in counts.items():
        table.append(f"| {name} | {own['refused']} | {own['accepted']} | {sum(own[one] for one in BAD)} |")
    link = keep_rows(arguments.write, table, "fuzzing_scenes") if arguments.write else "by change: --write"
    section = [
        HEADING,
        "",
        f"    python scripts/verification/fuzz_trees.py --cases {arguments.cases} --seed {arguments.seed} "
        "--write docs/bench/fuzzing.md",
        "",
        f"Commit {git_commit()}, {time.monotonic() - start:.0f} s. {len(outcomes)} well-formed scenes had one to three "
        f"random changes each. {SHARE_OF_SHIPPED:.0%} of them are shipped scenes, and the others variants of a "
        "small scene. "
        "Each scene is planned, and stepped three times if the plan expects a few seconds. Bad outcomes also include "
        "NumPy "
        "warnings and numbers that are not finite.",
        "",
        f"Refused: {counts['all']['refused']}, accepted: {counts['all']['accepted']}, bad: "
        f"{sum(counts['all'][one] for one in BAD)} ({link}).",
        "",
    ]
    bad = [one for one in outcomes if one.outcome in BAD]
    for one in bad:
        print(f"{one.outcome}: {one.case.fault}\n{one.case.files}\n  {one.message}\n", file=sys.stderr)
    print("\n".join(section))
    if arguments.write is not None:
        page = arguments.write.read_text()
        before, _, rest = page.partition(HEADING)
        _, mark, after = rest.partition("\n## ")
        arguments.write.write_text(before.rstrip() + "\n\n" + "\n".join(section) + mark + after)
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
