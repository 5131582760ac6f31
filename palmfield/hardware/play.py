"""Play a scene or a focus on a real board, or record the bytes."""

import logging
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console

from palmfield.acoustics.reference import pressure64
from palmfield.config.stimulus import too_far
from palmfield.drive.board import Board
from palmfield.drive.boards import playable_board
from palmfield.drive.focal_peak import loudest_point
from palmfield.drive.frame_log import FrameLog, LogHead
from palmfield.drive.limits import SoundLimits
from palmfield.drive.playback import REFRESH_S, TimedFrame, filled, frame_times
from palmfield.drive.player import Player
from palmfield.drive.player.report import PlayReport
from palmfield.drive.ports import check_port
from palmfield.drive.recording import record
from palmfield.errors import DeviceError, OutputError, SceneError
from palmfield.estimate.sending import offset_words, peak_offset, sending
from palmfield.hardware.focus_board import FocusSound, am_share, focus_board
from palmfield.hardware.log_head import log_head
from palmfield.hardware.safety.exposure import SoundMoment, at_head, check_head, with_band
from palmfield.hardware.safety.scene_sound import warn_at_head
from palmfield.session.open_scene import Source
from palmfield.session.preview import Preview, preview
from palmfield.simulation.frames import Frames
from palmfield.terminal import bars
from palmfield.types import Complex, Float

LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class Target:
    """Destination of the bytes.

    port: port of a board, or None
    record: file for bytes without a port
    log: file of the sent bytes
    """

    port: str | None = None
    record: Path | None = None
    log: Path | None = None

    def check(self) -> None:
        """Check ports and files before frames are made, because making frames may take long.

        Raises DeviceError for a missing device, and OutputError for a missing folder.
        """
        if self.port is not None:
            check_port(self.port)
        for file in (self.record, self.log):
            if file is not None and not file.parent.is_dir():
                raise OutputError(f"cannot write {file}: there is no folder {file.parent}; make it, or choose another")


@dataclass(frozen=True)
class Performance:
    """Report of a play. text: report in words; warning: warning for users, empty if there is none"""

    text: str
    warning: str = ""

    def __str__(self) -> str:
        return self.text

    def saying(self, *more: str) -> "Performance":
        """Return the report with additional lines."""
        return replace(self, text="\n".join((self.text, *more)))


def play_focus(
    point: tuple[float, float, float],
    board: str,
    target: Target,
    duration_s: float,
    *,
    sound: FocusSound | None = None,
    keys: Mapping[str, object] | None = None,
    progress: bool = False,
) -> Performance:
    """Emit one focus (array frame [m]) for `duration_s`, and return a report in words.

    keys: keys of the board, as in palmfield.driver
    progress: whether to show a progress bar on the standard error of a terminal
    Raises SceneError for a focus behind the array or more than metres away. Raises DeviceError for an unknown or lost
    board, and for a level or a modulation that the board cannot play.
    """
    target.check()
    if (far := too_far(point)) is not None:
        raise SceneError(f"--focus has value {' '.join(f'{x:g}' for x in point)}, {far}")
    made = focus_board(board, sound or FocusSound(), keys or {})
    chosen, array, driver, sound = made.board, made.array, made.driver, made.sound
    limits = SoundLimits.of(driver)
    place: Float = np.array(point)
    unit = made.unit(place)
    played = np.zeros(len(array), np.complex128)
    if sound.level > 0.0:
        played = chosen.decode(chosen.start + made.frame(place, unit, sound.level))[-1]
    if sound.level > 0.0 and not played.any():
        raise DeviceError(
            f"--level has value {sound.level:g}, which {board} rounds to silence; allowed: 0, or a level near one "
            f"of its {chosen.amplitude_steps or chosen.transducers} steps"
        )
    am_Hz = sound.am_frequency_Hz

    def frame(time_s: float, share: float) -> TimedFrame:
        level = made.sound.level * (share if chosen.levels else 1.0) * am_share(time_s, am_Hz)
        return TimedFrame(time_s, made.frame(place, unit, level), level > 0.0)

    period_s = 1.0 / chosen.max_frame_rate_Hz if am_Hz > 0.0 else REFRESH_S
    due = (period_s * np.arange(np.ceil(duration_s / period_s - 1e-9))).tolist()
    times = filled(due, limits.ramp_times(chosen, duration_s), chosen.frame_time_s, duration_s)
    frames = (frame(time_s, limits.level_at(time_s, duration_s)) for time_s in times)

    def at_loudest(points: Float) -> Complex:
        return pressure64(points, array, played, made.sound.air)[0]

    if driver.head_m is not None:
        share = 0.375 if am_Hz > 0.0 else 1.0  # mean square of (1 + sin)/2
        moments = [SoundMoment(at_loudest, share)] if played.any() else []
        for line in check_head(with_band(at_head(moments, driver, array.positions), made.band), driver):
            LOG.warning(line)
    done = send(frames, chosen, duration_s, target, made.head, limits, progress).saying(*made.notes)
    if not played.any():
        return done
    loudest = loudest_point(at_loudest, np.zeros(3), place)
    peak = float(np.abs(at_loudest(loudest[None]))[0])
    exact = loudest_point(lambda points: pressure64(points, array, unit, sound.air)[0], np.zeros(3), place)
    words = offset_words(loudest - place, float(np.linalg.norm(loudest - exact)))
    return done.saying(f"{words}: {peak:.0f} Pa there")


def play_scene(
    scene: Source,
    board: str | None,
    target: Target,
    duration_s: float | None = None,
    *,
    keys: Mapping[str, object] | None = None,
    progress: bool = False,
) -> Performance:
    """Play the stimuli of a scene. Each frame uses the poses of hands and arrays at the time of its emission.

    board: name of a board that replaces the board of the scene
    keys: as in `palmfield.load`
    Raises SceneError for an invalid scene. Raises DeviceError if the board cannot play the scene or is lost.
    """
    target.check()
    if board is not None:
        playable_board(board)
    with bars(progress) as bar:
        bar.add_task("loading the scene", total=None)
        view = preview(scene, board=board, keys=keys)
    model = view.runtime.model
    if model.board.exact:
        raise DeviceError(f"{view.name} uses board '{model.board.name}', which takes no bytes; give another by --board")
    duration = view.duration_s if duration_s is None else duration_s
    spec, head = view.runtime.spec, log_head(model)
    warn_at_head(view, duration)
    limits = SoundLimits.of(spec.driver)
    done = send(scene_frames(view, duration), model.board, duration, target, head, limits, progress)
    notes = [f"board {model.board.name}: {sending(model.board, model.configs)}"]
    for number, stimulus in enumerate(model.stimuli):
        offset = peak_offset(model, number)
        if offset is not None:
            notes.append(f"{stimulus.spec.name}: {offset_words(*offset)}")
    return done.saying(*notes)


def scene_frames(scene: Preview, duration_s: float) -> Iterator[TimedFrame]:
    """Yield the bytes of each frame of a scene, with the poses at its emission and with the ramp of the driver."""
    model = scene.runtime.model
    limits = SoundLimits.of(model.spec.driver)
    ramp, step_s = limits.ramp_times(model.board, duration_s), model.spec.timestep_s if scene.moves else None
    times = frame_times(model.configs, duration_s, step_s, ramp, model.board.frame_time_s)
    frames: Frames | None = None
    for time_s, runtime, posed in scene.posed_at(times):
        frames = frames or Frames(runtime.model, runtime.work.emission)
        data = frames.at(posed, time_s, limits.share(model.board, time_s, duration_s))
        yield TimedFrame(time_s, data, frames.sounds)


def send(
    frames: Iterator[TimedFrame],
    board: Board,
    duration_s: float,
    target: Target,
    head: LogHead,
    limits: SoundLimits,
    progress: bool,
) -> Performance:
    """Send frames, and wait until `duration_s` is over. Return a report, in one sentence."""
    assert board.line is not None
    if target.record is None and target.port is None:
        raise DeviceError("a port or a file is needed; give the port of a board, or a file for the bytes")
    # Make all frames first: errors are raised before files exist, and slow preparations do not delay frames
    ready: list[TimedFrame] = []
    with bars(progress) as bar:
        making = bar.add_task(f"computing the frames for {duration_s:g} s", total=duration_s)
        for one in frames:
            ready.append(one)
            bar.update(making, completed=one.time_s)
    limits.check([frame.time_s for frame in ready], [frame.sounds for frame in ready], duration_s)
    notes = [words] if (words := limits.in_words(board)) else []
    if target.record is not None:
        log = None if target.log is None else FrameLog(target.log, head)
        report = record(board, ready, target.record, duration_s=duration_s, log=log)
        skipped = f"; {report.skipped} more were due than the line can carry" if report.skipped else ""
        text = f"wrote {target.record}: {report.frames} frames for {duration_s:g} s{skipped}"
        return Performance(text, report.warning).saying(*notes)
    assert target.port is not None
    done = play_on_port(ready, board, target.port, duration_s, log=target.log, head=head, progress=progress)
    return done.saying(*notes)


def play_on_port(
    frames: Sequence[tuple[float, bytes] | TimedFrame],
    board: Board,
    port: str,
    duration_s: float,
    *,
    log: Path | None = None,
    head: LogHead | None = None,
    progress: bool = False,
) -> Performance:
    """Play frames by the separate process `palmfield.drive.player`; return a report, in one sentence.

    head: head of the log. Raises DeviceError if the port cannot be opened or is lost.
    """
    if log is not None:
        assert head is not None
        FrameLog(log, head).close()
    console = Console(stderr=True)
    with (
        Player(board, port, log=log, on_trouble=lambda text: console.print(f"palmfield: {text}")) as player,
        bars(progress) as bar,
    ):
        task = bar.add_task(f"playing {duration_s:g} s on {port}", total=duration_s)
        begin = time.monotonic()
        try:
            report = player.play(
                frames,
                duration_s=duration_s,
                on_progress=lambda *_: bar.update(task, completed=time.monotonic() - begin),
            )
        except KeyboardInterrupt:
            player.close()
            LOG.warning(f"ended by Ctrl-C after {time.monotonic() - begin:.1f} s; the board is off")
            check_log(player, log)
            raise
    done = played_in_words(report, board, port)
    check_log(player, log, f"{done}; ")
    return Performance(done, report.warning)


def played_in_words(report: PlayReport, board: Board, port: str) -> str:
    """Return the report of the frames of a player, after the board is off."""
    return (
        f"played {report.frames} frames on {port} (skipped {report.skipped}, largest delay "
        f"{1e3 * report.late_s:.0f} ms, limit {board.frame_rate} frames/s; player at {report.priority}); the board "
        "is off"
    )


def check_log(player: Player, log: Path | None, done: str = "") -> None:
    """Raise OutputError if the log of a closed player is incomplete, e.g. because the disk is full.

    done: other results
    """
    if player.log_error:
        raise OutputError(
            f"{done}the log {log} ends early: {player.log_error}; its content can be decoded, and the play was not "
            "affected"
        )
