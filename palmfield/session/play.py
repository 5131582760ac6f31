"""Play a scene or a focus on a real board, or record the bytes."""

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import Progress

from palmfield.acoustics.arrays import layout
from palmfield.acoustics.focus import focus
from palmfield.config.stimulus import too_far
from palmfield.drive.boards import Board
from palmfield.drive.link import open_link
from palmfield.drive.playback import (
    Played,
    TimedFrame,
    frame_times,
    play_frames,
    playable_board,
    record,
    timed_frames,
)
from palmfield.errors import DeviceError, SceneError
from palmfield.session.load import Source
from palmfield.session.preview import Preview, preview
from palmfield.types import Air, Complex


def play_focus(
    point: tuple[float, float, float],
    board: str,
    port: str | None,
    record_to: Path | None,
    duration_s: float,
    *,
    progress: bool = False,
) -> str:
    """Hold one focus (array frame [m]) for `duration_s`; returns what happened, in a sentence.

    progress: whether a bar is drawn on a terminal's standard error

    Raises SceneError for a focus behind the array or too far for metres, DeviceError for an unknown or lost board.
    """
    chosen = playable_board(board)
    assert chosen.layout is not None
    if (far := too_far(point)) is not None:
        raise SceneError(f"--focus has value {' '.join(f'{x:g}' for x in point)}, {far}")
    drive = focus(layout(chosen.layout), Air(), np.array(point))
    frames = timed_frames(chosen, frame_times([], duration_s), lambda time_s: drive, duration_s)
    return _play(frames, chosen, duration_s, port, record_to, progress)


def play_scene(
    scene: Source,
    board: str,
    port: str | None,
    record_to: Path | None,
    duration_s: float | None = None,
    *,
    progress: bool = False,
) -> str:
    """Play a scene's stimulus; what moves in the scene stays where it is at the beginning.

    Raises SceneError for a bad scene, DeviceError where the board cannot play it or is lost.
    """
    chosen = playable_board(board)
    view = preview(scene, board=board)
    duration = view.duration_s if duration_s is None else duration_s
    return _play(scene_frames(view, duration), chosen, duration, port, record_to, progress)


def scene_frames(scene: Preview, duration_s: float) -> Iterator[TimedFrame]:
    """The bytes of each frame of a scene, as the simulation emits them, and an off frame at the end."""
    runtime = scene.runtime
    posed, emission = runtime.posed, runtime.work.emission

    def drive_at(time_s: float) -> Complex:
        return emission.commanded(posed, np.array([time_s]))[0]

    configs = [stimulus.config for stimulus in runtime.model.stimuli]
    return timed_frames(runtime.model.board, frame_times(configs, duration_s), drive_at, duration_s)


def _play(
    frames: Iterator[TimedFrame],
    board: Board,
    duration_s: float,
    port: str | None,
    record_to: Path | None,
    progress: bool,
) -> str:
    if record_to is not None:
        played = record(frames, record_to)
        return f"wrote {record_to}: {played.frames} frames for {duration_s:g} s"
    if port is None:
        raise DeviceError("neither a port nor a file is given; give the port of a board, or a file for the bytes")
    console = Console(stderr=True)
    hidden = not (progress and console.is_terminal)
    with closing(open_link(port)) as link, Progress(console=console, disable=hidden, transient=True) as bar:
        task = bar.add_task(f"playing {duration_s:g} s on {port}", total=duration_s)
        begin = link.now()

        def show(played: Played) -> None:
            bar.update(task, completed=link.now() - begin)

        played = play_frames(link, frames, on_progress=show)
    return (
        f"played {played.frames} frames on {port} (skipped {played.skipped}, worst delay {1e3 * played.late_s:.0f} ms, "
        f"limit {board.max_frame_rate_Hz:.1f} frames/s); the board is off"
    )
