"""`palmfield track`: replay and record tracker samples, align a tracker, measure the latency."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from palmfield.cli.as_json import print_json
from palmfield.cli.options import group
from palmfield.errors import SceneError, refuse_unknown

track = group(
    "track",
    "Send, record and align hand-tracker samples: one JSON line per sample over a socket, with OpenXR or LeapC "
    "names (docs/trials.md). `palmfield trial SCENE --live PORT` follows such a hand.\n\nExample: palmfield track "
    "replay seen.npz --to 127.0.0.1:9100",
)
By = Annotated[str, typer.Option(help="protocol: udp (one sample per datagram) or tcp (one sample per line)")]


@track.command("replay")
def replay(
    file: Annotated[Path, typer.Argument(help="recorded stream, CSV or NPZ (docs/motion.md)", metavar="FILE")],
    to: Annotated[str, typer.Option(help="address of the receiver", metavar="HOST:PORT")],
    by: By = "udp",
    convention: Annotated[str, typer.Option(help="names, units and frames of the samples: openxr or leapc")] = "openxr",
    speed: Annotated[float, typer.Option(help="playback speed; 2 is twice as fast")] = 1.0,
    repeat: Annotated[int, typer.Option(help="number of repetitions")] = 1,
    stamp: Annotated[
        bool, typer.Option("--stamp", help="time-stamp samples when they are sent, by this machine's monotonic clock")
    ] = False,
) -> None:
    """Send a recorded hand motion in real time to a program that receives tracker samples.

    Example: palmfield track replay seen.npz --to 127.0.0.1:9100 --convention leapc
    """
    from palmfield.motion.replaying import address
    from palmfield.motion.replaying import replay as send
    from palmfield.motion.tracking import read_stream
    from palmfield.motion.wire import CONVENTIONS

    refuse_unknown(SceneError, "--convention has value {}", convention, CONVENTIONS)
    names: Literal["openxr", "leapc"] = "leapc" if convention == "leapc" else "openxr"
    kind, where = checked_by(by), address(to)
    sent = send(read_stream(file), where, by=kind, convention=names, speed=speed, repeat=repeat, stamp=stamp)
    print(f"sent {sent} samples to {where[0]}:{where[1]} by {kind}")


@track.command("record")
def record(
    out: Annotated[Path, typer.Argument(help="CSV or NPZ file to write", metavar="FILE")],
    at: Annotated[str, typer.Option(help="address that receives the samples", metavar="[HOST:]PORT")] = "9100",
    by: By = "udp",
    duration: Annotated[float, typer.Option(help="duration from the first sample [s]; Ctrl-C ends it earlier")] = 10.0,
    wait: Annotated[float, typer.Option(help="longest wait for the first sample [s]")] = 30.0,
) -> None:
    """Receive tracker samples and write them to a file; invalid samples are reported and skipped.

    Example: palmfield track record seen.npz --at 9100 --duration 20
    """
    import time

    from palmfield.motion.listening import Listener
    from palmfield.motion.replaying import address
    from palmfield.motion.tracking import write_stream

    host, port = address(at)
    with Listener(host, port, checked_by(by)) as listener:
        print(f"listening at {listener.host}:{listener.port} by {by}", flush=True)
        try:
            if listener.wait(0, wait):
                time.sleep(duration)
        except KeyboardInterrupt:
            pass
        for line in (listener.report(), *listener.reported):
            print(line)
        if listener.received < 2:
            raise SceneError(
                f"only {listener.received} valid samples arrived within {wait:g} s; needed: 2 or more; check the "
                "address and the format of the tracker"
            )
        write_stream(out, listener.stream())
        print(f"wrote {out}")
        listener.check()


@track.command("align")
def align(
    points: Annotated[
        Path,
        typer.Argument(
            help="CSV file of touched points: array_x_m, array_y_m, array_z_m, tracker_x_m, ...", metavar="POINTS"
        ),
    ],
    out: Annotated[Path, typer.Argument(help="JSON file to write", metavar="OUT.json")],
) -> None:
    """Determine the pose of a tracker relative to an array from three or more touched points.

    Touch known points of the array with the tip of the index finger. At least three points are needed, not on one line;
    better are the four corners, the centre, and one point on an object at least 20 mm high. The table has a row for
    each point: its position in the frame of the array, and the position of joint index_tip from the tracker, in metres.
    Key `tracking_alignment` of palmfield.motion and `palmfield trial --align` read the result.

    Example: palmfield track align touches.csv tracker.json
    """
    from palmfield.motion.alignment import align as fitted
    from palmfield.motion.alignment import read_touches, write_alignment

    made = fitted(read_touches(points))
    write_alignment(out, made)
    print(made)
    print(f"wrote {out}")


@track.command("latency")
def latency(
    scene: Annotated[
        Path | None, typer.Argument(help="scene with a moving hand [default: follow_fingertip, unmodulated]")
    ] = None,
    board: Annotated[
        str | None, typer.Option(help="board to use instead of that of the scene", metavar="BOARD")
    ] = None,
    seconds: Annotated[float, typer.Option(help="duration [s]")] = 5.0,
    rate: Annotated[float, typer.Option(help="samples per second")] = 90.0,
    by: By = "udp",
    as_json: Annotated[bool, typer.Option("--json", help="print JSON only")] = False,
) -> None:
    """Measure the delay from a tracker sample to the resulting sound, with a virtual board.

    Another process replays the hand of the scene over a socket. The hand is fitted to each sample, and frames are made
    and sent through a port. A virtual board emits them at the rate of a real line. The latency of the tracker itself is
    not included.

    Example: palmfield track latency --board sonicsurface --seconds 10
    """
    from palmfield.data import folder
    from palmfield.studies.trial.latency import measure_latency

    keys: dict[str, object] = {}
    if scene is None:
        scene = folder("mjcf") / "scenes" / "follow_fingertip.xml"
        keys, board = {"stimulus.modulation": "none"}, board or "sonicsurface"
    found = measure_latency(scene, board=board, keys=keys, seconds=seconds, rate_Hz=rate, by=checked_by(by))
    if as_json:
        print_json(found.as_dict())
    else:
        print(found)


def checked_by(by: str) -> Literal["udp", "tcp"]:
    refuse_unknown(SceneError, "--by has value {}", by, ("udp", "tcp"))
    return "tcp" if by == "tcp" else "udp"
