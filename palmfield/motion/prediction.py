"""Resample a tracking stream to a clock, with extrapolation, by a Kalman filter."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from palmfield.errors import SceneError
from palmfield.motion.joints import JOINTS, ORIENTATION_TRACKED, ORIENTATION_VALID, POSITION_TRACKED, POSITION_VALID
from palmfield.motion.keyframes import rising
from palmfield.motion.quaternions import inverse, of_turns, product, turns_of, unit
from palmfield.motion.tracking import Stream, StreamReport, checked_stream, stream_report
from palmfield.types import Float, Int

Bool = NDArray[np.bool_]


@dataclass(frozen=True)
class Noise:
    """Noise model of tracker and hand. It determines the gains of the filter.

    position_m, angle_rad: standard deviation of one packet
    accel_m_s2, accel_rad_s2: standard deviation of the acceleration of a joint between packets
    At 90 packets/s the steady gains are 0.75 (position) and 0.50/period (velocity). For orientation they are 0.67 and
    0.36/period.
    """

    position_m: float = 0.0005
    angle_rad: float = 0.01
    accel_m_s2: float = 4.0
    accel_rad_s2: float = 50.0


@dataclass(frozen=True)
class Resampled:
    """A stream resampled to a clock.

    stream: stream at the times clock + ahead_s
    report: quality of the input packets
    age_s: time of each joint since its last packet [s], shape (clock, 26); inf before the first packet
    held: fraction of (joint, clock time) pairs at which the joint is fixed, because its last packet is too old
    skipped: number of packets that were omitted because they were out of order or repeated
    """

    stream: Stream
    report: StreamReport
    age_s: Float
    held: float
    skipped: int


class _Filter:
    """Kalman filter of position (or small rotation) and velocity of each joint.

    The velocity is constant between packets.

    The covariance is the same for all axes of a joint. Source: Bar-Shalom, Li & Kirubarajan (2001), Estimation with
    Applications to Tracking and Navigation, section 6.3.2: discrete white-noise acceleration.
    """

    def __init__(self, n: int, noise: float, acceleration: float, first_speed: float) -> None:
        self._noise2, self._acceleration2, self._first_speed2 = noise**2, acceleration**2, first_speed**2
        self.speed = np.zeros((n, 3))
        self._p = np.zeros((n, 3))

    def start(self, which: Bool) -> None:
        """Initialise joints with their first packet, or with the first packet after a gap."""
        self.speed[which] = 0.0
        self._p[which] = self._noise2, 0.0, self._first_speed2

    def advance(self, which: Bool, dt: Float) -> tuple[Float, Float]:
        """Return gains for value and speed, shape (joints, 1) each, for a packet `dt` [s] after the last one."""
        p, cross, v = self._p[which].T
        q = self._acceleration2 * dt**2
        p, cross, v = p + 2.0 * dt * cross + dt**2 * v + q * dt**2 / 4.0, cross + dt * v + q * dt / 2.0, v + q
        gain, gain_speed = p / (p + self._noise2), cross / (p + self._noise2)
        self._p[which] = np.stack([(1.0 - gain) * p, (1.0 - gain) * cross, v - gain_speed * cross], axis=1)
        return gain[:, None], gain_speed[:, None]


class Predictor:
    """Predicts joints at any time after the last packet, from the packets received up to then."""

    def __init__(self, noise: Noise, predict_s: float, n: int = len(JOINTS)) -> None:
        """predict_s: time for which a joint without packets continues at its velocity before it is fixed [s]

        n: number of joints or other tracked frames
        """
        self._predict_s = predict_s
        self._place = _Filter(n, noise.position_m, noise.accel_m_s2, 1.0)
        self._turn = _Filter(n, noise.angle_rad, noise.accel_rad_s2, 10.0)
        self._position = np.zeros((n, 3))
        self._orientation = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
        self._radius = np.zeros(n)
        self._placed_s = np.full(n, -np.inf)
        self._turned_s = np.full(n, -np.inf)

    def add(self, time_s: float, position: Float, quaternion: Float, radius: Float, flags: Int) -> None:
        """Add one packet; times of packets must rise."""
        valid = (flags & POSITION_VALID) != 0
        new = valid & (time_s - self._placed_s > self._predict_s)
        started = valid & ~new
        dt = (time_s - self._placed_s[started])[:, None]
        guess = self._position[started] + self._place.speed[started] * dt
        gain, gain_speed = self._place.advance(started, dt[:, 0])
        self._position[started] = guess + gain * (position[started] - guess)
        self._place.speed[started] += gain_speed * (position[started] - guess)
        self._position[new] = position[new]
        self._place.start(new)
        self._radius[valid] = radius[valid]
        self._placed_s[valid] = time_s
        self._add_turn(time_s, quaternion, (flags & ORIENTATION_VALID) != 0)

    def _add_turn(self, time_s: float, quaternion: Float, valid: Bool) -> None:
        new = valid & (time_s - self._turned_s > self._predict_s)
        started = valid & ~new
        if started.any():
            dt = (time_s - self._turned_s[started])[:, None]
            guess = product(of_turns(self._turn.speed[started] * dt), self._orientation[started])
            miss = turns_of(product(unit(quaternion[started]), inverse(guess)))
            gain, gain_speed = self._turn.advance(started, dt[:, 0])
            self._orientation[started] = unit(product(of_turns(gain * miss), guess))
            self._turn.speed[started] += gain_speed * miss
        self._orientation[new] = unit(quaternion[new])
        self._turn.start(new)
        self._turned_s[valid] = time_s

    def frames(self, time_s: float) -> tuple[Float, Float]:
        """Return positions [m], shape (n, 3), and orientations (w, x, y, z), shape (n, 4), at a time [s]."""
        # A joint without packets has an infinite gap and speed 0
        ahead = np.where(np.isfinite(self._placed_s), np.minimum(time_s - self._placed_s, self._predict_s), 0.0)
        ahead_turn = np.where(np.isfinite(self._turned_s), np.minimum(time_s - self._turned_s, self._predict_s), 0.0)
        positions = self._position + self._place.speed * ahead[:, None]
        return positions, product(of_turns(self._turn.speed * ahead_turn[:, None]), self._orientation)

    def at(self, time_s: float) -> tuple[Float, Float, Float, Int, Float]:
        """Return positions [m], quaternions (w first), radii [m], flags, and time since the last packet [s]."""
        positions, turned = self.frames(time_s)
        age = time_s - self._placed_s
        located, oriented = np.isfinite(self._placed_s), np.isfinite(self._turned_s)
        # The flag `tracked` is only for joints that need no extrapolation over a gap.
        fresh, fresh_turn = located & (age <= self._predict_s), oriented & (time_s - self._turned_s <= self._predict_s)
        flags = POSITION_VALID * located + ORIENTATION_VALID * oriented
        flags = flags + POSITION_TRACKED * fresh + ORIENTATION_TRACKED * fresh_turn
        return positions, turned, self._radius, flags, age


def resample(
    stream: Stream, clock_s: ArrayLike, ahead_s: float = 0.0, predict_s: float = 0.1, noise: Noise | None = None
) -> Resampled:
    """Predict the hand `ahead_s` [s] after each time of a rising clock [s], shape (n,).

    Only packets up to the clock time are used; packets out of order are omitted. A joint without packets continues at
    its last velocity until `predict_s` [s] after its last packet, including ahead_s. Then its position is fixed, and it
    is flagged as valid but not as tracked. The next packet restarts its filter. Before its first packet a joint is not
    valid. Raises SceneError for an invalid stream, a clock that does not rise, and negative times.
    """
    checked = checked_stream(stream, "tracking stream")
    clock = rising(clock_s, "tracking clock")
    for name, value in (("ahead_s", ahead_s), ("predict_s", predict_s)):
        if not 0.0 <= value < np.inf:
            raise SceneError(f"tracking: {name} is {value}; give 0 or more seconds")
    arrival = np.maximum.accumulate(checked.times_s)
    in_time = np.concatenate([[True], checked.times_s[1:] > arrival[:-1]])
    filtered = Predictor(noise or Noise(), predict_s)
    rows = []
    n = 0
    for now in clock:
        while n < len(checked) and arrival[n] <= now:
            if in_time[n]:
                packet = checked.positions[n], checked.quaternions[n], checked.radii[n], checked.flags[n]
                filtered.add(float(checked.times_s[n]), *packet)
            n += 1
        rows.append(filtered.at(float(now) + ahead_s))
    positions, quaternions, radii, flags, age = (np.array(part) for part in zip(*rows, strict=True))
    started = np.isfinite(age)
    held_share = float(np.mean(age[started] > predict_s)) if started.any() else 0.0
    on_clock = Stream(clock + ahead_s, positions, quaternions, radii, flags.astype(np.int32))
    return Resampled(on_clock, stream_report(checked), age, held_share, int(np.count_nonzero(~in_time)))
