"""Make hand meshes like those of other programs, all our own work, and the report card of each.

python scripts/verification/foreign_hands.py FOLDER

It writes the ten hands of HANDS and the three objects of NO_HANDS to a folder, each with a card (.txt) and a picture.
The exit code is 1 if a verdict is not the expected one. docs/report_cards.md and tests/hand use these meshes.
"""

import argparse
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pygltflib as g
import trimesh
from scipy.spatial.transform import Rotation

from palmfield.errors import SceneError
from palmfield.hand.articulated import bone_poses
from palmfield.hand.holes import boundary_loops
from palmfield.hand.preset import DIGITS, HandPreset, load_preset
from palmfield.hand.reportcard import ReportCard, as_text, report_card
from palmfield.hand.skinning import SkinnedHand
from palmfield.hand.triangles import directed_edges, unique_edges
from palmfield.outputs.report_card_picture import draw_card
from palmfield.types import Float, Int

WEBXR = {"proximal": "phalanx-proximal", "middle": "phalanx-intermediate", "distal": "phalanx-distal", "tip": "tip"}
ARM_m, ARM_STEPS = 0.25, 40
Z_UP = Rotation.from_euler("x", 90.0, degrees=True)


class Foreign(NamedTuple):
    """A mesh that imitates a property of other programs.

    file: its name; habit: the property in words; verdict: expected verdict of its card, "not examined" for a mesh that
        is refused earlier; make: function that writes it
    """

    file: str
    habit: str
    verdict: str
    make: Callable[[Path], None]


def plain_preset() -> HandPreset:
    """Return a hand whose thumb begins late and is near the index finger, as in many hand-made models."""
    preset = load_preset("open_women_p50")
    thumb = preset.digits["thumb"]
    near = thumb.model_copy(update={"base_y_m": thumb.base_y_m + 0.015, "spread_deg": -30.0, "palmar_deg": 15.0})
    return preset.model_copy(update={"name": "plain", "digits": dict(preset.digits) | {"thumb": near}})


@cache
def skinned() -> SkinnedHand:
    return SkinnedHand(plain_preset(), 0.004)


def plain_hand() -> tuple[Float, Int]:
    """Return a right hand [m] with fingers along y and its palm facing -z."""
    surface = skinned().surface
    return surface.vertices, surface.faces


def crossed_hand() -> tuple[Float, Int]:
    """Return a hand with bent fingers in which middle and ring finger intersect."""
    hand = SkinnedHand(load_preset("open_men_p50"), 0.004)
    bent = {"mcp_flexion": 20.0, "pip_flexion": 30.0, "dip_flexion": 20.0}
    angles = {f"{digit}_{joint}": angle for digit in DIGITS[1:] for joint, angle in bent.items()}
    angles |= {"index_mcp_abduction": -20.0, "middle_mcp_abduction": 20.0}
    surface = hand.posed_surface(*bone_poses(hand.hand, angles))
    return surface.vertices, surface.faces


def cut_by_quads(vertices: Float, faces: Int, teeth: int = 6, height_m: float = 0.014) -> Int:
    """Return the faces beyond a zigzag line around the wrist."""
    middle = vertices[faces].mean(axis=1)
    around = np.arctan2(middle[:, 2] - 0.015, middle[:, 0])
    return faces[middle[:, 1] > vertices[:, 1].min() + 0.03 + 0.5 * height_m * np.sign(np.sin(teeth * around))]


def as_quads(vertices: Float, faces: Int) -> list[list[int]]:
    """Return polygons of four corners where two triangles form a good one, and the remaining triangles."""
    edges = {tuple(e): [] for e in unique_edges(faces)[0].tolist()}
    for number, face in enumerate(faces.tolist()):
        for i in range(3):
            edges[tuple(sorted((face[i], face[(i + 1) % 3])))].append(number)
    longest_first = sorted(edges, key=lambda e: -float(np.linalg.norm(vertices[e[0]] - vertices[e[1]])))
    free, polygons = set(range(len(faces))), []
    for edge in longest_first:
        pair = edges[edge]
        if len(pair) == 2 and set(pair) <= free:
            free -= set(pair)
            a, b, c = next(np.roll(faces[pair[0]], -i).tolist() for i in range(3) if faces[pair[0]][i] not in edge)
            far = next(corner for corner in faces[pair[1]].tolist() if corner not in edge)
            # Cut from its first corner, as readers do, it gives the two triangles again.
            polygons.append([b, far, c, a])
    return polygons + faces[sorted(free)].tolist()


def write_obj(path: Path, vertices: Float, polygons: list[list[int]]) -> None:
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in vertices]
    lines += ["f " + " ".join(str(corner + 1) for corner in polygon) for polygon in polygons]
    path.write_text("\n".join(lines) + "\n")


def write(path: Path, vertices: Float, faces: Int) -> None:
    trimesh.Trimesh(vertices, faces, process=False).export(path)


def write_rig(
    path: Path, vertices: Float, faces: Int, weights: Float, names: list[str], places: Float, parents: list[int]
) -> None:
    """Write a glTF with a skin: joints parallel to the scene's axes at `places`, each below its parent (-1: scene)."""
    blob, views, accessors = b"", [], []

    def add(values: Float | Int, dtype: str, kind: str, component: int) -> int:
        nonlocal blob
        raw = np.asarray(values, dtype=dtype).tobytes()
        views.append(g.BufferView(buffer=0, byteOffset=len(blob), byteLength=len(raw)))
        accessors.append(
            g.Accessor(bufferView=len(views) - 1, componentType=component, count=len(values), type=kind, max=None)
        )
        blob += raw + b"\0" * (-len(raw) % 4)
        return len(accessors) - 1

    order = np.argsort(-weights, axis=1)[:, :4]
    shares = np.take_along_axis(weights, order, axis=1)
    inverse = np.tile(np.eye(4), (len(names), 1, 1))
    inverse[:, :3, 3] = -places
    attributes = g.Attributes(
        POSITION=add(vertices, "<f4", "VEC3", g.FLOAT),
        JOINTS_0=add(order, "<u1", "VEC4", g.UNSIGNED_BYTE),
        WEIGHTS_0=add(shares / shares.sum(axis=1, keepdims=True), "<f4", "VEC4", g.FLOAT),
    )
    corners = add(faces.reshape(-1, 1), "<u4", "SCALAR", g.UNSIGNED_INT)
    bind = add(inverse.transpose(0, 2, 1).reshape(-1, 16), "<f4", "MAT4", g.FLOAT)
    local = [place - (places[parent] if parent >= 0 else 0.0) for place, parent in zip(places, parents, strict=True)]
    nodes = [
        g.Node(
            name=name, translation=np.asarray(at).tolist(), children=[i for i, p in enumerate(parents) if p == joint]
        )
        for joint, (name, at) in enumerate(zip(names, local, strict=True))
    ]
    nodes.append(g.Node(name="skin", mesh=0, skin=0))
    scene = g.GLTF2(
        scene=0,
        scenes=[g.Scene(nodes=[*(i for i, p in enumerate(parents) if p < 0), len(names)])],
        nodes=nodes,
        meshes=[g.Mesh(primitives=[g.Primitive(attributes=attributes, indices=corners, mode=4)])],
        skins=[g.Skin(joints=list(range(len(names))), inverseBindMatrices=bind)],
        accessors=accessors,
        bufferViews=views,
        buffers=[g.Buffer(byteLength=len(blob))],
    )
    scene.set_binary_blob(blob)
    scene.save(str(path))


def webxr_joints() -> tuple[list[str], Float, Float, list[int]]:
    """Return the 25 joints of WebXR: names, positions [m], skin weights on the plain hand, and expected parents."""
    hand = skinned()
    bones = [bone.name for bone in hand.bones]
    origins, marks = np.array([bone.origin for bone in hand.bones]), hand.hand.skeleton.landmarks
    names, places, parents = ["wrist"], [origins[bones.index("hand")]], [-1]
    weights = [hand.weights[:, [bones.index("forearm"), bones.index("hand")]].sum(axis=1)]
    none = np.zeros(len(hand.weights))
    for digit in DIGITS:
        webxr = {"thumb": "thumb", "little": "pinky-finger"}.get(digit, f"{digit}-finger")
        own = [name for name in bones if name.startswith(digit)]
        chain = [
            (f"{webxr}-{WEBXR[b.split('_')[1]]}" if "metacarpal" not in b else f"{webxr}-metacarpal", b) for b in own
        ]
        if digit != "thumb":
            names.append(f"{webxr}-metacarpal")
            places.append(places[0] + 0.2 * (origins[bones.index(own[0])] - places[0]))
            weights.append(none)
            parents.append(0)
        for number, (name, bone) in enumerate(chain):
            names.append(name)
            places.append(origins[bones.index(bone)])
            weights.append(hand.weights[:, bones.index(bone)])
            parents.append(0 if digit == "thumb" and number == 0 else len(names) - 2)
        names.append(f"{webxr}-tip")
        places.append(marks[f"{digit}_tip"])
        weights.append(none)
        parents.append(len(names) - 2)
    return names, np.array(places), np.stack(weights, axis=1), parents


def sibling_rig(path: Path, renamed: Callable[[int, str], str]) -> None:
    names, places, weights, _ = webxr_joints()
    given = [renamed(number, name) for number, name in enumerate(names)]
    write_rig(path, *plain_hand(), weights, given, places, [-1] * len(names))


def webxr_name(_: int, name: str) -> str:
    return name


def openxr_name(_: int, name: str) -> str:
    """Return the OpenXR name of a WebXR joint: XR_HAND_JOINT_INDEX_PROXIMAL_EXT."""
    words = name.replace("-finger", "").replace("phalanx-", "").replace("pinky", "little")
    return f"XR_HAND_JOINT_{words.upper().replace('-', '_')}_EXT"


def mirrored_rig(path: Path) -> None:
    """Write a left hand that is a right one with negative scale; its joints keep their names."""
    names, places, weights, parents = webxr_joints()
    vertices, faces = plain_hand()
    flip = np.array([-1.0, 1.0, 1.0])
    given = [f"{name.replace('-', '_')}_r" for name in names]
    write_rig(path, vertices * flip, faces[:, ::-1], weights, given, places * flip, parents)


def quads_cut_at_the_wrist(path: Path) -> None:
    vertices, faces = plain_hand()
    write_obj(path, 100.0 * vertices, as_quads(vertices, cut_by_quads(vertices, faces)))


def left_in_decimetres(path: Path) -> None:
    vertices, faces = plain_hand()
    write(path, 10.0 * vertices * [-1.0, 1.0, 1.0], faces[:, ::-1])


def z_up_in_inches(path: Path) -> None:
    vertices, faces = plain_hand()
    write(path, Z_UP.apply(vertices) / 0.0254, faces)


def inner_shell(path: Path) -> None:
    """Write a second, inward skin 1.5 mm below the first, as a modifier for solid walls produces."""
    vertices, faces = plain_hand()
    within = vertices - 0.0015 * skinned().surface.normals
    write_obj(
        path, 1e3 * np.concatenate([vertices, within]), np.concatenate([faces, faces[:, ::-1] + len(vertices)]).tolist()
    )


def crossed(path: Path) -> None:
    vertices, faces = crossed_hand()
    write(path, 1e3 * vertices, faces)


def forearm(path: Path) -> None:
    """Write a hand with its forearm in millimetres; the forearm widens towards the elbow and is open there."""
    vertices, faces = plain_hand()
    faces = cut_by_quads(vertices, faces, height_m=0.0)
    loop = max(boundary_loops(faces), key=len)
    # The faces of the hand run along its rim in one direction, those of the arm in the other.
    along = {tuple(edge) for edge in directed_edges(faces).tolist()}
    ring = loop if (loop[0], loop[1]) in along else loop[::-1]
    middle, points, corners = vertices[loop].mean(axis=0), [vertices], [faces]
    for step in range(1, ARM_STEPS + 1):
        share = step / ARM_STEPS
        next_points = middle + (vertices[ring] - middle) * [1.0 + 0.6 * share, max(0.0, 1.0 - share), 1.0 + 0.6 * share]
        next_ring = len(vertices) + (step - 1) * len(loop) + np.arange(len(loop))
        before = ring if step == 1 else next_ring - len(loop)
        a, b, c, d = before, np.roll(before, -1), next_ring, np.roll(next_ring, -1)
        points.append(next_points - [0.0, ARM_m * share, 0.0])
        corners += [np.stack([b, a, c], axis=1), np.stack([b, c, d], axis=1)]
    write(path, 1e3 * np.concatenate(points), np.concatenate(corners))


def bottle(path: Path) -> None:
    outline = [[0.0, 0.0], [0.035, 0.0], [0.035, 0.12], [0.012, 0.16], [0.012, 0.2], [0.0, 0.2]]
    trimesh.creation.revolve(1e3 * np.array(outline), sections=64).export(path)


def ring(path: Path) -> None:
    trimesh.creation.torus(70.0, 20.0, major_sections=64, minor_sections=24).export(path)


def fork(path: Path) -> None:
    """Write a handle and four prongs, in one piece made of cubes."""
    solid = np.zeros((28, 62, 8), dtype=bool)
    solid[12:16, 1:30, 2:6] = True
    solid[3:25, 30:36, 2:6] = True
    for start in (3, 9, 15, 21):
        solid[start : start + 4, 36:60, 2:6] = True
    corners, faces = [], []
    for axis in range(3):
        one, other = (np.eye(3)[(axis + k) % 3] for k in (1, 2))
        for side, beyond in ((0, 1), (1, -1)):
            for cell in np.argwhere(solid & ~np.roll(solid, beyond, axis=axis)):
                first = len(corners)
                square = cell + side * np.eye(3)[axis] + np.array([0 * one, one, one + other, other])
                corners += list(square if side else square[::-1])
                faces += [[first, first + 1, first + 2], [first, first + 2, first + 3]]
    trimesh.Trimesh(3.4 * np.array(corners), faces).export(path)


HANDS = [
    Foreign("webxr.glb", "joints without hierarchy, WebXR names", "accepted", lambda p: sibling_rig(p, webxr_name)),
    Foreign("openxr.glb", "joints without hierarchy, OpenXR names", "accepted", lambda p: sibling_rig(p, openxr_name)),
    Foreign(
        "unnamed.glb", "joints without hierarchy, meaningless names", "accepted with doubts",
        lambda p: sibling_rig(p, lambda number, _: f"bone.{number:03d}"),
    ),
    Foreign("mirrored.glb", "mirrored, with the names of the other hand", "accepted with doubts", mirrored_rig),
    Foreign("quads.obj", "cut from a body along its quads, in centimetres", "accepted", quads_cut_at_the_wrist),
    Foreign("decimetres.ply", "a left hand in decimetres", "accepted", left_in_decimetres),
    Foreign("z_up.stl", "Z up, in inches, without shared corners", "accepted", z_up_in_inches),
    Foreign("inner_shell.obj", "a hidden inner shell", "accepted", inner_shell),
    Foreign("forearm.ply", "with its forearm, open at the elbow", "accepted", forearm),
    Foreign("crossed.ply", "bent fingers that cross", "refused", crossed),
]  # fmt: skip
NO_HANDS = [
    Foreign("bottle.ply", "a bottle", "not examined", bottle),
    Foreign("ring.ply", "a torus", "not examined", ring),
    Foreign("fork.ply", "a fork", "not examined", fork),
]


def card_of(mesh: Path, unit: str = "auto") -> ReportCard | SceneError:
    """Return the report card of a mesh, or the earlier error that refused it."""
    try:
        return report_card(mesh, unit)
    except SceneError as error:
        return error


def verdict_of(card: ReportCard | SceneError) -> str:
    return "not examined" if isinstance(card, SceneError) else str(card.facts["verdict"])


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("folder", type=Path, help="where meshes, cards and pictures go")
    folder = options.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    wrong = 0
    for foreign in HANDS + NO_HANDS:
        path = folder / foreign.file
        foreign.make(path)
        card = card_of(path)
        text = str(card) if isinstance(card, SceneError) else as_text(card.facts)
        path.with_suffix(".txt").write_text(text)
        if not isinstance(card, SceneError):
            draw_card(card, path.with_suffix(".png"))
        verdict = verdict_of(card)
        wrong += verdict != foreign.verdict
        print(
            f"{foreign.file:<18}{foreign.habit:<48}{verdict}"
            + f" (not {foreign.verdict})" * (verdict != foreign.verdict)
        )
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
