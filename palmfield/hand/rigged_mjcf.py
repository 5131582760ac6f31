"""Write a user's rigged mesh as an MJCF tree of bodies on ball joints, which moves the skin of shape `rigged`."""

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from functools import partial

import mujoco
import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from palmfield.errors import SceneError
from palmfield.hand.chirality import Chirality, chirality, fingers_direction
from palmfield.hand.joint_tree import ancestors, named_side
from palmfield.hand.mjcf_text import (
    DIGITS_IN_FILE,
    SKIN_RGBA,
    VIEW_GROUP,
    ARMATURE_kg_m2,
    DENSITY_kg_m3,
    HEIGHT_m,
    SkinBone,
    add_skin,
    file_text,
    numbers_text,
)
from palmfield.hand.rigged import RiggedMesh
from palmfield.hand.triangles import volume
from palmfield.types import Float, Int

SWING_Hz = 25.0
"""Natural frequency of each joint alone with all bodies beyond it; damping is critical. The force of an array on a
fingertip (10 mN) then moves it by less than 0.5 mm, including the weld."""
WELD_TIME_s = 0.02
"""Time constant of the weld; with half of it, a wrist bone lighter than the hand oscillates in steps of 2 ms."""
AXIS_SAMPLES, LEAST_RADIUS_m = 9, 1e-3
_text = partial(numbers_text, digits=DIGITS_IN_FILE)
RESERVED = ("world", "hand_target")


@dataclass(frozen=True)
class _Capsule:
    """A capsule. start, end: ends of the axis [m], shape (3,)"""

    start: Float
    end: Float
    radius: float

    @property
    def volume(self) -> float:
        length = float(np.linalg.norm(self.end - self.start))
        return np.pi * self.radius**2 * (length + 4.0 / 3.0 * self.radius)


def rigged_mjcf(mesh: RiggedMesh, name: str) -> str:
    """Return MJCF text of a rigged mesh, for `<include file=.../>` or to open in any MuJoCo.

    Each joint has a body of its name, at its position and parallel to the axes of the file; further joints without a
    parent are attached to the first one. The first body is free, and a soft weld attaches it to the mocap body
    `hand_target`, as in the articulated hands of palmfield. A joint is a ball joint of its name if it
    and one of its ancestors carry skin; its spring pulls to the pose of the file with natural frequency SWING_Hz and
    critical damping. Other joints are rigid, because their bodies have no mass. Capsules along the bones go to the next
    joints that carry skin; their radius is the median distance of the skin from the bone. Their total mass is the
    volume of the mesh times 1100 kg/m3. They collide with other objects and each other, except pairs that touch in the
    pose of the file. Gravity is compensated. Viewers show the mesh as skin; capsules and sites are in group 3.

    Sites: JOINT_tip is the farthest skin of each last joint. If `palmfield.hand.chirality` determines the side,
    JOINT_pad is the palmar skin of each joint, and the first joint and hand_target are rotated so that palm and fingers
    point along -z and y; otherwise they keep the axes of the file. The lowest skin is at a height of 0.2 m, and the
    centre of the mesh is over the origin.

    Raises SceneError for two joints of one name, and for names reserved by MuJoCo or this file.
    """
    names = mesh.joints.names
    for joint in names:
        if names.count(joint) > 1 or joint in RESERVED:
            why = "is a reserved name in this file" if joint in RESERVED else f"names {names.count(joint)} joints"
            raise SceneError(f"rigged mesh: '{joint}' {why}; rename the joint and export the mesh again")
    places = mesh.joints.rest[:, :3, 3]
    parents = _one_root(mesh.joints.parents)
    owner = mesh.indices[np.arange(len(mesh.indices)), np.argmax(mesh.weights, axis=1)]
    carries = np.bincount(owner, minlength=len(names)) > 0
    vertices = mesh.surface.vertices
    whole = cKDTree(vertices)
    side = chirality(vertices, mesh.surface.faces, named_side(names))
    turn = _turn(mesh, side)
    capsules = {
        j: _capsules(vertices[owner == j], whole, places[j], places[_next_carrying(j, parents, carries)])
        for j in np.flatnonzero(carries).tolist()
    }
    filled = sum(capsule.volume for parts in capsules.values() for capsule in parts)
    density = f"{DENSITY_kg_m3 * (volume(vertices, mesh.surface.faces) / filled):.9g}"

    spin = {"quat": _text(Rotation.from_matrix(turn).as_quat(scalar_first=True))}
    root_joint = int(np.flatnonzero(parents < 0)[0])
    placed = vertices @ turn.T
    middle = 0.5 * (placed.min(axis=0) + placed.max(axis=0))
    start = turn @ places[root_joint] - [middle[0], middle[1], placed[:, 2].min() - HEIGHT_m]

    root = ET.Element("mujoco", model=name)
    world = ET.SubElement(root, "worldbody")
    ET.SubElement(world, "body", {"name": "hand_target", "mocap": "true", "pos": _text(start)} | spin)
    bodies: dict[int, ET.Element] = {}
    for j in sorted(range(len(parents)), key=lambda joint: len(ancestors(parents, joint))):
        above = world if j == root_joint else bodies[parents[j]]
        at = start if j == root_joint else places[j] - places[parents[j]]
        bodies[j] = ET.SubElement(above, "body", name=names[j], pos=_text(at), gravcomp="1")
        if j == root_joint:
            bodies[j].attrib |= spin
            ET.SubElement(bodies[j], "freejoint", name=names[j])
        if j in capsules:
            if capsules.keys() & ancestors(parents, j):
                ET.SubElement(bodies[j], "joint", name=names[j], type="ball", armature=f"{ARMATURE_kg_m2:g}")
            own = vertices[owner == j]
            last = not _next_carrying(j, parents, carries)
            _add_geoms(bodies[j], places[j], capsules[j], density)
            for site, point in _sites(own, places[j], capsules[j], side, last).items():
                at, name_of_site = _text(point - places[j]), f"{names[j]}_{site}"
                ET.SubElement(bodies[j], "site", name=name_of_site, pos=at, size="0.002", group=VIEW_GROUP)
    equality = ET.SubElement(root, "equality")
    first, solref = names[root_joint], f"{WELD_TIME_s:g} 1"
    ET.SubElement(equality, "weld", name=first, body1="hand_target", body2=first, solref=solref)
    _add_springs_and_excludes(root)
    shares = np.zeros((len(vertices), len(names)))
    np.add.at(shares, (np.arange(len(vertices))[:, None], mesh.indices), mesh.weights)
    add_skin(root, name, mesh.surface, [SkinBone(*bone) for bone in zip(names, places, shares.T, strict=True)])
    axes = "those of the file" if side.side == "unknown" else "fingers to y, palm to -z"
    note = f"Written by `palmfield hand` of a rigged mesh. Side: {side.side}; axes in the world: {axes}."
    return file_text(root, note)


def _one_root(parents: Int) -> Int:
    """Return parents in which all further roots are attached to the first root."""
    roots = np.flatnonzero(parents < 0)
    joined = parents.copy()
    joined[roots[1:]] = roots[0]
    return joined


def _next_carrying(joint: int, parents: Int, carries: np.ndarray) -> list[int]:
    """Return the nearest descendants of a joint that carry skin."""
    carrying: list[int] = []
    for child in np.flatnonzero(parents == joint):
        carrying += [int(child)] if carries[child] else _next_carrying(int(child), parents, carries)
    return carrying


def _turn(mesh: RiggedMesh, side: Chirality) -> Float:
    """Return the rotation from the axes of the file to the hand frame; the identity if the side is unknown."""
    if side.side == "unknown":
        return np.eye(3)
    z = -side.palm
    fingers = fingers_direction(mesh.surface.vertices, mesh.surface.faces)
    y = fingers - (fingers @ z) * z
    y /= np.linalg.norm(y)
    return np.array([np.cross(y, z), y, z])


def _capsules(skin: Float, whole: cKDTree, origin: Float, beyond: Float) -> list[_Capsule]:
    """Return a capsule from a joint to each of the next joints, within the skin of the joint [m], shape (n, 3).

    whole: vertices of all skin; beyond: next joints, shape (k, 3); if all are within a millimetre, the axis ends at the
    farthest skin
    """
    ends = beyond[np.linalg.norm(beyond - origin, axis=1) > 1e-3]
    last = not len(ends)
    if last:
        ends = skin[[np.argmax(np.linalg.norm(skin - origin, axis=1))]]
    lengths = np.linalg.norm(ends - origin, axis=1)
    axes = (ends - origin) / lengths[:, None]
    along = (skin - origin) @ axes.T
    off = (skin - origin)[:, None] - np.clip(along, 0.0, lengths)[..., None] * axes
    nearest = np.argmin(np.linalg.norm(off, axis=2), axis=1)
    capsules = []
    for k in np.unique(nearest):
        own = along[nearest == k, k]
        # The axis covers the skin between the joints, and skin beyond them that is farther than the radius
        low, high = np.clip([own.min(), own.max()], 0.0, lengths[k])
        steps = np.linspace(low, high, AXIS_SAMPLES)[:, None] * axes[k]
        radius = max(float(np.median(whole.query(origin + steps)[0])), LEAST_RADIUS_m)
        low = min(low, own.min() + radius)
        high = own.max() - radius if last else max(high, own.max() - radius)
        if high - low < 1e-3:
            low, high = 0.5 * (low + high) - 5e-4, 0.5 * (low + high) + 5e-4
        capsules.append(_Capsule(origin + low * axes[k], origin + high * axes[k], radius))
    return capsules


def _add_geoms(body: ET.Element, origin: Float, capsules: list[_Capsule], density: str) -> None:
    for capsule in capsules:
        ends = _text(np.concatenate([capsule.start - origin, capsule.end - origin]))
        size = _text(np.array([capsule.radius]))
        geom = {"type": "capsule", "fromto": ends, "size": size, "density": density, "rgba": SKIN_RGBA}
        geom["group"] = VIEW_GROUP
        ET.SubElement(body, "geom", geom)


def _sites(skin: Float, origin: Float, capsules: list[_Capsule], side: Chirality, last: bool) -> dict[str, Float]:
    """Return the sites on the skin of a joint [m], shape (n, 3), by name."""
    sites = {}
    middle = np.mean([0.5 * (capsule.start + capsule.end) for capsule in capsules], axis=0)
    if last:
        sites["tip"] = skin[np.argmax(np.linalg.norm(skin - origin, axis=1))]
        middle = 0.5 * (origin + sites["tip"])
    if side.side != "unknown":
        away = skin - middle
        out = away @ side.palm
        off_axis = np.linalg.norm(away - out[:, None] * side.palm, axis=1)
        sites["pad"] = skin[np.argmin(np.where(out > 0.0, off_axis, np.inf))]
    return sites


def _add_springs_and_excludes(root: ET.Element) -> None:
    """Set stiffness and damping of all ball joints from the inertia beyond each; exclude pairs that touch at rest."""
    model = mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    below = _subtrees(model.body_parentid)
    rate = 2.0 * np.pi * SWING_Hz
    for joint in root.iterfind(".//joint"):
        body = model.body(joint.get("name", "")).id
        inertia = _largest_inertia(model, data, np.flatnonzero(below[body]).tolist(), data.xpos[body]) + ARMATURE_kg_m2
        joint.set("stiffness", f"{inertia * rate**2:.9g}")
        joint.set("damping", f"{2.0 * inertia * rate:.9g}")
    pairs = {tuple(sorted(int(model.geom_bodyid[geom]) for geom in contact.geom)) for contact in data.contact}
    contact = ET.SubElement(root, "contact")
    for a, b in sorted(pairs):
        ET.SubElement(contact, "exclude", body1=model.body(a).name, body2=model.body(b).name)


def _subtrees(parents: Int) -> np.ndarray:
    """Return whether body j is body i or one of its descendants, shape (bodies, bodies)."""
    below = np.eye(len(parents), dtype=bool)
    for body in range(len(parents) - 1, 0, -1):
        below[parents[body]] |= below[body]
    return below


def _largest_inertia(model: mujoco.MjModel, data: mujoco.MjData, bodies: list[int], about: Float) -> float:
    """Return the largest moment of inertia of a group of bodies about an axis through a point [kg m^2]."""
    total = np.zeros((3, 3))
    for body in bodies:
        turn = data.ximat[body].reshape(3, 3)
        arm = data.xipos[body] - about
        total += turn @ np.diag(model.body_inertia[body]) @ turn.T
        total += model.body_mass[body] * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return float(np.linalg.eigvalsh(total)[-1])
