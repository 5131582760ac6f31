"""Motion of a hand through given poses at given times."""

import math
from bisect import bisect_right
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BPoly, CubicHermiteSpline, PchipInterpolator, PPoly
from scipy.spatial.transform import Rotation

from palmfield.errors import SceneError, naming
from palmfield.hand.articulated import ArticulatedHand, checked_angles
from palmfield.hand.poses import named_pose
from palmfield.motion.pose import HandPose, numbers, unit_quaternions
from palmfield.motion.rates import FrameRates, HandRates
from palmfield.types import Float

STEEPEST = 1.25
"""Largest slope of a smooth curve at a key, divided by the slope of the flatter of the two adjacent chords."""
END = np.polynomial.Polynomial([0.0, 0.0, 0.0, 0.0, 2.5, -1.5])
SMOOTH = 1.0 - END(np.polynomial.Polynomial([1.0, -1.0])), np.polynomial.Polynomial([0, 0, 0, 10.0, -15.0, 6.0]), END
"""Cumulative Bernstein polynomials of fifth order, summed from the end.

Three are used: the mean of the first two, the third, and the mean of the last two.
"""


class Curve:
    """A motion through poses: continuously differentiable, and at rest before the first and after the last.

    Positions and angles are monotone cubics (Fritsch & Carlson 1980), so they stay between neighbouring keys.
    Orientations are cubic quaternion curves (Kim, Kim & Shin 1995, A general construction scheme for unit quaternion
    curves). The angular velocity at a key is limited in the same way. Between equal keys the hand rests.
    span_s: first and last time [s]
    smooth: whether the polynomials are of fifth degree, with zero acceleration at the keys. Accelerations are then
        continuous (`rates`), and a motion from rest to rest is the minimum-jerk motion.
    """

    def __init__(
        self,
        joints: Sequence[str],
        times_s: Float,
        positions: Float,
        quaternions: Float,
        angles_deg: Float,
        rest: bool,
        smooth: bool = False,
    ) -> None:
        """Make a curve. All values must have been checked before.

        times_s: rising times [s], shape (n,), n >= 2
        positions: [m], shape (n, 3)
        quaternions: unit quaternions, w first, shape (n, 4)
        angles_deg: joint angles [deg], shape (n, joints)
        rest: whether to begin and end at rest; if not, the end speeds are those between the first and the last two
            poses
        smooth: see Curve; only with `rest`
        """
        self.span_s = float(times_s[0]), float(times_s[-1])
        self._joints = list(joints)
        values = np.concatenate([positions, angles_deg], axis=1)
        slopes = PchipInterpolator(times_s, values).derivative()(times_s)
        if rest:
            slopes[[0, -1]] = 0.0
        self.smooth = smooth
        if smooth:
            steep = np.abs(np.diff(values, axis=0) / np.diff(times_s)[:, None])
            # With these slopes the control points of an interval do not pass each other
            most = STEEPEST * np.minimum(np.concatenate([steep[:1], steep]), np.concatenate([steep, steep[-1:]]))
            slopes = np.clip(slopes, -most, most)
            derivatives = np.stack([values, slopes, np.zeros_like(values)], axis=1)
            self._coefficients = PPoly.from_bernstein_basis(BPoly.from_derivatives(times_s, derivatives)).c
        else:
            self._coefficients = CubicHermiteSpline(times_s, values, slopes).c
        keys = Rotation.from_quat(quaternions, scalar_first=True)
        self._knots, self._from = times_s.tolist(), quaternions.tolist()
        self._turns = _turns(times_s, keys, rest, 0.4 if smooth else 1.0 / 3.0).tolist()

    def __call__(self, time_s: float) -> HandPose:
        """Return the pose at a time [s]."""
        time = min(max(float(time_s), self.span_s[0]), self.span_s[1])
        n = min(max(bisect_right(self._knots, time) - 1, 0), len(self._knots) - 2)
        x, length = time - self._knots[n], self._knots[n + 1] - self._knots[n]
        s = x / length
        values, *others = self._coefficients[:, n]
        for coefficient in others:
            values = values * x + coefficient
        # Bernstein polynomials of the third order, summed from the end.
        shares = 1.0 - (1.0 - s) ** 3, s * s * (3.0 - 2.0 * s), s**3
        if self.smooth:
            shares = SMOOTH[0](s), SMOOTH[1](s), SMOOTH[2](s)
        turned = _turned(self._from[n], shares, self._turns[n])
        angles = dict(zip(self._joints, values[3:].tolist(), strict=True))
        return HandPose(values[:3], np.array(turned), angles)

    def rates(self, time_s: float) -> HandRates:
        """Return the analytic derivatives of a smooth curve at a time [s]. They are 0 outside the span."""
        pose = self(time_s)
        if not self.span_s[0] < time_s < self.span_s[1]:
            return HandRates(FrameRates.at_rest(), pose.angles_deg, {}, {})
        n = bisect_right(self._knots, time_s) - 1
        x, length = time_s - self._knots[n], self._knots[n + 1] - self._knots[n]
        first = _derivative(self._coefficients[:, n])
        speeds, accelerations = _value(first, x), _value(_derivative(first), x)
        frame = FrameRates.at_rest()
        for share, turn in zip(SMOOTH, np.array(self._turns[n]), strict=True):
            angles = [float(of(x / length)) for of in (share, share.deriv(1) / length, share.deriv(2) / length**2)]
            frame = frame.hinge(turn, angles, np.zeros(3))
        into = Rotation.from_quat(pose.quaternion, scalar_first=True).inv()
        joints = [dict(zip(self._joints, values[3:].tolist(), strict=True)) for values in (speeds, accelerations)]
        return HandRates(frame._replace(acceleration=into.apply(accelerations[:3])), pose.angles_deg, *joints)


def _value(coefficients: Float, x: float) -> Float:
    """Return the values of polynomials, shape (m,). coefficients: shape (k, m), highest power first"""
    values, *others = coefficients
    for coefficient in others:
        values = values * x + coefficient
    return np.asarray(values)


def _derivative(coefficients: Float) -> Float:
    """Return the coefficients of the derivatives of polynomials as in `_value`, shape (k - 1, m)."""
    return coefficients[:-1] * np.arange(len(coefficients) - 1, 0, -1)[:, None]


def _turned(
    quaternion: Sequence[float], shares: Sequence[float], turns: Sequence[Sequence[float]]
) -> tuple[float, float, float, float]:
    """Return a rotation (w, x, y, z) that is followed, in body axes, by successive shares of rotation vectors [rad]."""
    w, x, y, z = quaternion
    for share, (a, b, c) in zip(shares, turns, strict=True):
        angle = math.sqrt(a * a + b * b + c * c)
        half = 0.5 * share * angle
        scale = math.sin(half) / angle if angle > 0.0 else 0.0
        p, q, r, s = math.cos(half), scale * a, scale * b, scale * c
        w, x, y, z = (
            w * p - x * q - y * r - z * s,
            w * q + x * p + y * s - z * r,
            w * r - x * s + y * p + z * q,
            w * s + x * r - y * q + z * p,
        )
    return w, x, y, z


def _turns(times: Float, keys: Rotation, rest: bool, share: float) -> Float:
    """Return the three rotation vectors of each interval of the curve [rad], shape (n - 1, 3, 3).

    share: part of an interval in which the first and the last vector continue at the speed of their key
    """
    steps = np.diff(times)[:, None]
    speeds = (keys[:-1].inv() * keys[1:]).as_rotvec() / steps
    at_keys = np.zeros((len(times), 3))
    before, after = speeds[:-1], speeds[1:]
    # Weighted harmonic mean of the speeds on either side, by length and direction, 0 if the rotation reverses.
    weight_before, weight_after = 2.0 * steps[1:] + steps[:-1], steps[1:] + 2.0 * steps[:-1]
    slow, fast = np.linalg.norm(before, axis=1, keepdims=True), np.linalg.norm(after, axis=1, keepdims=True)
    onward = (np.sum(before * after, axis=1, keepdims=True) > 0.0) & (np.minimum(slow, fast) > 1e-12)
    divisor = np.where(onward, weight_before * fast + weight_after * slow, 1.0)
    at_keys[1:-1] = np.where(onward, (weight_before * fast * before + weight_after * slow * after) / divisor, 0.0)
    if not rest:
        at_keys[[0, -1]] = speeds[[0, -1]]
    leaving, arriving = share * steps * at_keys[:-1], share * steps * at_keys[1:]
    middle = Rotation.from_rotvec(-leaving) * keys[:-1].inv() * keys[1:] * Rotation.from_rotvec(-arriving)
    return np.stack([leaving, middle.as_rotvec(), arriving], axis=1)


def keyframes(
    hand: ArticulatedHand,
    times_s: ArrayLike,
    positions: ArrayLike,
    quaternions: ArrayLike,
    poses: Sequence[Mapping[str, float] | str],
    smooth: bool = False,
) -> Curve:
    """Return a motion through keys that starts and ends at rest; smooth: see `Curve`.

    times_s: rising [s], two or more, shape (n,)
    positions: positions of the hand frame [m], shape (n, 3); quaternions: orientations, w first, any length, shape (n,
    4)
    poses: n names as in `named_pose`, or angles [deg] by joint, with other joints at rest
    Raises SceneError for times that do not rise, other numbers of keys, numbers that are not finite, a quaternion of
    length 0, an unknown pose or joint, and an angle out of its range.
    """
    times = rising(times_s, "hand keyframes")
    n = len(times)
    if len(poses) != n:
        raise SceneError(f"hand keyframes: {len(poses)} poses for {n} times; give one pose for each time")
    angles = []
    for k, pose in enumerate(poses):
        with naming(f"hand keyframes: at {times[k]:g} s"):
            angles.append(checked_angles(hand, named_pose(hand, pose) if isinstance(pose, str) else pose))
    places = numbers(positions, (n, 3), "hand keyframes: positions")
    turns = unit_quaternions(quaternions, (n, 4), "hand keyframes: quaternions")
    return Curve([joint.name for joint in hand.joints], times, places, turns, np.array(angles), True, smooth)


def rising(times_s: ArrayLike, what: str) -> Float:
    """Return the times [s] as float64, shape (n,). Raises SceneError unless they are finite, rising, two or more."""
    times = np.asarray(times_s, dtype=np.float64)
    if times.ndim != 1 or len(times) < 2 or not np.isfinite(times).all() or np.any(np.diff(times) <= 0.0):
        raise SceneError(f"{what}: times are {times.tolist()}; give two or more that rise [s]")
    return times
