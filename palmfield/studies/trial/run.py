"""Run a trial of a scene: hand, tracker, focus, bytes, board, sound at the true hand, and motion of the skin."""

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from palmfield.acoustics.calibration_file import Calibration, read_calibration, write_calibration
from palmfield.drive.board import Board, Emitted
from palmfield.drive.frame_log import FrameLog
from palmfield.drive.limits import SoundLimits
from palmfield.drive.playback import frame_times
from palmfield.drive.ports import check_port
from palmfield.errors import DeviceError, OutputError
from palmfield.files import made_folder, write_text
from palmfield.hardware.log_head import log_head
from palmfield.hardware.safety.scene_sound import warn_at_head
from palmfield.interrupts import interrupts_delayed
from palmfield.motion.tracking import write_stream
from palmfield.outputs.trial_picture import draw_trial
from palmfield.session.preview import Preview, preview
from palmfield.simulation.emission import Emission
from palmfield.simulation.frames import Frames
from palmfield.simulation.model import HapticModel
from palmfield.studies.trial.course import PoseEstimator, SceneCourse, Tracker
from palmfield.studies.trial.field import TrialMoment, TrueSound, focus_in, last_due, level_of, same_level
from palmfield.studies.trial.live import Live, play_live
from palmfield.studies.trial.recording import Compared, Recording, compare
from palmfield.studies.trial.report import Numbers, as_text, numbers_of, table_of
from palmfield.studies.trial.sending import VIRTUAL, Drives, MadeFrame, Sent, send
from palmfield.studies.trial.skin_response import SkinResponse, skin_response
from palmfield.tables import write_table
from palmfield.terminal import bars

FINEST_S = 1e-3
"""Largest interval between times at which the sound at the hand is computed [s]."""
FILES = "sent.jsonl", "course.csv", "trial.json", "trial.png"


@dataclass(frozen=True)
class Trial:
    """Result of a trial.

    numbers: numbers of the whole trial
    moments: results over time
    sent: frames sent to the board
    skin, skin_ideal: motion of the skin with and without latency, rounding and calibration error, None if not requested
    compared: comparison with a recording
    files: written files by name
    interrupted: whether Ctrl-C ended the trial early
    """

    numbers: Numbers
    moments: list[TrialMoment]
    sent: Sent
    skin: SkinResponse | None
    skin_ideal: SkinResponse | None
    compared: Compared | None = None
    files: dict[str, Path] = field(default_factory=dict)

    @property
    def interrupted(self) -> bool:
        return self.sent.interrupted

    def __str__(self) -> str:
        return as_text(self.numbers, self.compared)


def trial(
    scene: str | Path,
    *,
    board: str | None = None,
    port: str | None = None,
    tracker: Tracker | None = None,
    keys: Mapping[str, object] | None = None,
    duration_s: float | None = None,
    truth: str | Path | None = None,
    recording: Recording | None = None,
    live: Live | None = None,
    skin: bool = True,
    flight: bool = True,
    out: str | Path | None = None,
    overwrite: bool = False,
    progress: bool = False,
) -> Trial:
    """Simulate tracker, board and hand of a scene in closed loop. Report the focus error and the loss of pressure.

    board, keys: as in `palmfield.load`; port: as in `palmfield.studies.trial.sending.send`
    tracker: simulated tracker (default: 90 Hz, latency 10 ms, extrapolation to the middle of each frame)
    live: source of tracker samples that replace the motion of the scene; the trial then runs in real time
    truth: calibration file of the true transducers, if they differ from the scene
    skin: whether the skin is stepped; flight: whether the flight time of sound to the hand is included
    out: folder for FILES, created if missing; None: no files
    Ctrl-C ends the trial early with the results so far (`interrupted`). Raises SceneError for an invalid scene. Raises
    DeviceError if the board cannot play it or is lost, and, with a port, if the sound at a head would exceed the key
    head_limit_dB. Raises OutputError if the folder contains another trial.
    """
    if port is not None and port != VIRTUAL:
        check_port(port)
    folder = None if out is None else _folder(Path(out), overwrite)
    changed = dict(keys or {})
    view = preview(scene, device="cpu", board=board, keys=changed)
    real = None if truth is None else read_calibration(truth)
    played = view.runtime.model.board
    if played.exact and (port is not None or live is not None):
        raise DeviceError(
            f"{view.name} uses board '{played.name}', which takes no bytes and has no port; give another by --board"
        )
    duration = view.duration_s if duration_s is None else duration_s
    if port is not None:
        warn_at_head(view, duration)
    watched = tracker or Tracker()
    with TemporaryDirectory() as spare, _bar(progress) as show_stage:
        log = None if folder is None or played.exact else FrameLog(folder / "sent.jsonl", log_head(view.runtime.model))
        way = _Way(watched, duration, real, flight, port, log, show_stage)
        if live is None:
            done = _scripted(view, way)
        else:
            done = _followed(view, scene, board, changed, live, way, Path(spare) if folder is None else folder)
            changed |= done.keys
        sent, drives = done.sent, Drives(done.sent, played)
        moments = _course(sent, _moments(done.sound.course, duration), done.times, drives, done.sound, show_stage)
        motion = ideal_motion = None
        if skin and moments and not sent.interrupted:
            show_stage("computing the skin under the emitted sound", None)
            motion, ideal_motion = _skins(scene, board, changed, done, moments, real, recording)
    numbers = numbers_of(
        view.name, played, done.sound, sent, moments, watched, duration, motion, ideal_motion, port, real,
        [*sent.notes, *done.notes],
    )  # fmt: skip
    compared = None
    if recording is not None and not sent.interrupted:
        compared = compare(recording, moments, done.sound, drives, motion)
    result = Trial(numbers, moments, sent, motion, ideal_motion, compared)
    return result if folder is None else replace(result, files=_written(result, folder, log is not None))


class _Done(NamedTuple):
    """Frames sent, and the motion of the scene for which they were sent.

    times: times at which frames were due [s]
    notes: remarks on the tracker
    keys: keys with which the scene repeats its motion
    """

    sound: TrueSound
    sent: Sent
    times: list[float]
    notes: list[str]
    keys: dict[str, object]


class _Way(NamedTuple):
    """Settings of a trial; see `trial`.

    log: log of frames; show_stage: function that shows the present task and progress
    """

    tracker: Tracker
    duration_s: float
    truth: Calibration | None
    flight: bool
    port: str | None
    log: FrameLog | None
    show_stage: "ShowStage"


def _scripted(view: Preview, way: _Way) -> _Done:
    """Send a scene with scripted motion, which is estimated by a simulated tracker."""
    tracker, duration_s, truth, flight, port, log, show_stage = way
    show_stage("stepping the scene", None)
    course = SceneCourse(view, duration_s)
    board, limits = course.model.board, SoundLimits.of(course.model.spec.driver)
    sound = TrueSound(course, course.model.sounding, truth, flight=flight, share=_share(course.model, duration_s))
    times = _due(course, board, duration_s)
    make = _maker(course, sound, PoseEstimator(course, tracker), times, duration_s)
    show_stage("sending", duration_s)
    sent = send(
        board, times, make, duration_s, port=port, log=log, limits=limits, on_progress=lambda at: show_stage(None, at)
    )
    return _Done(sound, sent, times, [], {})


def _followed(
    view: Preview, scene: str | Path, board: str | None, keys: Mapping[str, object], live: Live, way: _Way, folder: Path
) -> _Done:
    """Send a scene that follows the hand of a live tracker, then repeat the scene with the recorded samples."""
    tracker, duration_s, truth, flight, port, log, show_stage = way
    show_stage("following the hand", duration_s)
    number = view.runtime.model.sounding
    played = play_live(
        view, live, tracker, duration_s, number, port=port, log=log, on_progress=lambda at: show_stage(None, at)
    )
    show_stage("computing the scene with the tracked motion", None)
    write_stream(folder / "tracked.npz", played.stream)
    own = live.keys(played.motion, folder / "tracked.npz", played.start_s)
    replayed = preview(scene, device="cpu", board=board, keys={**keys, **own})
    course = SceneCourse(replayed, duration_s, as_far_as_it_goes=True)
    notes = list(played.notes)
    if course.refused:
        notes.append(f"the sound at the hand is computed up to {course.end_s:.3f} s: {course.refused}")
        played.sent.end_s = min(played.sent.end_s, course.end_s)
    sound = TrueSound(course, number, truth, flight=flight, share=_share(course.model, duration_s))
    return _Done(sound, played.sent, played.times, notes, own)


def _share(model: HapticModel, duration_s: float) -> Callable[[float], float]:
    """Return the function that gives the ramp factor of the driver for all amplitudes at a time of the trial [s]."""
    limits = SoundLimits.of(model.spec.driver)
    return lambda time_s: limits.share(model.board, time_s, duration_s)


def _maker(
    course: SceneCourse, sound: TrueSound, estimator: PoseEstimator, times: list[float], duration_s: float
) -> Callable[[float, float], MadeFrame]:
    """Return the function that makes each frame from the estimated pose at its time."""
    frames, afterwards = (Frames(course.model, Emission(course.model)) for _ in range(2))
    exact = course.model.board.exact
    ends = np.append(times[1:], duration_s)
    flight_s = sound.flight_s(sound.focus(0.0, 0.0))

    def make(now_s: float, due_s: float) -> MadeFrame:
        nonlocal flight_s
        until_s = float(ends[np.searchsorted(times, due_s)])
        middle_s = due_s if exact else 0.5 * (due_s + until_s)
        posed, sample_s = estimator.at(now_s, middle_s + flight_s)
        share = sound.share(due_s)
        data = b"" if exact else frames.at(posed, due_s, share)
        focus = focus_in(course.model, sound.number, posed, due_s)
        flight_s = sound.flight_s(focus)
        sounds = exact or frames.sounds
        return MadeFrame(data, focus, sample_s, lambda: share * afterwards.target(posed, due_s), sounds)

    return make


def _moments(course: SceneCourse, duration_s: float) -> list[float]:
    """Return the times at which the sound at the hand is computed [s]."""
    parts = max(1, round(course.step_s / FINEST_S))
    step_s = course.step_s / parts
    return [step_s * n for n in range(int(duration_s / step_s + 1e-6))]


def _due(course: SceneCourse, board: Board, duration_s: float) -> list[float]:
    """Return the times at which frames are due [s]. For a board without limits they are those of `_moments`."""
    if board.exact and course.moves:
        return _moments(course, duration_s)
    ramp = SoundLimits.of(course.model.spec.driver).ramp_times(board, duration_s)
    step_s = course.step_s if course.moves else None
    return frame_times(course.model.configs, duration_s, step_s, ramp, board.frame_time_s)


def _course(
    sent: Sent, moments_s: list[float], times: list[float], drives: Drives, sound: TrueSound, show_stage: "ShowStage"
) -> list[TrialMoment]:
    """Compute the sound at the hand for the trial so far. After Ctrl-C, the computed part is kept."""
    loudest = max((level_of(one.frame.target) for one in sent.frames), default=0.0)
    moments = []
    show_stage("computing the sound at the hand", moments_s[-1] if moments_s else None)
    try:
        with interrupts_delayed() as check:
            for time_s in moments_s:
                if time_s > sent.end_s:
                    break
                moment = sound.moment(time_s, times, drives, loudest)
                if moment is not None:
                    moments.append(moment)
                show_stage(None, time_s)
                check()
    except KeyboardInterrupt:
        sent.interrupted = True
    return moments


def _skins(
    scene: str | Path,
    board: str | None,
    keys: dict[str, object],
    done: _Done,
    moments: list[TrialMoment],
    truth: Calibration | None,
    recording: Recording | None,
) -> tuple[SkinResponse, SkinResponse]:
    """Step the skin twice: under the emitted sound of the true array, and under the ideal sound for the true hand."""
    end_s = moments[-1].time_s
    # Target of the focus, and positions of recordings
    places = np.array([moments[0].true, *([] if recording is None else [recording.place_m])])
    sound, times = done.sound, done.times
    grid = sorted({*times, *(one.time_s for one in moments)})
    ideal = [Emitted(time_s, sound.ideal(time_s, last_due(times, time_s))) for time_s in grid if time_s <= end_s]
    flight_s = sound.flight_s(moments[len(moments) // 2].true)
    emitted = [Emitted(one.time_s + flight_s, one.amplitudes) for one in done.sent.emitted]
    with TemporaryDirectory() as made:
        own = dict(keys)
        if truth is not None:
            spec = sound.model.spec.arrays[0]
            file = Path(made) / "as_it_is.json"
            write_calibration(file, same_level(truth, spec.calibration))
            own[f"{spec.name}.calibration"] = str(file)
        played = skin_response(scene, emitted, end_s, board=board, keys=own, places=places)
    return played, skin_response(scene, ideal, end_s, board=board, keys=keys, places=places)


def _folder(out: Path, overwrite: bool) -> Path:
    """Create the folder. Raises OutputError if it contains another trial or cannot be created."""
    there = [name for name in FILES if (out / name).exists()]
    if there and not overwrite:
        raise OutputError(f"{out} contains another trial ({there[0]}); give another folder, or --overwrite")
    return made_folder(out)


def _written(result: Trial, folder: Path, logged: bool) -> dict[str, Path]:
    """Write the table, the numbers and the picture; return the files."""
    files = {name: folder / name for name in FILES if name != "sent.jsonl" or logged}
    names, rows = table_of(result.moments, result.skin)
    write_table(files["course.csv"], names, rows)
    numbers = result.numbers.as_dict()
    if result.compared is not None:
        numbers["recording"] = result.compared.as_dict()
    write_text(files["trial.json"], json.dumps(numbers, indent=1) + "\n")
    draw_trial(names, rows, numbers, files["trial.png"])
    return files


ShowStage = Callable[[str | None, float | None], None]


@contextmanager
def _bar(show: bool) -> Iterator[ShowStage]:
    """Show the present task and its progress on the standard error of a terminal."""
    with bars(show) as bar:
        task = bar.add_task("opening the scene", total=None)

        def show_stage(what: str | None, number: float | None) -> None:
            if what is None:
                bar.update(task, completed=number or 0.0)
            else:
                bar.reset(task, description=what, total=number)

        yield show_stage
