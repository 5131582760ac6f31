"""A simulated hand that follows a tracked hand in real time."""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from palmfield.closing import Closing
from palmfield.errors import DeviceError, PalmfieldError, SceneError
from palmfield.hand.articulated import ArticulatedHand
from palmfield.motion.joints import POSITION_VALID
from palmfield.motion.line_listener import STALE_S, By
from palmfield.motion.listening import Arrived, Listener
from palmfield.motion.pose import HandPose
from palmfield.motion.prediction import Noise, Predictor
from palmfield.motion.retarget import RIGID, Bool, Follower, fixes_palm
from palmfield.motion.source import tracker_frame
from palmfield.realtime import follower
from palmfield.transforms import Transform
from palmfield.types import Float

PALM_SAMPLES = 5
"""Number of samples with all palm joints from which the shape of the palm is estimated."""
PREDICT_S = 0.2


class LivePose(NamedTuple):
    """A live pose.

    pose: pose in the world
    arrived_s: arrival of its sample [s, monotonic clock]
    sample_s: time of the sample on the tracker's clock [s], without extrapolation
    """

    pose: HandPose
    arrived_s: float
    sample_s: float


class LiveHand(Closing):
    """Context manager that lets a hand follow the newest tracker sample, in a separate thread.

    listener: reads the samples
    newest: last pose; None until the shape of the palm is estimated
    fitted: number of fitted samples
    fit_s: computing time for each sample [s]
    """

    def __init__(
        self,
        hand: ArticulatedHand,
        to_world: Transform,
        *,
        ahead_s: float = 0.0,
        host: str = "127.0.0.1",
        port: int = 0,
        by: By = "udp",
    ) -> None:
        """to_world: pose of the tracker frame in the world
        ahead_s: time by which each sample is extrapolated [s]

        Raises DeviceError for an address at which it cannot listen.
        """
        self._hand, self._to_world, self._ahead_s = hand, to_world, ahead_s
        self._turn = Rotation.from_matrix(to_world.rotation)
        self._filter = Predictor(Noise(), PREDICT_S)
        self._lock, self._due, self._ended = threading.Lock(), threading.Event(), threading.Event()
        self._last: Arrived | None = None
        self._palms: list[tuple[Float, Bool]] = []
        self._follower: Follower | None = None
        self._error: PalmfieldError | None = None
        self.newest: LivePose | None = None
        self.fit_s: list[float] = []
        self._thread = follower(self._follow)
        self.listener = Listener(host, port, by, self._add_sample)
        self._thread.start()

    def wait(self, timeout_s: float) -> LivePose:
        """Return the first pose. Raises SceneError if none comes in time, and for a hand of the other side."""
        end = time.monotonic() + timeout_s
        while time.monotonic() < end:
            self.check()
            if self.newest is not None:
                return self.newest
            time.sleep(0.002)
        raise SceneError(
            f"no hand was tracked within {timeout_s:g} s at {self.listener.by} "
            f"{self.listener.host}:{self.listener.port}: {self.listener.report()}"
            + (f"; {self.listener.reported[0]}" if self.listener.reported else "")
        )

    def check(self) -> None:
        """Raise errors of the threads: SceneError for a hand of the other side, DeviceError if a thread failed."""
        self.listener.check()
        if self._error is not None:
            raise self._error

    @property
    def stale(self) -> bool:
        """Whether no sample of the hand has arrived for STALE_S."""
        return self.newest is None or time.monotonic() - self.newest.arrived_s > STALE_S

    def close(self) -> None:
        self._ended.set()
        self._due.set()
        self.listener.close()
        self._thread.join()

    def _add_sample(self, arrived: Arrived) -> None:
        sample = arrived.sample
        positions = self._to_world.points(sample.positions)
        with self._lock:
            self._last = arrived
            if self._ahead_s > 0.0:
                turned = self._turn * Rotation.from_quat(sample.quaternions, scalar_first=True)
                quaternions = turned.as_quat(scalar_first=True)
                self._filter.add(sample.time_s, positions, quaternions, sample.radii, sample.flags)
        self._due.set()

    def _follow(self) -> None:
        while not self._ended.is_set():
            self._due.wait()
            self._due.clear()
            with self._lock:
                last = self._last
                if last is None:
                    continue
                valid = (last.sample.flags & POSITION_VALID) != 0
                positions = self._to_world.points(last.sample.positions)
                if self._ahead_s > 0.0:
                    ahead, *_ = self._filter.at(last.sample.time_s + self._ahead_s)
                    positions = np.where(valid[:, None], ahead, positions)
            began = time.perf_counter()
            try:
                pose = self._pose(positions, valid)
            except PalmfieldError as error:
                self._error = error
                return
            except Exception as error:
                self._error = DeviceError(
                    f"the hand model cannot be fitted to the tracker samples: {error!r}; start again"
                )
                return
            if pose is not None:
                self.fit_s.append(time.perf_counter() - began)
                self.newest = LivePose(pose, last.time_s, last.sample.time_s)

    def _pose(self, positions: Float, valid: Bool) -> HandPose | None:
        if self._follower is None:
            if valid[list(RIGID)].all():
                self._palms.append((positions, valid))
            if len(self._palms) < PALM_SAMPLES:
                return None
            palms, flags = (np.array(part) for part in zip(*self._palms, strict=True))
            self._follower = Follower(self._hand, palms, flags)
        if not fixes_palm(positions, valid):
            return None
        followed = self._follower.follow(positions, valid)
        angles = dict(zip(self._follower.names, followed.angles_deg.tolist(), strict=True))
        return HandPose(followed.position, followed.quaternion, angles)


@dataclass(frozen=True)
class Live:
    """Source of tracker samples, and pose of the tracker.

    host, port, by: address and protocol of the socket, port 0 for any free one; align: file of `palmfield track
    align`; None: the origin of
        the tracker is that of the scene; up: axis of the tracker that points up
    wait_s: longest wait for the first sample [s]; on_listening: called with the address once the socket listens
    """

    host: str = "127.0.0.1"
    port: int = 0
    by: By = "udp"
    align: Path | None = None
    up: Literal["y", "z"] = "y"
    wait_s: float = 30.0
    on_listening: Callable[[str, int], None] = lambda host, port: None

    def frame(self, array: Transform) -> Transform:
        """Return the tracker frame in the world. array: frame of the first array. Raises SceneError for a bad file."""
        return tracker_frame(array, self.align, self.up)

    def follow(self, hand: ArticulatedHand, array: Transform, ahead_s: float = 0.0) -> LiveHand:
        """Listen, and return the hand that follows the samples. array, ahead_s: as in `frame` and LiveHand.

        Raises SceneError for a bad file, DeviceError for an address at which it cannot listen.
        """
        followed = LiveHand(hand, self.frame(array), ahead_s=ahead_s, host=self.host, port=self.port, by=self.by)
        self.on_listening(followed.listener.host, followed.listener.port)
        return followed

    def keys(self, name: str, stream: Path, start_s: float) -> dict[str, object]:
        """Return keys that make the instance `name` follow the samples of the tracker."""
        own: dict[str, object] = dict.fromkeys(("keyframes", "trajectory", "function"))
        own |= {"tracking": str(stream.resolve()), "start_s": start_s, "follow": "exact", "tracking_origin_m": None}
        own["tracking_up"] = None if self.align is not None else self.up
        own["tracking_alignment"] = None if self.align is None else str(self.align.resolve())
        return {f"{name}.{key}": value for key, value in own.items()}
