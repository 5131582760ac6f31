"""What `palmfield trial` does with its options."""

import sys
from pathlib import Path

from palmfield.cli.as_json import print_json
from palmfield.errors import SceneError
from palmfield.given_files import regular
from palmfield.motion.replaying import address_by
from palmfield.motion.tracking import column_names
from palmfield.studies.trial import Live, Tracker, read_recording, trial


def run_trial(
    scene: Path,
    out: Path,
    *,
    board: str | None,
    port: str | None,
    duration_s: float | None,
    motion: Path | None,
    live: str | None,
    align: Path | None,
    rate_Hz: float,
    latency_ms: float,
    noise_mm: float,
    ahead: str,
    truth: Path | None,
    recording: Path | None,
    skin: bool,
    keys: dict[str, str],
    overwrite: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Run a trial, print what it says, and where its files are. Raises KeyboardInterrupt after one that was cut off."""
    given: dict[str, object] = dict(keys)
    if motion is not None:
        given |= motion_keys(motion)
    tracker = Tracker(rate_Hz, 1e-3 * latency_ms, 1e-3 * noise_mm, ahead_s=_ahead_s(ahead))
    heard = None if recording is None else read_recording(recording)
    if align is not None and live is None:
        raise SceneError("--align belongs to --live: a scene has key tracking_alignment of palmfield.motion")
    if motion is not None and live is not None:
        raise SceneError("--motion and --live both move the hand; give one")
    result = trial(
        scene, board=board, port=port, tracker=tracker, keys=given, duration_s=duration_s, truth=truth,
        recording=heard, skin=skin, out=out, overwrite=overwrite,
        live=None if live is None else listening_at(live, align), progress=not quiet,
    )  # fmt: skip
    if as_json:
        print_json(
            result.numbers.as_dict() | ({} if result.compared is None else {"recording": result.compared.as_dict()})
        )
    else:
        print(result)
        for path in () if quiet else result.files.values():
            print(f"wrote {path}")
    if result.interrupted:
        raise KeyboardInterrupt


def listening_at(text: str, align: Path | None) -> Live:
    """Where `--live` says that samples come in."""
    host, port, by = address_by(text)

    def told(host: str, port: int) -> None:
        print(f"listening for a tracker at {host}:{port} by {by}", file=sys.stderr, flush=True)

    return Live(host, port, by, align, on_listening=told)


def motion_keys(path: Path) -> dict[str, object]:
    """Keys that give a scene's only palmfield.motion a recorded motion. Raises SceneError for a file that is none."""
    try:
        with regular(path).open("rb") as file:
            begin = file.read(4096)
    except OSError as error:
        raise SceneError(f"--motion {path} cannot be read: {error.strerror}; give a CSV or NPZ table") from None
    # A tracker's stream has columns of its joints, a table of poses those of the hand and its angles
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
