"""Equivalent forms of a scene: moved, rotated, mirrored, in another order, louder, with arrays from files.

A variant is a scene file and the keys with which it is opened. Its results must be those of the scene, except for the
transformation by `Variant.factor`, `Variant.turn` and `Variant.mirror`.
"""

import copy
import math
import tomllib
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from palmfield import Simulation
from palmfield.acoustics.arrays import layout
from palmfield.engine.scene_runtime import SceneRuntime
from palmfield.types import Float

MJCF = Path(__file__).resolve().parents[2] / "mjcf"
SCENES = sorted(p.stem for p in (MJCF / "scenes").glob("*.xml") if not p.stem.startswith("plain_"))
OTHER_HAND = {"open_men_p50": "open_men_p50_left", "open_men_p50_left": "open_men_p50"}
TURNED = "_turned"
START_s = {"tap_button": 0.127, "approach_withdraw": 0.1, "two_hands": 0.05}
"""Times at which sound reaches the hand of a scene, if not a quarter of its duration after the start."""


@dataclass(frozen=True)
class Variant:
    """A form of a scene. path: scene file; keys: its keys; worlds: number of worlds, None for a single simulation

    world: evaluated world; turn, shift: of the world, x -> turn x + shift [m]; mirror: signs of the coordinates before
        that; factor: of ARP, force and motion; substeps: steps per step of the scene truth: keys with which the scene
        itself has the same results
    """

    path: Path
    keys: Mapping[str, object] = field(default_factory=dict)
    worlds: int | None = None
    world: int = 0
    turn: Rotation = field(default_factory=Rotation.identity)
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    mirror: Float = field(default_factory=lambda: np.ones(3))
    factor: float = 1.0
    substeps: int = 1
    truth: Mapping[str, object] = field(default_factory=dict)


@dataclass(frozen=True)
class Seen:
    """Results of a scene after each step. forces: name -> force on each, (t, 3); skins: name -> field -> (t, ...)

    rest: name -> surface nodes [m], (s, 3); accuracy: the smallest key of the scene stated: smallest error estimate of
        displacement by modes and small models; without them the accuracy
    """

    forces: Mapping[str, Float]
    skins: Mapping[str, Mapping[str, Float]]
    rest: Mapping[str, Float]
    accuracy: float
    stated: float


# -- a scene's text --------------------------------------------------------------------------------------------------


def scene_file(name: str) -> Path:
    return MJCF / "scenes" / f"{name}.xml"


def expanded(path: Path, axis: int | None = None) -> ET.Element:
    """Return a scene with its included files inserted, and all files by absolute paths.

    axis: axis whose sign changes: the hands are the opposite ones, and the positions of the scene are mirrored; arrays
    are their own mirror images
    """
    hand_or_array = path.parent.name in ("hands", "arrays")
    root = ET.parse(path if axis is None else other_hand(path)).getroot()
    if axis is not None and not hand_or_array:
        for world in root.findall("worldbody"):
            for element in world.iter():
                mirror_pose(element, axis)
    for parent in list(root.iter()):
        for place, child in reversed(list(enumerate(parent))):
            if child.tag == "include":
                parent[place : place + 1] = list(expanded((path.parent / child.get("file", "")).resolve(), axis))
            elif child.tag == "model" or (child.tag == "config" and child.get("key") == "keyframes"):
                name = "file" if child.tag == "model" else "value"
                child.set(name, str((path.parent / child.get(name, "")).resolve()))
    return root


def other_hand(path: Path) -> Path:
    """Return the left hand's file for that of a right hand, and the converse; other files unchanged."""
    other = path.stem.removesuffix("_left") if path.stem.endswith("_left") else path.stem + "_left"
    return path.with_name(f"{other}.xml") if path.parent.name == "hands" else path


def mirror_pose(element: ET.Element, axis: int) -> None:
    unknown = {"euler", "axisangle", "xyaxes", "zaxis", "fromto", "axis"} & set(element.keys())
    if unknown:
        raise NotImplementedError(f"<{element.tag}> has {unknown}")
    if (pos := element.get("pos")) is not None:
        element.set("pos", words(numbers(pos) * signs(axis)))
    if (quat := element.get("quat")) is not None:
        w, *vector = numbers(quat)
        element.set("quat", words([w, *(-signs(axis) * vector)]))


def signs(axis: int) -> Float:
    """Return the signs of the coordinates: that of one axis changes."""
    return np.where(np.arange(3) == axis, -1.0, 1.0)


def numbers(text: str) -> Float:
    return np.array(text.split(), dtype=float)


def words(values: object) -> str:
    return " ".join(repr(float(x)) for x in np.ravel(np.asarray(values, dtype=float)))


def instances(root: ET.Element, plugin: str) -> Iterator[ET.Element]:
    for element in root.findall("extension/plugin"):
        if element.get("plugin") == f"palmfield.{plugin}":
            yield from element.findall("instance")


def key(instance: ET.Element, name: str) -> str | None:
    return next((c.get("value") for c in instance.findall("config") if c.get("key") == name), None)


def set_key(instance: ET.Element, name: str, value: str | None) -> None:
    for old in [c for c in instance.findall("config") if c.get("key") == name]:
        instance.remove(old)
    if value is not None:
        ET.SubElement(instance, "config", key=name, value=value)


def written(root: ET.Element, folder: Path, name: str) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.xml"
    ET.ElementTree(root).write(path)
    return path


def change_keyframes(
    root: ET.Element, folder: Path, change: Callable[[Float, Rotation], tuple[Float, Rotation]]
) -> None:
    """Change poses of scripted hands by a function of position and orientation."""
    for instance in instances(root, "motion"):
        name = key(instance, "keyframes")
        if name is None:
            raise NotImplementedError("a motion without keyframes")
        lines = []
        for one in tomllib.loads(Path(name).read_text())["key"]:
            given = one.pop("quaternion", [1.0, 0.0, 0.0, 0.0])
            turned = one.pop("turn_deg", None)
            orientation = (
                Rotation.from_quat(given, scalar_first=True) if turned is None
                else Rotation.from_rotvec(turned, degrees=True)
            )  # fmt: skip
            position, orientation = change(np.array(one.pop("position_m")), orientation)
            lines += ["[[key]]", f"position_m = {position.tolist()}"]
            lines.append(f"quaternion = {orientation.as_quat(scalar_first=True).tolist()}")
            joints = one.pop("joints_deg", {})
            lines.append("joints_deg = {" + ", ".join(f"{k} = {v}" for k, v in joints.items()) + "}")
            lines += [f"{k} = {v!r}" for k, v in one.items()]
        folder.mkdir(parents=True, exist_ok=True)
        file = folder / f"{Path(name).stem}_changed.toml"
        file.write_text("\n".join(lines) + "\n")
        set_key(instance, "keyframes", str(file))


# -- variants --------------------------------------------------------------------------------------------------------


def plain(name: str, folder: Path) -> Variant:
    """Return the scene itself, in one file."""
    return Variant(written(expanded(scene_file(name)), folder, name))


def moved(name: str, folder: Path, turn: Rotation, shift: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Variant:
    """Rotate and then shift all objects in the world, gravity and the scripted motions."""
    root = expanded(scene_file(name))
    for world in root.findall("worldbody"):
        children = list(world)
        frame = ET.Element("frame", pos=words(shift), quat=words(turn.as_quat(scalar_first=True)))
        for child in children:
            world.remove(child)
            frame.append(child)
        world.append(frame)
    options = [o for o in root.findall("option") if o.get("gravity")] or [ET.SubElement(root, "option")]
    for option in options:
        option.set("gravity", words(turn.apply(numbers(option.get("gravity", "0 0 -9.81")))))
    change_keyframes(root, folder, lambda place, way: (turn.apply(place) + shift, turn * way))
    return Variant(written(root, folder, name), turn=turn, shift=shift)


def mirrored(name: str, folder: Path) -> Variant:
    """Exchange left and right, or front and back without a hand: the mesh rings of a disc have that symmetry.

    A path runs in the x-y plane of its frame, and a frame can be rotated but not mirrored. After a half turn about the
    other axis one of its axes has the opposite direction, and so has z, which the third coordinates of the foci
    correct.
    """
    axis = 0 if 'hand"' in scene_file(name).read_text() else 1
    root = expanded(scene_file(name), axis)
    for model in root.iter("model"):
        file = other_hand(Path(model.get("file", "")))
        attached = expanded(file)
        add_turned_sites(attached, 1 - axis)
        model.set("file", str(written(attached, folder / "attached", file.stem)))
    add_turned_sites(root, 1 - axis)
    for instance in [*instances(root, "motion"), *instances(root, "skin")]:
        hand = key(instance, "hand")
        if hand is not None:
            set_key(instance, "hand", OTHER_HAND[hand])
    sites = {i.get("name"): key(i, "site") or "array" for i in instances(root, "array")}
    for instance in instances(root, "stimulus"):
        if key(instance, "path") == "sites":
            continue
        frame, own = key(instance, "frame") or "array", (key(instance, "arrays") or next(iter(sites))).split()
        set_key(instance, "frame", (sites[own[0]] if frame == "array" else frame) + TURNED)
        for name_of in ("focus_m", "foci_m"):
            if (value := key(instance, name_of)) is not None:
                set_key(instance, name_of, words(numbers(value).reshape(-1, 3) * [1.0, 1.0, -1.0]))
        if key(instance, "path_on") == "skin":
            mirror_path_on_skin(instance)

    def change(place: Float, way: Rotation) -> tuple[Float, Rotation]:
        return place * signs(axis), Rotation.from_rotvec(-signs(axis) * way.as_rotvec())

    change_keyframes(root, folder, change)
    return Variant(written(root, folder, name), mirror=signs(axis))


def mirror_path_on_skin(instance: ET.Element) -> None:
    """Mirror a path on skin by the sign of its y.

    On both hands, y of a path is to the left of its x, seen from outside.
    """
    if key(instance, "path") != "z":
        raise NotImplementedError(f"path {key(instance, 'path')} on skin")
    x, y = (0.5 * float(key(instance, f"path_{side}_m") or "nan") for side in ("width", "height"))
    corners = [(-x, y), (x, y), (-x, -y), (x, -y)]
    set_key(instance, "path", "polyline")
    set_key(instance, "path_through_m", words([(a, -b) for a, b in corners]))
    for side in ("width", "height"):
        set_key(instance, f"path_{side}_m", None)


def add_turned_sites(root: ET.Element, axis: int) -> None:
    """Add to each site one whose frame is rotated by half a turn about one of its own axes."""
    half = Rotation.from_rotvec(math.pi * np.eye(3)[axis])
    for parent in list(root.iter()):
        for site in parent.findall("site"):
            own = Rotation.from_quat(numbers(site.get("quat", "1 0 0 0")), scalar_first=True)
            twin = copy.deepcopy(site)
            twin.set("name", f"{site.get('name')}{TURNED}")
            twin.set("quat", words((own * half).as_quat(scalar_first=True)))
            parent.append(twin)


def reordered(name: str, folder: Path) -> Variant:
    """Reverse the order of plugins, their instances and sensors."""
    root = expanded(scene_file(name))
    for parent in [*root.findall("extension"), *root.findall("extension/plugin"), *root.findall("sensor")]:
        parent[:] = reversed(list(parent))
    return Variant(written(root, folder, name))


def from_file(name: str, folder: Path, reverse: bool = False) -> Variant:
    """Return the same transducers from a file, in the order of the layout or reversed."""
    root = expanded(scene_file(name))
    for instance in instances(root, "array"):
        known = layout(key(instance, "layout"))
        order = np.arange(len(known))[:: -1 if reverse else 1]
        columns = [known.positions[order], known.normals[order]]
        names = "x_m,y_m,z_m,nx,ny,nz"
        if known.address is not None:
            columns.append(known.address[order, None])
            names += ",address"
        rows = [",".join(repr(float(x)) for x in row[:6]) + "".join(f",{int(a)}" for a in row[6:])
                for row in np.concatenate(columns, axis=1)]  # fmt: skip
        folder.mkdir(parents=True, exist_ok=True)
        file = folder / f"{instance.get('name')}.csv"
        file.write_text("\n".join([names, *rows]) + "\n")
        set_key(instance, "layout", "csv")
        set_key(instance, "transducers", str(file))
        set_key(instance, "p0_Pa_m", repr(known.p0_Pa_m))
    return Variant(written(root, folder, name))


def louder(name: str, folder: Path) -> Variant:
    """Double p0: ARP, force and motion are four times as large, unless the stimulus sets the level."""
    root = expanded(scene_file(name))
    keys = {f"{i.get('name')}.p0_Pa_m": 2.0 * layout(key(i, "layout")).p0_Pa_m for i in instances(root, "array")}
    level = any(key(i, "arp_peak_Pa") for i in instances(root, "stimulus"))
    return Variant(written(root, folder, name), keys, factor=1.0 if level else 4.0)


def finer(name: str, folder: Path) -> Variant:
    """Halve the step of MuJoCo."""
    root = expanded(scene_file(name))
    options = [o for o in root.findall("option") if o.get("timestep")] or [ET.SubElement(root, "option")]
    for option in options:
        option.set("timestep", repr(0.5 * float(option.get("timestep", "0.002"))))
    return Variant(written(root, folder, name), substeps=2)


def in_two_worlds(name: str, folder: Path, world: int) -> Variant:
    """Return one of two worlds: the scene itself, or one with stimuli shifted by 2 mm, or slower on site paths."""
    root = expanded(scene_file(name))
    keys: dict[str, list[object]] = {}
    for instance in instances(root, "stimulus"):
        if key(instance, "path") == "sites":
            speed = float(key(instance, "path_speed_m_s") or "nan")
            keys[f"{instance.get('name')}.path_speed_m_s"] = [speed, 0.75 * speed]
        else:
            focus = numbers(key(instance, "focus_m") or "0 0 0.2")
            keys[f"{instance.get('name')}.focus_m"] = [focus.tolist(), (focus + 0.002 * np.eye(3)[0]).tolist()]
    truth = {one: values[world] for one, values in keys.items()}
    return Variant(written(root, folder, name), keys, worlds=2, world=world, truth=truth)


QUARTER = Rotation.from_rotvec([0.0, 0.0, 0.5 * math.pi])
AXES = Rotation.from_matrix(np.eye(3)[[2, 0, 1]])
"""Permutation of axes: x to y, y to z, z to x."""
SKEW = Rotation.from_rotvec([0.4, -0.7, 1.1])
VARIANTS: dict[str, Callable[[str, Path], Variant]] = {
    "shifted": lambda name, folder: moved(name, folder, Rotation.identity(), (0.31, -0.17, 0.23)),
    "turned by 90 degrees": lambda name, folder: moved(name, folder, QUARTER),
    "axes exchanged": lambda name, folder: moved(name, folder, AXES),
    "turned and shifted": lambda name, folder: moved(name, folder, SKEW, (0.31, -0.17, 0.23)),
    "mirrored": mirrored,
    "other order": reordered,
    "from a file": from_file,
    "from a file, other order": lambda name, folder: from_file(name, folder, reverse=True),
    "p0 x 2": louder,
    "step / 2": finer,
    "first of two worlds": lambda name, folder: in_two_worlds(name, folder, 0),
    "second of two worlds": lambda name, folder: in_two_worlds(name, folder, 1),
}  # fmt: skip


def variants(name: str) -> list[str]:
    """Return the variants of a scene: a board for one layout refuses only a file."""
    ideal = 'key="board" value="ideal"' in scene_file(name).read_text()
    return [words for words in VARIANTS if ideal or not words.startswith("from a file")]


# -- what they show --------------------------------------------------------------------------------------------------


def start_s(name: str, duration_s: float) -> float:
    return START_s.get(name, 0.25 * duration_s if "motion" in scene_file(name).read_text() else 0.0)


def seen(variant: Variant, name: str, steps: int, keys: Mapping[str, object] | None = None) -> Seen:
    """Return the results of a variant after each step of the scene, in the scene's own frame."""
    return seen_worlds(variant, name, steps, keys)[variant.world]


def seen_worlds(variant: Variant, name: str, steps: int, keys: Mapping[str, object] | None = None) -> list[Seen]:
    """Return the results of each world of a variant, see `seen`; one for a single simulation."""
    sim = Simulation(variant.path, device="cpu", worlds=variant.worlds, keys={**(keys or {}), **variant.keys})
    begin = start_s(name, sim.duration_s)
    sim.start_at(begin)
    forces: list[Float] = []
    fields: dict[str, dict[str, list[Float]]] = {
        one: {"displacement": [], "velocity": [], "ARP": [], "position": []} for one in sim.skins
    }
    for _ in range(steps):
        pushes = []
        for _ in range(variant.substeps):
            sim.step()
            pushes.append(sim.forces)
        forces.append(np.mean(pushes, axis=0))
        for one, rows in fields.items():
            skin = sim.skin(one)
            for what, row in zip(rows, (skin.displacement, skin.velocity, skin.arp, skin.position), strict=True):
                rows[what].append(np.array(row, dtype=float))
    arrays = {one: {what: np.array(row) for what, row in rows.items()} for one, rows in fields.items()}
    if variant.worlds is None:
        return [_in_own_terms(variant, sim, sim.runtime, np.array(forces), arrays)]
    return [
        _in_own_terms(
            variant, sim, sim.runtimes[world], np.array(forces)[:, world],
            {one: {what: row[:, world] for what, row in rows.items()} for one, rows in arrays.items()},
        )
        for world in range(variant.worlds)
    ]  # fmt: skip


def _in_own_terms(
    variant: Variant, sim: Simulation, runtime: SceneRuntime, forces: Float, fields: Mapping[str, Mapping[str, Float]]
) -> Seen:
    """Return forces (t, bodies, 3) and fields (t, ...) of one world, in the scene's own frame."""
    mirror, back = variant.mirror, variant.turn.inv()
    skins = {}
    for one, rows in fields.items():
        found = dict(rows)
        for what in ("displacement", "velocity"):
            found[what] = found[what] * mirror / variant.factor
        found["ARP"] = found["ARP"] / variant.factor
        places = found["position"] - variant.shift
        found["position"] = back.apply(places.reshape(-1, 3)).reshape(places.shape) * mirror
        skins[one] = found
    pushed = forces / variant.factor
    pushed = back.apply(pushed.reshape(-1, 3)).reshape(pushed.shape) * mirror
    rest = {one: sim.skin(one).rest_position * mirror for one in sim.skins}
    model = runtime.model
    accuracy = [skin.spec.config.accuracy for skin in model.skins]
    stated = [getattr(lazy.value, "error", None) or own for lazy, own in zip(model.begin, accuracy, strict=True)]
    bodies = {one: pushed[:, k] for k, one in enumerate(sim.bodies)}
    return Seen(bodies, skins, rest, min(accuracy), min(stated))


def changes(found: Seen, truth: Seen) -> dict[str, float]:
    """Return the largest relative change of each field over skins (ARP, displacement, velocity) and bodies (force).

    Nodes are compared one by one, whatever their order. `mesh` is the share of nodes at other positions, which are not
    compared; changes of positions are in metres.
    """
    result = dict.fromkeys(("mesh", "position", "ARP", "force", "displacement", "velocity"), 0.0)
    for one, fields in truth.skins.items():
        away, order = cKDTree(found.rest[one]).query(truth.rest[one])
        same = away < 1e-9
        result["mesh"] = max(result["mesh"], 1.0 - float(same.mean()))
        for what, rows in fields.items():
            gap, rows = (found.skins[one][what][:, order] - rows)[:, same], rows[:, same]
            size = float(np.abs(gap).max(initial=0.0)) if what == "position" else relative(gap, rows)
            result[what] = max(result[what], size)
    largest = max(float(np.linalg.norm(rows)) for rows in truth.forces.values())
    for body, rows in truth.forces.items():
        gap = found.forces[body] - rows
        result["force"] = max(result["force"], relative(gap, largest))
    return result


def relative(gap: Float, rows: Float | float) -> float:
    size = float(np.linalg.norm(rows))
    return float(np.linalg.norm(gap)) / size if size > 0.0 else float(np.linalg.norm(gap) > 0.0)


# -- what is allowed -------------------------------------------------------------------------------------------------


LIMITS = {"ARP": 1e-5, "force": 1e-5, "position": 1e-7}
"""Limits, relative, for positions in metres: rounding of single precision."""
PUSHED = {"ARP": 1e-4, "force": 1e-4, "position": 1e-5}
"""Larger limits with doubled p0, because the sound moves the bodies."""
SHARE = 0.1
"""Largest change by an equivalent form, as a share of the error estimate of the displacement."""
BY_AXIS = {("follow_fingertip", "turned and shifted")}
"""Motions whose course between their keys depends on the axes of the file."""


def exceeded(name: str, variant: str, row: Mapping[str, float], truth: Seen) -> str:
    """Return the limits that a variant's changes exceed, in words; empty for none.

    If nodes have other positions, the mesh affects the displacement; its error is bounded by the accuracy.
    """
    limits = PUSHED if variant == "p0 x 2" else LIMITS
    limits = limits | {"displacement": SHARE * (truth.accuracy if row["mesh"] else truth.stated), "mesh": 0.05}
    if variant == "step / 2" or (name, variant) in BY_AXIS:
        limits = dict.fromkeys(("ARP", "force", "displacement"), truth.accuracy) | {"mesh": 0.0, "position": 5e-4}
    over = [what for what, limit in limits.items() if row[what] > limit]
    return ", ".join(f"{what} {row[what]:.2g} > {limits[what]:.2g}" for what in over)
