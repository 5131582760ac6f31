"""`palmfield drive`: play a scene, one focus, or received foci on a board."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from palmfield.cli.messages import print_message
from palmfield.cli.options import BoardName, Keys, check_duration, parsed_keys
from palmfield.errors import SceneError

if TYPE_CHECKING:
    from palmfield.hardware.play import Performance

UNSENT_CODE = 4
"""Exit code if more frames were due than could be sent."""
OF_A_FOCUS = {
    "level": "stimulus.drive_amplitude", "am_frequency": "stimulus.am_frequency_Hz", "layout": "array.layout",
    "p0": "array.p0_Pa_m", "calibration": "array.calibration", "temperature": "array.temperature_C",
    "humidity": "array.humidity_percent", "air_pressure": "array.pressure_Pa",
}  # fmt: skip
"""Options of `drive` for a focus, and the corresponding keys of a scene."""


def drive(
    context: typer.Context,
    scene: Annotated[Path | None, typer.Argument(help="scene to play", metavar="[SCENE.xml]")] = None,
    focus: Annotated[
        tuple[float, float, float] | None, typer.Option(help="stationary focus in the array frame [m]", metavar="X Y Z")
    ] = None,
    board: BoardName = None,
    live: Annotated[
        str | None,
        typer.Option(
            metavar="[HOST:]PORT",
            help="play foci received at this port, one JSON line each (docs/boards.md), by UDP or with tcp:[HOST:]PORT "
            "by TCP, until Ctrl-C or for --duration; --focus is then in the frame of the received poses",
        ),
    ] = None,
    port: Annotated[
        str | None, typer.Option(help="serial port or URL: /dev/ttyUSB0, COM3, socket://host:port, loop://")
    ] = None,
    record: Annotated[Path | None, typer.Option(help="write the bytes to this file instead")] = None,
    log: Annotated[
        Path | None, typer.Option(help="log the frames sent and their times in this file, for decode and replay")
    ] = None,
    duration: Annotated[float | None, typer.Option(help="duration [s] [default: from the scene, or 10]")] = None,
    keys: Keys = None,
    level: Annotated[float, typer.Option(help="with --focus: amplitude of all transducers, 0 to 1")] = 1.0,
    am_frequency: Annotated[
        float,
        typer.Option(help="with --focus: frequency of sinusoidal AM between silence and the level [Hz]; 0 for none"),
    ] = 0.0,
    layout: Annotated[
        str | None,
        typer.Option(
            help="with --focus: layout of the array, one that the board drives [default: its first], or FILE.csv"
        ),
    ] = None,
    p0: Annotated[
        float | None,
        typer.Option(help="with --focus: peak pressure of a transducer at 1 m [Pa m] [default: that of the layout]"),
    ] = None,
    calibration: Annotated[
        Path | None, typer.Option(help="with --focus: calibration file of the transducers (docs/calibration.md)")
    ] = None,
    temperature: Annotated[float, typer.Option(help="with --focus: air temperature [C]")] = 20.0,
    humidity: Annotated[float, typer.Option(help="with --focus: relative humidity [%]")] = 50.0,
    air_pressure: Annotated[float, typer.Option(help="with --focus: static pressure of the air [Pa]")] = 101325.0,
) -> None:
    """Play a scene or one focus on a real board, or record the bytes for it.

    The frames are those that `palmfield run` simulates: each frame uses the positions of hands and arrays at its
    emission. A separate process sends the frames. If the board cannot play the scene, the exit code is 2; if more than
    1 % of the due frames could not be sent, it is 4. The board is switched off at the end, on Ctrl-C, on Ctrl-Z until
    `fg`, on errors, and if this program is killed. An uncalibrated board does not focus: about half of its transducers
    are wired with inverted polarity.

    Examples: palmfield drive --focus 0 0 0.15 --port /dev/ttyUSB0 --duration 5

    palmfield drive mjcf/scenes/palm_circle_sonicsurface.xml --record circle.bin

    palmfield drive mjcf/scenes/follow_fingertip.xml --board autd2018 --port socket://127.0.0.1:5000 --log sent.jsonl

    palmfield drive --live 9200 --board sonicsurface --port /dev/ttyUSB0
    """
    from palmfield.terminal import bars

    with bars() as bar:
        bar.add_task("loading palmfield", total=None)
        from palmfield.hardware.focus_board import FocusSound
        from palmfield.hardware.play import Target, play_focus, play_scene
        from palmfield.types import Air

    if live is not None and scene is not None:
        raise SceneError(
            "--live plays received foci and takes no scene; for a scene with a live hand use `palmfield trial "
            "SCENE --live`"
        )
    if live is None and (scene is None) == (focus is None):
        raise SceneError("`palmfield drive` plays a SCENE.xml, --focus X Y Z, or --live PORT; give one of them")
    if scene is not None:
        _refuse_focus_options(context)
    if (port is None) == (record is None):
        raise SceneError("`palmfield drive` needs either --port (a board) or --record (a file); give one of them")
    check_duration(duration)
    target = Target(port, record, log)
    sound = FocusSound(level, am_frequency, p0, Air(temperature, humidity, air_pressure), layout, calibration)
    own = {name.removeprefix("driver."): value for name, value in parsed_keys(keys).items()}
    if live is not None:
        from palmfield.hardware.live_focus import LiveInput, play_live
        from palmfield.motion.replaying import address_by

        host, number, by = address_by(live)

        def listening(host: str, number: int) -> None:
            print(f"listening for foci at {host}:{number} by {by}; press Ctrl-C to end", file=sys.stderr, flush=True)

        source = LiveInput(host, number, by, focus or (0.0, 0.0, 0.0), on_listening=listening)
        done = play_live(source, board or "sonicsurface", target, duration, sound=sound, keys=own)
    elif focus is not None:
        lasts = 10.0 if duration is None else duration
        done = play_focus(focus, board or "sonicsurface", target, lasts, sound=sound, keys=own, progress=True)
    else:
        assert scene is not None
        done = play_scene(scene, board, target, duration, keys=parsed_keys(keys), progress=True)
    show_performance(done)


def _refuse_focus_options(context: typer.Context) -> None:
    """Raise SceneError if an option of --focus is used with a scene."""
    for name, key in OF_A_FOCUS.items():
        source = context.get_parameter_source(name)
        if source is not None and source.name == "COMMANDLINE":
            raise SceneError(f"--{name.replace('_', '-')} belongs to --focus; for a scene use --set {key}=VALUE")


def show_performance(done: "Performance") -> None:
    """Print the report of a play. Raises typer.Exit if frames were skipped."""
    print(done)
    if done.warning:
        print_message(f"warning: {done.warning}")
        raise typer.Exit(UNSENT_CODE)
