"""Let a board follow a tracked hand in real time, and record the motion of the hand."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from palmfield.drive.frame_log import FrameLog
from palmfield.drive.limits import SoundLimits
from palmfield.drive.playback import frame_times
from palmfield.errors import SceneError
from palmfield.motion.live_hand import STALE_S, Live
from palmfield.motion.tracking import Stream
from palmfield.session.live_scene import LiveScene
from palmfield.session.preview import Preview
from palmfield.simulation.emission import Emission
from palmfield.simulation.frames import Frames
from palmfield.simulation.posed_scene import PosedScene
from palmfield.studies.trial.course import Tracker
from palmfield.studies.trial.field import focus_in
from palmfield.studies.trial.sending import VIRTUAL, MadeFrame, Sent, send
from palmfield.types import Float

FIT_S = 5e-3
"""Approximate time to fit the hand to a sample."""


@dataclass(frozen=True)
class LivePlayed:
    """Result of a session in which a board followed a hand.

    motion: name of the scene's palmfield.motion; stream: valid samples in the tracker frame
    start_s: time 0 of the tracker, in the time of the trial [s]
    notes: remarks on the samples (with the first invalid ones), on the fit of the hand, and on silent frames
    times: times at which frames were due [s]
    """

    sent: Sent
    motion: str
    stream: Stream
    start_s: float
    notes: list[str]
    times: list[float] = field(repr=False)


def play_live(
    view: Preview,
    live: Live,
    tracker: Tracker,
    duration_s: float,
    number: int,
    *,
    port: str | None = None,
    log: FrameLog | None = None,
    on_progress: Callable[[float], None] | None = None,
) -> LivePlayed:
    """Let a board follow a tracked hand for `duration_s` [s], in real time.

    tracker: latency and extrapolation of the tracker; if ahead_s is None, positions are extrapolated to the middle of
        the frame
    number: number of the followed stimulus
    port: port of a board, by default a virtual board
    While the tracker has lost the hand, frames are silent. Ctrl-C ends the play early. Raises SceneError if no sample
    of a hand arrives in time, and for a hand of the other side. Raises DeviceError for an address or a port that cannot
    be opened.
    """
    scene = LiveScene(view)
    runtime = scene.runtime
    model, board = runtime.model, runtime.model.board
    # Poses of a live hand are independent of MuJoCo's steps
    limits = SoundLimits.of(model.spec.driver)
    times = frame_times(model.configs, duration_s, None, limits.ramp_times(board, duration_s), board.frame_time_s)
    period_s = float(np.median(np.diff(times))) if len(times) > 1 else board.frame_time_s
    ahead_s = tracker.ahead_s
    if ahead_s is None:
        ahead_s = tracker.latency_s + FIT_S + board.frame_time_s + 0.5 * period_s
    frames, afterwards = (Frames(model, Emission(model)) for _ in range(2))
    array = view.runtime.posed.array_frame
    posed_of: list[tuple[object, PosedScene]] = []
    silenced = 0
    unreachable: list[str] = []
    with live.follow(scene.hand, array, ahead_s) as follower:
        follower.wait(live.wait_s)

        def silent(focus: Float, sample_s: float) -> MadeFrame:
            silence = np.zeros(len(model.arrays), np.complex128)
            data = board.encode(silence) if board.takes == "amplitudes" else board.encode_focus((0.0, 0.0, 0.2), 0.0)
            return MadeFrame(data, focus, sample_s, lambda: silence, sounds=False)

        def make(now_s: float, due_s: float) -> MadeFrame:
            nonlocal silenced
            follower.check()
            newest = follower.newest
            assert newest is not None
            if not posed_of or posed_of[0][0] is not newest:
                posed_of[:] = [(newest, scene.posed(newest.pose))]
            posed = posed_of[0][1]
            focus = focus_in(model, number, posed, due_s)
            # Use the clock of the tracker until its offset to the clock of this machine is measured
            sample_s = newest.sample_s
            if follower.stale:
                silenced += 1
                return silent(focus, sample_s)
            share = limits.share(board, due_s, duration_s)
            try:
                data = frames.at(posed, due_s, share)
            except SceneError as error:
                # A live hand may move behind the array
                unreachable.append(str(error))
                return silent(focus, sample_s)
            return MadeFrame(data, focus, sample_s, lambda: share * afterwards.target(posed, due_s), frames.sounds)

        sent = send(
            board, times, make, duration_s, port=port or VIRTUAL, log=log, limits=limits, on_progress=on_progress
        )
        listener = follower.listener
        start_s = listener.offset_s - tracker.latency_s - sent.zero_s
        for one in sent.frames:
            one.frame.sample_s += start_s
        fitted = 1e3 * np.array(follower.fit_s)
        notes = [
            f"tracker: {listener.report()}",
            *(f"tracker: {text}" for text in listener.reported),
            f"tracker: fitting the hand to a sample took {np.median(fitted):.1f} ms (maximum {fitted.max():.1f})",
        ]
        if silenced:
            notes.append(
                f"tracker: {silenced} frames were silent, because the hand was not tracked for {1e3 * STALE_S:g} ms"
            )
        if unreachable:
            notes.append(
                f"tracker: {len(unreachable)} frames were silent, because no focus is possible there: {unreachable[0]}"
            )
        stream = listener.stream()
    return LivePlayed(sent, scene.motion, stream, start_s, notes, times)
