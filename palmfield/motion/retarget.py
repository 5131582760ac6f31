"""Transfer the motion of a tracked hand to an articulated hand of another size."""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from palmfield.errors import SceneError
from palmfield.hand.articulated import ArticulatedHand, poses_at
from palmfield.hand.preset import DIGITS
from palmfield.motion.joints import JOINTS, KNUCKLES, PALM_JOINTS, POSITION_VALID, HandJoints, hand_joints, joints_at
from palmfield.motion.keyframes import Curve
from palmfield.motion.pose import HandPose
from palmfield.motion.tracking import Stream, checked_stream, ordered
from palmfield.types import Float

Bool = NDArray[np.bool_]

RIGID = PALM_JOINTS + KNUCKLES
"""Joints that do not move relative to each other."""
CHAINS = tuple(
    tuple(JOINTS.index(f"{digit}_{place}") for place in places)
    for digit in DIGITS
    for places in [
        ("metacarpal", "proximal", "distal", "tip")
        if digit == "thumb"
        else ("proximal", "intermediate", "distal", "tip")
    ]
)
"""Joints of each digit from its root, which is fixed in the palm, to its tip."""
PALM_ROUNDS = 20
TO_BEFORE_m_deg = 2e-5
"""Weight of the deviation from the angles of the previous frame: 0.02 mm per degree.

It affects only angles that the tracked joints do not determine.
"""
FEWEST_PALM_JOINTS, LEAST_SPREAD_m = 4, 0.01


@dataclass(frozen=True)
class RetargetReport:
    """Quality of the fit.

    frames: number of fitted frames; skipped: frames whose valid joints do not determine the orientation of the palm
    scale_across, scale_along: size of our palm divided by the size of the tracked palm, across and along
    tip_rms_m, tip_max_m: distance of our fingertips from their targets in the frame of the palm, over valid tips [m];
        targets have the directions of the tracked bones and the lengths of our bones
    palm_rms_m: deviation of the joints of the tracked palm from a rigid palm [m]
    at_limit: fraction of (joint, frame) pairs in which the joint is at an end of its range
    """

    frames: int
    skipped: int
    scale_across: float
    scale_along: float
    tip_rms_m: float
    tip_max_m: float
    palm_rms_m: float
    at_limit: float


class Retargeted:
    """A motion from a tracking stream. report: quality of the fit; span_s: first and last time [s]."""

    def __init__(self, curve: Curve, report: RetargetReport) -> None:
        self._curve = curve
        self.report = report
        self.span_s = curve.span_s

    def __call__(self, time_s: float) -> HandPose:
        """Return the pose at a time [s]."""
        return self._curve(time_s)


def retarget(hand: ArticulatedHand, stream: Stream) -> Retargeted:
    """Return the motion of `hand` that follows a tracked hand of the same side.

    Bone lengths differ between hands, so our joints cannot coincide with all tracked joints. Our wrist is at the
    tracked wrist. Our palm has the orientation of the tracked palm, after the tracked palm is scaled, across and along,
    to the size of ours. The joints and the tip of each digit are fitted to target points, within the ranges of the
    joints. The targets have the directions of the tracked bones and the lengths of our bones. The forearm continues the
    hand, because the joints of OpenXR do not contain the flexion of the wrist. Orientations and radii are not used.
    Packets are sorted and interpolated by `Curve`.
    Raises SceneError for an invalid stream, a hand of the other side, and fewer than two frames to fit.
    """
    packets = ordered(checked_stream(stream, "tracking stream"))
    valid = (packets.flags & POSITION_VALID) != 0
    usable = [n for n in range(len(packets)) if fixes_palm(packets.positions[n], valid[n])]
    if len(usable) < 2:
        raise SceneError(
            f"hand retargeting: {len(usable)} of {len(packets)} packets have {FEWEST_PALM_JOINTS} valid palm "
            "joints that are not on one line; needed: two or more"
        )
    follower = Follower(hand, packets.positions[usable], valid[usable])
    followed = [follower.follow(packets.positions[n], valid[n]) for n in usable]
    tips = np.concatenate([one.tip_misses for one in followed])
    palm_misses = np.concatenate([one.palm_misses for one in followed])
    table = np.array([one.angles_deg for one in followed])
    report = RetargetReport(
        frames=len(usable),
        skipped=len(packets) - len(usable),
        scale_across=float(follower.scales[0]),
        scale_along=float(follower.scales[1]),
        tip_rms_m=float(np.sqrt(np.mean(tips**2))) if len(tips) else 0.0,
        tip_max_m=float(tips.max()) if len(tips) else 0.0,
        palm_rms_m=float(np.sqrt(np.mean(np.sum(palm_misses**2, axis=1)))),
        at_limit=follower.at_limit(table),
    )
    quaternions = np.array([one.quaternion for one in followed])
    places = np.array([one.position for one in followed])
    curve = Curve(follower.names, packets.times_s[usable], places, quaternions, table, rest=False)
    return Retargeted(curve, report)


class Followed(NamedTuple):
    """Fit of a hand to one packet.

    position [m], quaternion (w first): pose of the hand frame
    angles_deg: angles of all joints, shape (joints,)
    tip_misses: residuals of the valid tips [m]
    palm_misses: residuals of the valid palm joints [m], shape (k, 3)
    """

    position: Float
    quaternion: Float
    angles_deg: Float
    tip_misses: Float
    palm_misses: Float


class Follower:
    """Fits a hand to successive packets.

    names: joint names
    scales: size of our palm divided by the size of the tracked palm, across and along
    """

    def __init__(self, hand: ArticulatedHand, positions: Float, valid: Bool) -> None:
        """positions: joints of packets for the shape of the palm [m], shape (n, 26, 3); valid: flags, (n, 26).

        Raises SceneError for a hand of the other side, and if no packet has all joints of the palm.
        """
        ours = hand_joints(hand)
        rigid = np.array(RIGID)
        theirs = _palm_of(positions[:, rigid], valid[:, rigid])
        self._palm, self.scales = _palm_in_our_frame(ours.positions[rigid], theirs)
        self._rigid, self._chains = rigid, np.array(CHAINS)
        self._wrist = ours.positions[JOINTS.index("wrist")]
        self._fit = _Fit(hand, ours)
        self._before = self._fit.rest
        self.names = [joint.name for joint in hand.joints]

    def follow(self, positions: Float, valid: Bool) -> Followed:
        """Return the pose for a packet with joint positions [m], shape (26, 3), and flags, shape (26,).

        The packet must determine the orientation of the palm (`fixes_palm`).
        """
        visible = valid[self._rigid]
        turn, shift = _rigid(self._palm[visible], positions[self._rigid][visible])
        palm_misses = self._palm[visible] @ turn.T + shift - positions[self._rigid][visible]
        # Digits begin at the fitted palm, which has less noise than single knuckles and is defined if one is lost.
        joints, present = positions.copy(), valid.copy()
        joints[self._rigid], present[self._rigid] = self._palm @ turn.T + shift, True
        steps = np.diff(joints[self._chains], axis=1) @ turn
        both = present[self._chains[:, 1:]] & present[self._chains[:, :-1]]
        self._before, tip_misses = self._fit.angles(steps, both, self._before)
        place = joints[JOINTS.index("wrist")] - turn @ self._wrist
        quaternion = Rotation.from_matrix(turn).as_quat(scalar_first=True)
        return Followed(place, quaternion, self._before, tip_misses, palm_misses)

    def at_limit(self, angles: Float) -> float:
        """Return the fraction of the angles, shape (frames, joints), within 0.01 degrees of an end of their range."""
        return self._fit.at_limit(angles)


def fixes_palm(positions: Float, valid: Bool) -> bool:
    """Return whether a packet, shapes (26, 3) [m] and (26,), determines the orientation of the palm."""
    rigid = np.array(RIGID)
    return _fixes_palm(positions[rigid][valid[rigid]])


def _fixes_palm(points: Float) -> bool:
    """Return whether joints of the palm, shape (n, 3) [m], determine its orientation."""
    if len(points) < FEWEST_PALM_JOINTS:
        return False
    return bool(np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[1] > LEAST_SPREAD_m)


def _rigid(start: Float, end: Float) -> tuple[Float, Float]:
    """Fit rotation and shift between two sets of points, by least squares (Kabsch 1976)."""
    middle_start, middle_end = start.mean(axis=0), end.mean(axis=0)
    turn = Rotation.align_vectors(end - middle_end, start - middle_start)[0].as_matrix()
    return turn, middle_end - turn @ middle_start


def _palm_of(positions: Float, valid: Bool) -> Float:
    """Return the mean positions of the tracked palm joints [m], shape (joints, 3), in the frame of one packet."""
    fullest = int(np.argmax(np.count_nonzero(valid, axis=1)))
    shape, present = positions[fullest].copy(), valid[fullest]
    if not present.all():
        absent = JOINTS[RIGID[int(np.argmin(present))]]
        raise SceneError(
            f"hand retargeting: no packet has all palm joints; {absent} is missing; give a packet with all of them"
        )
    for _ in range(2):
        total, count = np.zeros_like(shape), np.zeros((len(shape), 1))
        for frame, visible in zip(positions, valid, strict=True):
            turn, shift = _rigid(frame[visible], shape[visible])
            total[visible] += frame[visible] @ turn.T + shift
            count[visible] += 1.0
        shape = total / count
    return shape


def _palm_in_our_frame(ours: Float, theirs: Float) -> tuple[Float, Float]:
    """Return the tracked palm in our orientation, shape (joints, 3), and its scales to ours, across and along.

    The scale across also applies to the height above the palm. Raises SceneError for a hand of the other side.
    """
    target, centred = ours - ours.mean(axis=0), theirs - theirs.mean(axis=0)
    turned, scales, miss = _turned_and_scaled(target, centred)
    mirrored = _turned_and_scaled(target * np.array([-1.0, 1.0, 1.0]), centred)[2]
    # A nearly flat palm also fits its mirror image, and must not be refused because of noise.
    if mirrored < 0.5 * miss:
        raise SceneError(
            f"hand retargeting: the tracked palm is {1e3 * miss:.2g} mm from that of the hand, and "
            f"{1e3 * mirrored:.2g} mm from its mirror image; use a hand of the other side"
        )
    return turned, scales


def _turned_and_scaled(target: Float, centred: Float) -> tuple[Float, Float, float]:
    """Return `centred` rotated to `target`, the scales across and along, and the remaining rms distance [m]."""
    scales = np.ones(2)
    for _ in range(PALM_ROUNDS):
        # Rotate the tracked palm to ours scaled to its size, then compute the remaining scales.
        turned = Rotation.align_vectors(target / scales[[0, 1, 0]], centred)[0].apply(centred)
        across, along = turned[:, [0, 2]], turned[:, 1]
        ratios = np.array(
            [np.sum(across * target[:, [0, 2]]) / np.sum(across**2), along @ target[:, 1] / (along @ along)]
        )
        scales = np.clip(ratios, 0.2, 5.0)
    miss = turned * scales[[0, 1, 0]] - target
    return turned, scales, float(np.sqrt(np.mean(np.sum(miss**2, axis=1))))


class _Placed(NamedTuple):
    """The posed hand.

    origins: origins of the bones [m], shape (bones, 3)
    rotations: shape (bones, 3, 3)
    joints: joints after the root, and tip, of each digit [m], shape (5, 3, 3)
    """

    origins: Float
    rotations: Float
    joints: Float


class _Fit:
    """Fits joint angles of the digits of our hand, frame by frame."""

    def __init__(self, hand: ArticulatedHand, joints: HandJoints) -> None:
        self._hand = hand
        self._joints = joints
        self._chains = np.array(CHAINS)
        self.rest = np.array([joint.rest_deg for joint in hand.joints])
        root = hand.bone("hand")
        self._moving = np.array([n for n, joint in enumerate(hand.joints) if joint.bone != root])
        self._low = np.array([hand.joints[n].low_deg for n in self._moving])
        self._high = np.array([hand.joints[n].high_deg for n in self._moving])
        hinges = [hand.joints[n] for n in self._moving]
        self._axes = np.deg2rad(1.0) * np.array([joint.axis for joint in hinges])
        self._bones = np.array([joint.bone for joint in hinges])
        # The outer of two joints of a bone (abduction) rotates with the bone before it.
        outer = [joint.name.endswith("_abduction") for joint in hinges]
        self._turned_with = np.where(outer, [hand.bones[bone].parent for bone in self._bones], self._bones)
        self._digits = np.array([DIGITS.index(joint.name.split("_")[0]) for joint in hinges])
        first = np.array(
            [hand.bone(f"{name}_metacarpal" if name == "thumb" else f"{name}_proximal") for name in DIGITS]
        )
        self._beyond = np.arange(3) >= (self._bones - first[self._digits])[:, None]
        self._lengths = np.linalg.norm(np.diff(joints.positions[self._chains], axis=1), axis=2)

    def angles(self, steps: Float, valid: Bool, before: Float) -> tuple[Float, Float]:
        """Return angles of all joints [deg], shape (joints,), and the residuals of the valid tips [m].

        steps: tracked bones of the digits in the frame of the palm, as vectors from joint to joint [m], shape (5, 3, 3)
        valid: whether both ends of a bone are valid, shape (5, 3)
        before: angles of the previous frame [deg]
        """
        long = np.linalg.norm(steps, axis=2, keepdims=True)
        usable = valid & (long[:, :, 0] > 1e-4)
        onward = steps / np.where(usable[:, :, None], long, 1.0)
        # A joint is fitted if all bones from the palm to it are valid.
        used = np.logical_and.accumulate(usable, axis=1)
        roots = self._joints.positions[self._chains[:, 0]]
        targets = roots[:, None] + np.cumsum(self._lengths[:, :, None] * onward, axis=1)
        start = np.clip(before[self._moving], self._low, self._high)

        # Cached, because the solver evaluates misses and slopes at the same angles
        at = lru_cache(maxsize=1)(lambda angles: self._placed(np.frombuffer(angles)))

        def residuals(x: Float) -> Float:
            parts = at(x.tobytes()).joints - targets
            return np.concatenate([(parts * used[:, :, None]).ravel(), TO_BEFORE_m_deg * (x - start)])

        def slopes(x: Float) -> Float:
            return np.concatenate(
                [self._slopes(at(x.tobytes())) * np.repeat(used.ravel(), 3)[:, None], TO_BEFORE_m_deg * np.eye(len(x))]
            )

        scale = np.full(len(start), 10.0)
        solution = least_squares(
            residuals, start, slopes, bounds=(self._low, self._high), x_scale=scale, xtol=1e-6, ftol=1e-6
        )
        x = np.clip(solution.x, self._low, self._high)
        tips = np.linalg.norm(at(x.tobytes()).joints[:, -1] - targets[:, -1], axis=1)[used[:, -1]]
        return self._all(x), tips

    def at_limit(self, angles: Float) -> float:
        """Return the fraction of the angles, shape (frames, joints), within 0.01 degrees of an end of their range."""
        x = angles[:, self._moving]
        return float(np.mean((x < self._low + 0.01) | (x > self._high - 0.01)))

    def _all(self, x: Float) -> Float:
        angles = self.rest.copy()
        angles[self._moving] = x
        return angles

    def _placed(self, x: Float) -> _Placed:
        origins, rotations = poses_at(self._hand, self._all(x))
        joints = joints_at(self._hand, self._joints, origins, rotations)[self._chains[:, 1:]]
        return _Placed(origins, rotations, joints)

    def _slopes(self, at: _Placed) -> Float:
        """Return the derivatives of joint positions by angles [m/deg], shape (45, moving)."""
        axes = np.einsum("nab,nb->na", at.rotations[self._turned_with], self._axes)
        arms = at.joints[self._digits] - at.origins[self._bones][:, None]
        count = len(self._moving)
        slopes = np.zeros((*at.joints.shape, count))
        # Each hinge moves the parts beyond it on its own digit.
        slopes[self._digits, :, :, np.arange(count)] = self._beyond[:, :, None] * np.cross(axes[:, None], arms)
        return slopes.reshape(-1, count)
