"""Build a joint tree from a flat list of joints, as in WebXR and OpenXR, by joint names or by the skin."""

import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from palmfield.hand.rigged import Joints, SkinRig
from palmfield.types import Float, Int

DIGIT_WORDS = {
    "thumb": "thumb", "index": "index", "pointer": "index", "fore": "index", "middle": "middle", "ring": "ring",
    "little": "little", "pinky": "little", "pinkie": "little", "small": "little",
}  # fmt: skip
RANK_WORDS = {
    "metacarpal": 0, "meta": 0, "proximal": 1, "intermediate": 2, "middle": 2, "medial": 2, "distal": 3,
    "tip": 1000, "end": 1000, "nub": 1000,
}  # fmt: skip
HUB_WORDS = ("wrist", "hand", "palm")
"""Names of the parent of the fingers, in order of preference."""
SIDE_WORDS = {"left": "left", "l": "left", "right": "right", "r": "right"}
MOST_SIBLINGS = 6
"""Largest number of joints with one parent in the tree of a hand: five digits and a palm at the wrist."""
SKIN_POINTS, WRIST_SHARE = 8, 0.05


def words(name: str) -> list[str]:
    """Split the name of a joint into words and numbers in lower case: "RightHandIndex1" gives right, hand, index, 1."""
    separated = re.sub(r"([a-z])([A-Z])|([A-Z])([A-Z][a-z])", r"\1\3 \2\4", name)
    return re.findall(r"[a-z]+|\d+", separated.lower())


def named_side(names: tuple[str, ...]) -> str:
    """Return "left" or "right" if most joint names contain it (or l, r) and none the other side, else "unknown"."""
    sides = [{SIDE_WORDS[word] for word in words(name) if word in SIDE_WORDS} for name in names]
    for side, other in (("left", "right"), ("right", "left")):
        if 2 * sum(side in each for each in sides) > len(names) and not any(other in each for each in sides):
            return side
    return "unknown"


def joined(rig: SkinRig, vertices: Float, way: Float) -> tuple[SkinRig, Int, str]:
    """Return the rig with its joints in a tree, the joints with a new parent, and the method: "names", "skin" or "".

    Names are used if they contain digit and rank in the words of WebXR, OpenXR and most modelling programs. Otherwise
    each joint is attached to its neighbour in the skin towards the wrist. A connected tree is not changed.

    vertices: skin, shape (n, 3), in the unit of the joints; way: distances along the skin from the wrist, shape (n,)
    """
    joints = rig.joints
    chains = _chains(joints.names)
    broken = any(not _related(joints.parents, a, b) for chain in chains for a, b in pairwise(chain))
    if broken and (parents := _by_name(joints, chains)) is not None:
        how = "names"
    elif broken or _crowded(joints.parents):
        parents, how = _by_skin(rig, vertices, way), "skin"
    else:
        return rig, np.zeros(0, dtype=np.int32), ""
    changed = np.flatnonzero(parents != joints.parents).astype(np.int32)
    return replace(rig, joints=replace(joints, parents=parents)), changed, how


def _rank(name: str) -> tuple[str, int] | None:
    """Return the digit of a joint and its rank from the metacarpal on; None if the name lacks one of them."""
    parts = words(name)
    at = next((i for i, word in enumerate(parts) if word in DIGIT_WORDS), None)
    if at is None:
        return None
    rest = parts[at + 1 :] + parts[:at]
    rank = next((RANK_WORDS[word] for word in rest if word in RANK_WORDS), None)
    if rank is None:
        rank = next((1 + int(word) for word in rest if word.isdigit()), None)
    return None if rank is None else (DIGIT_WORDS[parts[at]], rank)


def _chains(names: tuple[str, ...]) -> list[list[int]]:
    """Return the joints of each digit from the wrist on, without digits in which two joints have the same rank."""
    ranked: dict[str, list[tuple[int, int]]] = {}
    for joint, name in enumerate(names):
        if (rank := _rank(name)) is not None:
            ranked.setdefault(rank[0], []).append((rank[1], joint))
    return [[joint for _, joint in sorted(digit)] for digit in ranked.values() if len(dict(digit)) == len(digit)]


def _related(parents: Int, a: int, b: int) -> bool:
    """Return whether one of two joints is an ancestor of the other."""
    return a in ancestors(parents, b) or b in ancestors(parents, a)


def ancestors(parents: Int, joint: int) -> list[int]:
    """Return the ancestors of a joint, the nearest first."""
    above: list[int] = []
    while parents[joint] >= 0 and parents[joint] not in above:
        joint = int(parents[joint])
        above.append(joint)
    return above


def _by_name(joints: Joints, chains: list[list[int]]) -> Int | None:
    """Return parents that make each digit a chain from the wrist; None without a wrist or with inconsistent ranks."""
    in_digit = {joint for chain in chains for joint in chain}
    others = [joint for joint in range(len(joints.names)) if joint not in in_digit]
    hubs = [joint for word in HUB_WORDS for joint in others if word in words(joints.names[joint])]
    if not hubs:
        return None
    hub, places = hubs[0], joints.rest[:, :3, 3]
    parents = joints.parents.copy()
    for joint in hubs[1:]:
        if joint != hub and joint not in ancestors(parents, hub):
            parents[joint] = hub
    for chain in chains:
        numbered = not any(word in RANK_WORDS for word in words(joints.names[chain[0]]))
        first, last = np.linalg.norm(places[[chain[0], chain[-1]]] - places[hub], axis=1)
        if numbered and last < first:
            return None
        parents[chain] = [hub, *chain[:-1]]
    return parents


def _crowded(parents: Int) -> bool:
    """Return whether more joints than MOST_SIBLINGS have the same parent, or none."""
    ends = np.setdiff1d(np.arange(len(parents)), parents)
    return bool(len(ends)) and int(np.unique(parents[ends], return_counts=True)[1].max()) > MOST_SIBLINGS


def _by_skin(rig: SkinRig, vertices: Float, way: Float) -> Int:
    """Choose as parent of each joint the joint nearer to the wrist with which it shares most skin.

    Shared skin is weighted by the squared slope of the distance from the wrist between the centres of both joints'
    skins: this distance rises along a digit, also if it is bent, but hardly from one digit to the next. A joint without
    skin is attached to the joint of the skin around it. The root is the joint at the wrist.
    """
    weights = rig.weights.toarray()
    total = weights.sum(axis=0)
    bare = total < 1e-6 * len(weights)
    root = int(np.argmax(weights[way <= WRIST_SHARE * way.max()].sum(axis=0)))
    share = weights / np.where(bare, 1.0, total)
    middle, height = share.T @ vertices, share.T @ way
    height[root] = 0.0
    gap = np.linalg.norm(middle[:, None] - middle, axis=2)
    slope = np.clip((height[:, None] - height) / np.where(gap > 0.0, gap, np.inf), 0.0, 1.0)
    shared = np.stack([np.minimum(weights, weights[:, [j]]).sum(axis=0) for j in range(len(middle))])
    links = np.where(bare[:, None] | bare, 0.0, shared * slope**2)
    parents = np.where(links.max(axis=1) > 0.0, np.argmax(links, axis=1), root)
    about = cKDTree(vertices).query(rig.joints.rest[bare, :3, 3], k=min(SKIN_POINTS, len(vertices)))[1]
    parents[bare] = np.argmax(weights[about].sum(axis=1), axis=1)
    parents[root] = -1
    return parents.astype(np.int32)
