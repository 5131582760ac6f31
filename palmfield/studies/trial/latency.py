"""Measure the time from a tracker sample to the resulting sound, in a loop on this machine."""

import subprocess
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from palmfield.drive.board import Board
from palmfield.errors import DeviceError, SceneError
from palmfield.motion.line_listener import By
from palmfield.motion.tracking import Stream, stream_of, write_stream
from palmfield.session.live_scene import LiveScene
from palmfield.session.preview import Preview, preview
from palmfield.studies.trial.course import Tracker
from palmfield.studies.trial.live import Live, LivePlayed, play_live
from palmfield.studies.trial.sending import Drives
from palmfield.types import Float

LINE_SHARE = 0.95
"""Used fraction of the largest frame rate of the line. On a full line a delay would never decrease."""
LEAD_S = 1.0
"""Time before and after the loop in which samples are also sent [s]."""
ALLOWED_S = 0.040
"""Delay of touch after movement that users notice [s] (quoted by Hasegawa & Shinoda 2018)."""
TRACKERS_OWN_S = 0.008, 0.011


@dataclass(frozen=True)
class Latency:
    """Statistics of the time from the sending of a sample until the board emits its frame, over a loop.

    frames: number of sent frames
    dropped: number of frames that were due but not sent
    samples: number of received samples
    p50_ms, p95_ms, largest_ms: median, 95th percentile and largest latency [ms]
    fit_ms: median time to fit the hand to a sample [ms]
    line_ms: time of a frame on the line [ms]
    """

    board: str
    seconds: float
    rate_Hz: float
    by: str
    frames: int
    dropped: int
    samples: int
    p50_ms: float
    p95_ms: float
    largest_ms: float
    line_ms: float
    notes: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)

    def __str__(self) -> str:
        low, high = (1e3 * value for value in TRACKERS_OWN_S)
        lines = [
            f"delay from sending a sample to its sound on a virtual {self.board}: {self.frames} frames in "
            f"{self.seconds:g} s, {100 * LINE_SHARE:.0f} % of the capacity of the line ({self.dropped} dropped), "
            f"{self.samples} samples at {self.rate_Hz:g} per second by {self.by}:",
            f"median {self.p50_ms:.1f} ms, 95 % {self.p95_ms:.1f} ms, largest {self.largest_ms:.1f} ms; a frame on the "
            f"line takes {self.line_ms:.1f} ms",
            f"with a tracker latency of {low:g} to {high:g} ms: {self.p95_ms + low:.0f} to "
            f"{self.p95_ms + high:.0f} ms at 95 %; a lag of {1e3 * ALLOWED_S:g} ms is noticeable",
        ]
        return "\n".join([*lines, *self.notes])


def measure_latency(
    scene: str | Path,
    *,
    board: str | None = None,
    keys: Mapping[str, object] | None = None,
    seconds: float = 5.0,
    rate_Hz: float = 90.0,
    by: By = "udp",
) -> Latency:
    """Send the motion of the hand of a scene from another process, and let a virtual board follow it.

    Each sample has its sending time, on the clock that both processes share. Raises SceneError for a scene without a
    moving hand, and DeviceError for a board without a line.
    """
    if not 0.2 <= seconds <= 600.0:
        raise SceneError(f"--seconds has value {seconds:g}; allowed: 0.2 to 600")
    if not 1.0 <= rate_Hz <= 1000.0:
        raise SceneError(f"--rate has value {rate_Hz:g}; allowed: 1 to 1000")
    view = preview(scene, device="cpu", board=board, keys=keys)
    played_by = view.runtime.model.board
    if not played_by.exact:
        at_line_rate = {"stimulus.control_rate_Hz": LINE_SHARE * played_by.max_frame_rate_Hz}
        view = preview(scene, device="cpu", board=board, keys={**(keys or {}), **at_line_rate})
    else:
        raise DeviceError(f"{view.name} uses board '{played_by.name}', which has no line; give another by --board")
    with TemporaryDirectory() as folder:
        file = Path(folder) / "hand.npz"
        write_stream(file, scene_stream(view, rate_Hz, seconds + 2.0 * LEAD_S))
        started: list[subprocess.Popen[bytes]] = []

        def begin(host: str, port: int) -> None:
            words = ["track", "replay", str(file), "--to", f"{host}:{port}", "--by", by, "--stamp", "--repeat", "20"]
            run = "from palmfield.cli.app import main; main()"
            started.append(
                subprocess.Popen(
                    [sys.executable, "-c", run, *words], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
                )
            )

        try:
            live = Live(by=by, up="z", wait_s=60.0, on_listening=begin)
            played = play_live(view, live, Tracker(latency_s=0.0, ahead_s=0.0), seconds, view.runtime.model.sounding)
        finally:
            for process in started:
                process.kill()
                process.wait()
    late = latencies(played, played_by)
    if not len(late):
        raise DeviceError("no frame of a sample was emitted; close other programs on this machine")
    return Latency(
        board=played_by.name,
        seconds=seconds,
        rate_Hz=rate_Hz,
        by=by,
        frames=len(played.sent.frames),
        dropped=played.sent.dropped,
        samples=len(played.stream),
        p50_ms=1e3 * float(np.median(late)),
        p95_ms=1e3 * float(np.percentile(late, 95)),
        largest_ms=1e3 * float(late.max()),
        line_ms=1e3 * played_by.frame_time_s,
        notes=tuple(played.notes),
    )


def latencies(played: LivePlayed, board: Board) -> Float:
    """Return for each emitted frame the time from its sample to its sound [s]."""
    drives = Drives(played.sent, board)
    result: dict[int, float] = {}
    for time_s in drives.times:
        found = drives.at(float(time_s))
        if found is not None:
            result.setdefault(found[1].number, float(time_s) - found[1].frame.sample_s)
    return np.array(list(result.values()))


def scene_stream(view: Preview, rate_Hz: float, seconds: float) -> Stream:
    """Return error-free samples, z up, of the hand of a scene. Its motion runs forwards and backwards."""
    scene = LiveScene(view)
    times = np.arange(0.0, seconds, 1.0 / rate_Hz)
    # Forwards and backwards, so that it repeats without a jump
    phase = times % (2.0 * view.duration_s)
    own = np.where(phase > view.duration_s, 2.0 * view.duration_s - phase, phase)
    stream = stream_of(scene.hand, scene.script, own)
    return Stream(times, stream.positions, stream.quaternions, stream.radii, stream.flags)
