"""Play a scene or a focus on a real board, or record the bytes."""

import math
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import Progress

from palmfield.acoustics.arrays import layout
from palmfield.acoustics.focus import focus
from palmfield.drive.boards.sonicsurface import OFF_FRAME, encode
from palmfield.drive.device import DEVICES
from palmfield.drive.foci import solve_foci
from palmfield.drive.link import Played, RecordLink, open_link, play_frames
from palmfield.errors import DeviceError
from palmfield.scene import Scene, load
from palmfield.stimulus.schedule import frame_at, frame_rates, jumps
from palmfield.types import Air, Array, Complex, Float

BOARDS = ("sonicsurface",)
REFRESH_S = 0.1


def play_focus(
    point: tuple[float, float, float], board: str, port: str | None, record: Path | None, time_s: float
) -> str:
    """Hold one focus (array frame [m]) for `time_s`; returns what happened, in a sentence.

    Raises SceneError for a focus behind the array, DeviceError for an unknown or lost board.
    """
    _check_board(board)
    frame = encode(focus(layout(board), Air(), np.array(point)))
    return _play(_refreshed(frame, time_s), time_s, port, record)


def play_scene(path: Path, board: str, port: str | None, record: Path | None, time_s: float | None) -> str:
    """Play a scene's stimulus; frames of a site other than `array` are taken in the scene's initial pose.

    Raises SceneError for a bad scene, DeviceError where the board cannot play it or is lost.
    """
    _check_board(board)
    scene = load(path, board=board)
    duration = scene.duration_s if time_s is None else time_s
    return _play(scene_frames(scene, duration), duration, port, record)


def scene_frames(scene: Scene, duration_s: float) -> Iterator[tuple[float, bytes]]:
    """The bytes of each frame of a scene with its time [s]; silence as off frames, and an off frame at the end."""
    stimulus, rig = scene.skin.rig.stimulus, scene.skin.rig
    rates = frame_rates(stimulus)
    step = 1.0 / max(rates) if rates else REFRESH_S
    edges = {t for t in jumps(stimulus, 0.0, duration_s) if 0 < t < duration_s}
    times = sorted({k * step for k in range(math.ceil(duration_s / step - 1e-9))} | edges)
    for t in times:
        frame = frame_at(stimulus, t)
        if frame.arp_factor == 0.0:
            yield t, OFF_FRAME
        else:
            yield t, encode(drive_for(rig.array, rig.air, scene.skin.to_array(frame.focus)))
    yield duration_s, OFF_FRAME


def drive_for(array: Array, air: Air, foci: Float) -> Complex:
    """Complex amplitude of each transducer for one focus [m], shape (3,), or several at once, shape (m, 3)."""
    return focus(array, air, foci) if foci.ndim == 1 else solve_foci(foci, array, air).drive


def _refreshed(frame: bytes, time_s: float) -> Iterator[tuple[float, bytes]]:
    """A still frame, sent again ten times a second so that a byte lost on the line does no lasting harm."""
    for k in range(math.ceil(time_s / REFRESH_S - 1e-9)):
        yield k * REFRESH_S, frame
    yield time_s, OFF_FRAME


def _check_board(board: str) -> None:
    if board not in BOARDS:
        raise DeviceError(f"board '{board}' is not known; allowed: {', '.join(BOARDS)}")


def _play(frames: Iterator[tuple[float, bytes]], time_s: float, port: str | None, record: Path | None) -> str:
    if record is not None:
        with closing(RecordLink(record)) as link:
            played = play_frames(link, frames)
        return f"wrote {record}: {played.frames} frames for {time_s:g} s"
    assert port is not None
    limit = DEVICES["sonicsurface"].max_frame_rate_Hz
    with closing(open_link(port)) as serial_link, Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(f"playing {time_s:g} s on {port}", total=time_s)
        begin = serial_link.now()

        def show(played: Played) -> None:
            bar.update(task, completed=serial_link.now() - begin)

        played = play_frames(serial_link, frames, on_progress=show)
    return (
        f"played {played.frames} frames on {port} (skipped {played.skipped}, worst delay {1e3 * played.late_s:.0f} ms, "
        f"limit {limit:.1f} frames/s); the board is off"
    )
