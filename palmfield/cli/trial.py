"""`palmfield trial`: simulate or run the loop from a hand tracker to the sound at the hand."""

from pathlib import Path
from typing import Annotated

import typer

from palmfield.cli.as_json import print_json
from palmfield.cli.options import Align, AsJson, BoardName, Keys, SceneFile, check_duration, listening_at, parsed_keys
from palmfield.errors import SceneError
from palmfield.files import reading, regular


def trial(
    context: typer.Context,
    scene: SceneFile,
    out: Annotated[Path | None, typer.Option(help="folder of the results [default: out/SCENE_trial]")] = None,
    board: BoardName = None,
    port: Annotated[
        str | None,
        typer.Option(
            help="port of a real board, or `virtual` for a virtual board in real time [default: the virtual twin "
            "without waiting: fast and reproducible]"
        ),
    ] = None,
    duration: Annotated[float | None, typer.Option(help="duration [s] [default: from the scene]")] = None,
    motion: Annotated[
        Path | None,
        typer.Option(help="recorded motion in place of that of the scene: a table of poses, or a tracker stream"),
    ] = None,
    live: Annotated[
        str | None,
        typer.Option(
            help="follow a tracked hand whose samples arrive at this port, in place of the motion in the scene (see "
            "`palmfield track`), by UDP or with tcp:[HOST:]PORT by TCP; always in real time",
            metavar="[HOST:]PORT",
        ),
    ] = None,
    align: Align = None,
    tracker_rate: Annotated[
        float, typer.Option(help="tracker samples per second; 0: one sample for each frame")
    ] = 90.0,
    tracker_latency: Annotated[
        float, typer.Option(help="latency of the tracker: age of a sample when it arrives [ms]")
    ] = 10.0,
    tracker_noise: Annotated[
        float, typer.Option(help="tracker noise: standard deviation of each coordinate [mm]")
    ] = 0.0,
    ahead: Annotated[
        str,
        typer.Option(
            help="prediction time beyond the last sample [ms]; 0: no prediction; auto: to the middle of the time that "
            "the frame sounds"
        ),
    ] = "auto",
    truth: Annotated[
        Path | None,
        typer.Option(help="calibration file of the true transducers, if they differ from those of the scene"),
    ] = None,
    recording: Annotated[
        Path | None,
        typer.Option(
            help="CSV file of a microphone or vibrometer recording to compare with the trial (docs/trials.md)"
        ),
    ] = None,
    skin: Annotated[bool, typer.Option(help="compute the motion of the skin, with and without these losses")] = True,
    keys: Keys = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="replace the results of another trial in the folder")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Run the closed loop from tracker to board, and compute the sound at the true position of the hand.

    The report gives the distance of the focus from the hand, and the number of dropped frames. It also gives the
    pressure lost by latency, by rounding of the board, and by transducers that differ from the scene (--truth). The
    files are sent.jsonl (for decode and replay), course.csv, trial.json and trial.png. Ctrl-C keeps the results so far.
    If the board cannot play the scene, the exit code is 2.

    Examples: palmfield trial mjcf/scenes/follow_fingertip.xml --board autd2018

    palmfield trial mjcf/scenes/follow_fingertip.xml --board sonicsurface --set stimulus.modulation=none --port virtual
    """
    from palmfield.studies.trial import Tracker, read_recording
    from palmfield.studies.trial import trial as play_trial

    check_duration(duration)
    changed: dict[str, object] = dict(parsed_keys(keys))
    if motion is not None:
        changed |= motion_keys(motion)
    tracker = Tracker(tracker_rate, 1e-3 * tracker_latency, 1e-3 * tracker_noise, ahead_s=_ahead_s(ahead))
    measured = None if recording is None else read_recording(recording)
    if motion is not None and live is not None:
        raise SceneError("--motion and --live both move the hand; give one")
    result = play_trial(
        scene, board=board, port=port, tracker=tracker, keys=changed, duration_s=duration, truth=truth,
        recording=measured, skin=skin, out=out or Path("out") / f"{scene.stem}_trial", overwrite=overwrite,
        live=listening_at(live, align), progress=not context.obj,
    )  # fmt: skip
    if as_json:
        print_json(
            result.numbers.as_dict() | ({} if result.compared is None else {"recording": result.compared.as_dict()})
        )
    else:
        print(result)
        for path in () if context.obj else result.files.values():
            print(f"wrote {path}")
    if result.interrupted:
        raise KeyboardInterrupt


def motion_keys(path: Path) -> dict[str, object]:
    """Return keys that set a recorded motion for the only palmfield.motion instance.

    Raises SceneError for an invalid file.
    """
    from palmfield.motion.tracking import column_names

    with reading(f"--motion {path}", SceneError, "a CSV or NPZ table"), regular(path).open("rb") as file:
        begin = file.read(4096)
    # A tracker stream has columns of joints; a table of poses has columns of the hand and its angles
    kind = "tracking" if column_names()[1].encode() in begin else "trajectory"
    sources = dict.fromkeys(("motion.keyframes", "motion.trajectory", "motion.tracking", "motion.function"))
    return {**sources, f"motion.{kind}": str(path.resolve())}


def _ahead_s(text: str) -> float | None:
    if text == "auto":
        return None
    try:
        return 1e-3 * float(text)
    except ValueError:
        raise SceneError(f"--ahead has value '{text}'; allowed: auto, or milliseconds") from None
