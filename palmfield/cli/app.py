"""The command line. Each command loads what it needs only, so that --help is quick."""

import os
import re
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from palmfield.cli import brought
from palmfield.cli.calibrate import calibrate
from palmfield.cli.experiment import experiment
from palmfield.cli.given import given_keys, offered_plugins, offered_settings
from palmfield.cli.messages import LEVELS, complain, show_log
from palmfield.cli.stimulus import stimulus
from palmfield.cli.track import track
from palmfield.errors import PalmfieldError, SceneError


class _Door(TyperGroup):
    """The whole program: what it is given is read as on this system, and other distributions bring commands."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        return super().parse_args(ctx, [_of_this_system(argument) for argument in args])

    def list_commands(self, ctx: Any) -> list[str]:
        self._take_in()
        return super().list_commands(ctx)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        if cmd_name not in self.commands:
            self._take_in()
        return super().get_command(ctx, cmd_name)

    def _take_in(self) -> None:
        """Take commands in that other distributions bring: only when asked for, as each loads a module."""
        for name, command in brought.commands().items():
            self.commands.setdefault(name, command)


def _of_this_system(argument: str) -> str:
    """An argument with its home folder, which shells leave alone behind `=` and in quotes.

    Raises SceneError for a path of Windows on another system.
    """
    name, equals, value = argument.partition("=") if argument.startswith("--") else ("", "", argument)
    if value == "~" or value.startswith("~/"):
        return name + equals + os.path.expanduser(value)
    if os.name == "posix" and (drive := re.match(r"([A-Za-z]):[\\/]", value)):
        raise SceneError(
            f"'{value}' is a path of Windows, and this system has no drives; give a path with /, in WSL "
            f"/mnt/{drive[1].lower()}/{value[3:].replace(chr(92), '/')}"
        )
    return argument


app = typer.Typer(
    cls=_Door,
    no_args_is_help=True,
    rich_markup_mode=None,
    help="Ultrasonic mid-air haptics: from an array's drive to radiation pressure on a hand, skin waves and what is "
    "felt.\n\n"
    "Start with `palmfield new first` and `palmfield run first/first.xml`.\n\n"
    "--install-completion lets the shell complete commands, options, plugins and keys after TAB.",
)
SceneFile = Annotated[Path, typer.Argument(help="MJCF scene with palmfield plugins", metavar="SCENE.xml")]
Device = Annotated[
    str | None,
    typer.Option(
        help="where fields are computed: auto, cpu or cuda:N [default: the scene's palmfield_device, or auto]",
        metavar="DEVICE",
    ),
]
Accuracy = Annotated[
    float | None, typer.Option(help="wanted relative error of the skin displacement, e.g. 0.05", metavar="REL")
]
Keys = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        help="another value for a key of one instance, or of all instances of a plugin, e.g. "
        "stimulus.path_speed_m_s=11 (see `palmfield keys`); give it several times for several keys. A file that is "
        "in the current folder is taken from there, others are relative to the scene. The value unset takes a key out",
        metavar="INSTANCE.KEY=VALUE",
        autocompletion=offered_settings,
    ),
]
BoardName = Annotated[
    str | None,
    typer.Option(
        help="another board than the scene's, with its layout and rate (see `palmfield boards`)", metavar="BOARD"
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="print JSON only, with units in the names, for other programs")]
INTERRUPTED_CODE = 130
"""Exit code after Ctrl-C."""
ANYWHERE = {"-v": 0, "--verbose": 0, "-q": 0, "--quiet": 0, "--log-level": 1}
"""Options of the whole program, which may also stand after a command, and how many values follow each."""


@app.callback(invoke_without_command=True)
def program(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="print the version and end")] = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="print warnings and errors only, and what --json asks for")
    ] = False,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="as --log-level debug")] = False,
    log_level: Annotated[
        str | None,
        typer.Option(help=f"from where on the log is shown: {', '.join(LEVELS)} [default: info]", metavar="LEVEL"),
    ] = None,
) -> None:
    if version:
        import palmfield

        print(f"palmfield {palmfield.__version__}")
        raise typer.Exit()
    if quiet and verbose:
        raise SceneError("--quiet and --verbose say the opposite; give one of them")
    show_log(log_level or ("debug" if verbose else "warning" if quiet else "info"))
    context.obj = quiet


@app.command()
def run(
    context: typer.Context,
    scene: SceneFile,
    out: Annotated[Path | None, typer.Option(help="folder for the results [default: out/SCENE]")] = None,
    device: Device = None,
    duration: Annotated[float | None, typer.Option(help="simulated time [s] [default: the scene's]")] = None,
    accuracy: Accuracy = None,
    board: BoardName = None,
    keys: Keys = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="replace another run's results in the folder")] = False,
    plots: Annotated[
        str | None,
        typer.Option(help="pictures instead of the usual three (see `palmfield plot --list`)", metavar="KIND,..."),
    ] = None,
    no_plots: Annotated[bool, typer.Option("--no-plots", help="draw none")] = False,
    details: Annotated[
        bool, typer.Option("--details", help="print every number, observer and part of the error")
    ] = False,
    strict: Annotated[bool, typer.Option("--strict", help="exit code 3 where the accuracy is not reached")] = False,
    as_json: AsJson = False,
) -> None:
    """Simulate a scene and write result.nc, summary.json, pictures and scene.usdc.

    Interrupting with Ctrl-C keeps what was computed (marked incomplete). After a crash of the machine,
    `palmfield recover DIR` assembles what had reached the disk. A folder that holds results is refused, unless you ask
    for --overwrite.

    Example: palmfield run mjcf/scenes/palm_am200.xml --out out/palm --set stimulus.am_frequency_Hz=100
    """
    from rich.console import Console

    # The imports take seconds of their own
    with Console(stderr=True, quiet=context.obj).status("loading palmfield"):
        from palmfield.cli.run import run_scene

    _check_duration(duration)
    if plots is not None and no_plots:
        raise SceneError("--plots and --no-plots say the contrary; give one of them")
    kinds = [] if no_plots else None if plots is None else [kind for kind in plots.split(",") if kind]
    run_scene(
        scene, out or Path("out") / scene.stem, device=device, accuracy=accuracy, board=board, keys=given_keys(keys),
        duration_s=duration, overwrite=overwrite, plots=kinds, quiet=context.obj, details=details, strict=strict,
        as_json=as_json,
    )  # fmt: skip


def _check_duration(duration: float | None) -> None:
    if duration is not None and not 0 < duration < 3600:
        raise SceneError(f"--duration has value {duration:g}; allowed: seconds > 0 and < 3600")


@app.command()
def plan(
    scene: SceneFile,
    device: Device = None,
    duration: Annotated[float | None, typer.Option(help="simulated time [s] [default: the scene's]")] = None,
    accuracy: Accuracy = None,
    board: BoardName = None,
    keys: Keys = None,
    as_json: AsJson = False,
) -> None:
    """Say what would be modelled and what left out, why, and at what cost and error. Simulates nothing.

    Example: palmfield plan mjcf/scenes/palm_am200.xml --accuracy 0.02 --duration 0.5
    """
    import palmfield
    from palmfield.cli.as_json import print_json

    _check_duration(duration)
    made = palmfield.plan(
        scene, device=device, accuracy=accuracy, board=board, keys=given_keys(keys), duration_s=duration
    )  # fmt: skip
    if as_json:
        print_json(made.as_dict())
    else:
        print(made, end="")


@app.command()
def info(
    scene: SceneFile, device: Device = None, accuracy: Accuracy = None, keys: Keys = None, as_json: AsJson = False
) -> None:
    """Show what a scene contains: arrays, air, stimuli, surfaces, skins, materials, laws and conventions.

    Example: palmfield info mjcf/scenes/phantom_step.xml
    """
    from palmfield.cli.as_json import print_json
    from palmfield.cli.describe import describe, scene_facts
    from palmfield.session.preview import preview

    view = preview(scene, device=device, accuracy=accuracy, keys=given_keys(keys))
    if as_json:
        print_json(scene_facts(view))
    else:
        print(describe(view), end="")


@app.command()
def drive(
    context: typer.Context,
    scene: Annotated[Path | None, typer.Argument(help="scene to play", metavar="[SCENE.xml]")] = None,
    focus: Annotated[
        tuple[float, float, float] | None, typer.Option(help="a still focus in the array frame [m]", metavar="X Y Z")
    ] = None,
    board: BoardName = None,
    live: Annotated[
        str | None,
        typer.Option(
            metavar="[HOST:]PORT",
            help="play foci that come in here, a line of JSON each (docs/boards.md), by udp or with tcp:[HOST:]PORT, "
            "until Ctrl-C or for --duration; --focus is then in the frame of the poses that come",
        ),
    ] = None,
    port: Annotated[
        str | None, typer.Option(help="serial port or URL: /dev/ttyUSB0, COM3, socket://host:port, loop://")
    ] = None,
    record: Annotated[Path | None, typer.Option(help="write the bytes to this file instead")] = None,
    log: Annotated[
        Path | None, typer.Option(help="write what was sent when to this file, for decode and replay")
    ] = None,
    duration: Annotated[float | None, typer.Option(help="how long to play [s] [default: the scene's, or 10]")] = None,
    keys: Keys = None,
    level: Annotated[float, typer.Option(help="with --focus: amplitude of all transducers, 0 to 1")] = 1.0,
    am_frequency: Annotated[
        float, typer.Option(help="with --focus: sine between silence and the level [Hz]; 0 for none")
    ] = 0.0,
    layout: Annotated[
        str | None,
        typer.Option(
            help="with --focus: of the array, of those that the board drives [default: its first], or FILE.csv"
        ),
    ] = None,
    p0: Annotated[
        float | None,
        typer.Option(help="with --focus: peak pressure of a transducer at 1 m [Pa m] [default: the layout's]"),
    ] = None,
    calibration: Annotated[
        Path | None,
        typer.Option(help="with --focus: file of what was measured of the transducers (docs/calibration.md)"),
    ] = None,
    temperature: Annotated[float, typer.Option(help="with --focus: of the air [C]")] = 20.0,
    humidity: Annotated[float, typer.Option(help="with --focus: of the air, relative [%]")] = 50.0,
    air_pressure: Annotated[float, typer.Option(help="with --focus: of the air [Pa]")] = 101325.0,
) -> None:
    """Play a scene, or one focus, on a real board; or record the bytes that it would get.

    What is sent is what `palmfield run` simulates, with hands and arrays where they are when each frame is emitted. A
    board that can't play the scene is refused with exit code 2; where more than 1 % of the frames that were due could
    not be sent, the exit code is 4. A process of its own sends them. The board is switched off at the end, on Ctrl-C,
    on Ctrl-Z until `fg`, on errors, and when this program is killed. An uncalibrated board does not focus: about half
    of its transducers are wired with inverted polarity.

    Examples: palmfield drive --focus 0 0 0.15 --port /dev/ttyUSB0 --duration 5

    palmfield drive mjcf/scenes/palm_circle_sonicsurface.xml --record circle.bin

    palmfield drive mjcf/scenes/follow_fingertip.xml --board autd2018 --port socket://127.0.0.1:5000 --log sent.jsonl

    palmfield drive --live 9200 --board sonicsurface --port /dev/ttyUSB0
    """
    from palmfield.terminal import bars

    with bars() as bar:
        bar.add_task("loading palmfield", total=None)
        from palmfield.cli.boards import show_performance
        from palmfield.hardware.focus_board import FocusSound
        from palmfield.hardware.play import Target, play_focus, play_scene
        from palmfield.types import Air

    if live is not None and scene is not None:
        raise SceneError(
            "--live plays foci that come in; a scene follows a live hand by `palmfield trial SCENE --live`"
        )
    if live is None and (scene is None) == (focus is None):
        raise SceneError("`palmfield drive` plays a SCENE.xml, --focus X Y Z, or --live PORT; give one of them")
    if scene is not None:
        _refuse_focus_options(context)
    if (port is None) == (record is None):
        raise SceneError("`palmfield drive` needs either --port (a board) or --record (a file); give one of them")
    _check_duration(duration)
    target = Target(port, record, log)
    sound = FocusSound(level, am_frequency, p0, Air(temperature, humidity, air_pressure), layout, calibration)
    own = {name.removeprefix("driver."): value for name, value in given_keys(keys).items()}
    if live is not None:
        from palmfield.hardware.live_focus import LiveInput, play_live
        from palmfield.motion.replaying import address_by

        host, number, by = address_by(live)

        def listening(host: str, number: int) -> None:
            print(f"listening for foci at {host}:{number} by {by}; Ctrl-C ends it", file=sys.stderr, flush=True)

        given = LiveInput(host, number, by, focus or (0.0, 0.0, 0.0), on_listening=listening)
        done = play_live(given, board or "sonicsurface", target, duration, sound=sound, keys=own)
    elif focus is not None:
        lasts = 10.0 if duration is None else duration
        done = play_focus(focus, board or "sonicsurface", target, lasts, sound=sound, keys=own, progress=True)
    else:
        assert scene is not None
        done = play_scene(scene, board, target, duration, keys=given_keys(keys), progress=True)
    show_performance(done)


OF_A_FOCUS = {
    "level": "stimulus.drive_amplitude", "am_frequency": "stimulus.am_frequency_Hz", "layout": "array.layout",
    "p0": "array.p0_Pa_m", "calibration": "array.calibration", "temperature": "array.temperature_C",
    "humidity": "array.humidity_percent", "air_pressure": "array.pressure_Pa",
}  # fmt: skip
"""Options of `drive` that say what a scene's keys say."""


def _refuse_focus_options(context: typer.Context) -> None:
    """Raises SceneError for an option that belongs to --focus, beside a scene."""
    for name, key in OF_A_FOCUS.items():
        source = context.get_parameter_source(name)
        if source is not None and source.name == "COMMANDLINE":
            raise SceneError(
                f"--{name.replace('_', '-')} belongs to --focus; a scene says it itself: use --set {key}=VALUE"
            )


@app.command()
def safety(
    scene: SceneFile,
    out: Annotated[Path | None, typer.Option(help="write the page to this file", metavar="FILE.md")] = None,
    duration: Annotated[float | None, typer.Option(help="of one play [s] [default: the scene's]")] = None,
    board: BoardName = None,
    keys: Keys = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="replace a file that is there")] = False,
    as_json: AsJson = False,
) -> None:
    """One page for an ethics board: levels at head and hand, what is audible, limits, what the board can't promise.

    Levels have the band that p0's range makes of them. Say where a head may be by driver keys head_m and head_radius_m.

    Example: palmfield safety mjcf/scenes/palm_circle_sonicsurface.xml --set driver.head_m="0 -0.3 0.5" --out sheet.md
    """
    from palmfield.cli.safety import show_sheet

    _check_duration(duration)
    show_sheet(
        scene, out, board=board, keys=given_keys(keys), duration_s=duration, overwrite=overwrite, as_json=as_json
    )


@app.command()
def boards(
    name: Annotated[str | None, typer.Argument(help="one board", metavar="[BOARD]")] = None,
    markdown: Annotated[bool, typer.Option(help="as the page docs/boards.md has it")] = False,
    as_json: AsJson = False,
) -> None:
    """List the boards that play a drive, with their limits; all of one, with what it can't guarantee.

    Example: palmfield boards sonicsurface
    """
    from palmfield.cli.as_json import print_json
    from palmfield.cli.boards import describe, facts
    from palmfield.drive.boards import BOARDS, board_named

    if as_json:
        print_json({one.name: facts(one) for one in (BOARDS.values() if name is None else [board_named(name)])})
    else:
        describe(name, markdown)


@app.command()
def board(
    name: Annotated[str, typer.Argument(help="which board (see `palmfield boards`)", metavar="BOARD")],
    virtual: Annotated[bool, typer.Option("--virtual", help="start one that is not there and print its port")] = False,
    by: Annotated[str, typer.Option(help="pty (a pseudo-terminal) or tcp")] = "pty",
    tcp_port: Annotated[int, typer.Option(help="with --by tcp; 0 for any that is free")] = 0,
    duration: Annotated[float | None, typer.Option(help="end after so long [s] [default: at Ctrl-C]")] = None,
    drop: Annotated[float, typer.Option(help="share of bytes that are lost")] = 0.0,
    flip: Annotated[float, typer.Option(help="share of bytes of which a bit is turned")] = 0.0,
    stall: Annotated[
        tuple[float, float] | None, typer.Option(help="take no bytes from T on for L [s]", metavar="T L")
    ] = None,
    unplug: Annotated[float | None, typer.Option(help="take the port away after so long [s]")] = None,
    received: Annotated[Path | None, typer.Option(help="write the bytes that came to this file")] = None,
) -> None:
    """A virtual board: takes bytes at the pace of the real one's line, and says what sounded and what it noticed.

    Example: palmfield board sonicsurface --virtual
    """
    from palmfield.cli.boards import describe, run_virtual

    if not virtual:
        describe(name, False)
        return
    run_virtual(
        name, by, tcp_port, duration, drop=drop, flip=flip, stall=stall, unplug_s=unplug, received=received
    )  # fmt: skip


@app.command()
def decode(
    file: Annotated[Path, typer.Argument(help="of --log, or raw bytes of --record", metavar="FILE")],
    board: Annotated[str | None, typer.Option(help="of raw bytes: for which board they are", metavar="BOARD")] = None,
    layout: Annotated[str | None, typer.Option(help="of raw bytes: the array's layout [default: the board's]")] = None,
    calibration: Annotated[
        Path | None,
        typer.Option(help="file of what the transducers do [default: as the log's scene knew them]", metavar="FILE"),
    ] = None,
    png: Annotated[Path | None, typer.Option(help="draw the foci", metavar="FILE")] = None,
    csv: Annotated[Path | None, typer.Option(help="write all foci as a table", metavar="FILE")] = None,
) -> None:
    """Show the foci that bytes really make: through the board's virtual twin, fitted to what it emits.

    Example: palmfield drive mjcf/scenes/palm_circle_sonicsurface.xml --record c.bin && palmfield decode c.bin --board
    sonicsurface --png c.png
    """
    import numpy as np

    from palmfield.hardware.decode import as_table, draw_foci, write_csv
    from palmfield.hardware.decode import decode as decoded_file

    decoded = decoded_file(file, board, layout, calibration)
    print(as_table(decoded, most=40))
    if csv is not None:
        write_csv(decoded, csv)
    if png is not None:
        foci = np.array([row.focus for row in decoded.foci]).reshape(-1, 3)
        draw_foci([row.time_s for row in decoded.foci], foci, png)


@app.command()
def replay(
    file: Annotated[Path, typer.Argument(help="of --log, or raw bytes of --record", metavar="FILE")],
    port: Annotated[str, typer.Option(help="serial port or URL")],
    board: Annotated[str | None, typer.Option(help="of raw bytes: for which board they are", metavar="BOARD")] = None,
    keys: Keys = None,
) -> None:
    """Send recorded bytes to a port again, at their times; the board is off at the end.

    How long they may sound and how loud at a head, as a log has it of its scene or --set driver.KEY=VALUE says, is
    checked before: what isn't allowed is refused with exit code 2.

    Examples: palmfield replay sent.jsonl --port /dev/ttyUSB0

    palmfield replay sent.jsonl --port /dev/ttyUSB0 --set driver.on_time_s=5
    """
    from palmfield.cli.boards import show_performance
    from palmfield.hardware.replay import replay as replay_file

    show_performance(replay_file(file, port, board, keys=given_keys(keys), progress=True))


@app.command()
def trial(
    context: typer.Context,
    scene: SceneFile,
    out: Annotated[Path | None, typer.Option(help="folder for the results [default: out/SCENE_trial]")] = None,
    board: BoardName = None,
    port: Annotated[
        str | None,
        typer.Option(
            help="of a real board, or `virtual` for one that is paced in real time [default: the board's twin, without "
            "waiting: quick, and the same each time]"
        ),
    ] = None,
    duration: Annotated[float | None, typer.Option(help="how long [s] [default: the scene's]")] = None,
    motion: Annotated[
        Path | None,
        typer.Option(help="a recorded motion instead of the scene's: a table of poses, or a tracker's stream"),
    ] = None,
    live: Annotated[
        str | None,
        typer.Option(
            help="follow a hand whose samples come in here, in place of the scene's motion (see `palmfield track`), by "
            "udp or with tcp:[HOST:]PORT; always in real time",
            metavar="[HOST:]PORT",
        ),
    ] = None,
    align: Annotated[
        Path | None, typer.Option(help="with --live: file of `palmfield track align`, where the tracker stands")
    ] = None,
    tracker_rate: Annotated[float, typer.Option(help="samples a second; 0 for one whenever a frame is made")] = 90.0,
    tracker_latency: Annotated[float, typer.Option(help="from a sample's moment until it is there [ms]")] = 10.0,
    tracker_noise: Annotated[float, typer.Option(help="of each coordinate, standard deviation [mm]")] = 0.0,
    ahead: Annotated[
        str,
        typer.Option(
            help="how far beyond its last sample the hand is predicted [ms]; 0: not at all; auto: to the middle of the "
            "time in which a frame will sound"
        ),
    ] = "auto",
    truth: Annotated[
        Path | None,
        typer.Option(help="calibration file of what the transducers really do, where the scene says otherwise"),
    ] = None,
    recording: Annotated[
        Path | None,
        typer.Option(help="a microphone's or vibrometer's CSV file to hold the trial against (docs/trials.md)"),
    ] = None,
    skin: Annotated[bool, typer.Option(help="step the skin, with and without what is lost")] = True,
    keys: Keys = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="replace another trial in the folder")] = False,
    as_json: AsJson = False,
) -> None:
    """Close the loop: tracker, focus, bytes, board, and the sound where the hand really is by then.

    Says how far the focus is from the hand, what of the pressure is lost to latency, to what the board rounds, and to
    transducers that are not as the scene says (--truth), and which frames were dropped; writes sent.jsonl (for decode
    and replay), course.csv, trial.json and trial.png. Ctrl-C keeps what there is by then. A scene that its board can't
    play is refused with exit code 2.

    Examples: palmfield trial mjcf/scenes/follow_fingertip.xml --board autd2018

    palmfield trial mjcf/scenes/follow_fingertip.xml --board sonicsurface --set stimulus.modulation=none --port virtual
    """
    from palmfield.cli.trial import run_trial

    _check_duration(duration)
    run_trial(
        scene, out or Path("out") / f"{scene.stem}_trial", board=board, port=port, duration_s=duration, motion=motion,
        live=live, align=align, rate_Hz=tracker_rate, latency_ms=tracker_latency, noise_mm=tracker_noise, ahead=ahead,
        truth=truth, recording=recording, skin=skin, keys=given_keys(keys), overwrite=overwrite, quiet=context.obj,
        as_json=as_json,
    )  # fmt: skip


@app.command()
def keys(
    plugin: Annotated[
        str | None,
        typer.Argument(
            help="one module, e.g. skin for palmfield.skin", metavar="[PLUGIN]", autocompletion=offered_plugins
        ),
    ] = None,
    markdown: Annotated[bool, typer.Option(help="as the page docs/keys.md")] = False,
    as_json: AsJson = False,
) -> None:
    """List every key that a scene can set, with unit, allowed values, default and meaning.

    Example: palmfield keys stimulus
    """
    from palmfield.cli.as_json import print_json
    from palmfield.cli.keys import as_dict, as_markdown, as_text

    if as_json and markdown:
        raise SceneError("--json and --markdown ask for two forms; give one of them")
    if as_json:
        print_json(as_dict(plugin))
    else:
        print(as_markdown() if markdown else as_text(plugin), end="")


@app.command()
def new(
    name: Annotated[str, typer.Argument(help="name of the scene; writes the folder NAME here")],
    stimulus: Annotated[
        str | None,
        typer.Option(
            help="a standard stimulus, see `palmfield stimulus standard` [default: AM at 200 Hz]", metavar="NAME"
        ),
    ] = None,
) -> None:
    """Write a commented scene that runs: a hand over an array and a 200 Hz focus on the palm, or another stimulus.

    NAME/NAME_plain.xml opens in any MuJoCo; NAME/NAME.xml adds the haptics and opens where palmfield is installed. The
    folder has all that they refer to, so that it can be moved and sent.

    Examples: palmfield new first && palmfield run first/first.xml

    palmfield new pressed --stimulus lm_small_steps
    """
    from palmfield.cli.template import write_scene

    for path in write_scene(name, stimulus=stimulus):
        print(f"wrote {path}")
    print(f"next: palmfield run {Path(name) / name}.xml")


@app.command()
def migrate(
    scene: SceneFile,
    out: Annotated[Path | None, typer.Option(help="file to write [default: the scene's own]")] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="replace a file that is there")] = False,
) -> None:
    """Rewrite a scene of the last version: keys and values that are renamed get their new names.

    Comments and layout stay; what was changed is printed. A file that is there is kept, unless you ask for --overwrite.

    Examples: palmfield migrate old.xml --out new.xml

    palmfield migrate scene.xml --overwrite
    """
    from palmfield.session.migrate import migrate as rewrite

    result = rewrite(scene, out, overwrite=overwrite)
    for change in result.changes:
        print(change)
    print(f"wrote {scene if out is None else out}" if result.changes else f"{scene} has nothing that is renamed")
    for other in result.others:
        print(f"it includes {other}, which has renamed keys too: palmfield migrate {other}")


@app.command()
def hand(
    mesh: Annotated[Path, typer.Argument(help="GLB, glTF, OBJ, PLY, STL or MANO .pkl file", metavar="MESH")],
    units: Annotated[str, typer.Option(help="what one unit in the file is: auto, m, dm, cm, mm or in")] = "auto",
    json: Annotated[Path | None, typer.Option(help="write the card to this file", metavar="FILE")] = None,
    png: Annotated[Path | None, typer.Option(help="draw the mesh with its faults in colour", metavar="FILE")] = None,
    mjcf: Annotated[Path | None, typer.Option(help="write bodies for the mesh's joints", metavar="FILE")] = None,
) -> None:
    """Report card of a hand's mesh: unit, size, side, faults mended or refused, and the skin layers that it bears.

    Exit code 0: accepted; 3: accepted with doubts, for example whether it is a hand; 2: refused.

    Examples: palmfield hand my_hand.glb --json card.json --png card.png

    palmfield hand my_hand.glb --mjcf my_hand.xml
    """
    from palmfield.cli.hand import show_hand

    if not show_hand(mesh, units, json, png, mjcf):
        raise typer.Exit(3)


@app.command()
def sweep(
    context: typer.Context,
    scene: SceneFile,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="values of a key: a:b:n for n numbers from a to b, a:b:n:log for each a fixed factor above the last, "
            "v1,v2,... for these, one value that all points share, or nothing to take the key out. A vector's numbers "
            "have spaces between, or are swept one by one as KEY[0], KEY[1], ... Give it several times for several "
            "keys",
            metavar="INSTANCE.KEY=VALUES",
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="folder for the dataset [default: out/SCENE_sweep]")] = None,
    random: Annotated[
        int | None, typer.Option(help="N points drawn at random from ranges a:b, a:b:log or v1,v2,...", metavar="N")
    ] = None,
    sobol: Annotated[
        int | None, typer.Option(help="as --random, but N Sobol points, which fill ranges evenly", metavar="N")
    ] = None,
    table: Annotated[
        Path | None, typer.Option("--list", help="points from a table: keys in its first line", metavar="FILE.csv")
    ] = None,
    seed: Annotated[int, typer.Option(help="of --random and --sobol: the same points for the same seed")] = 0,
    workers: Annotated[
        int | None,
        typer.Option(
            help="processes on this machine; 0: in this one [default: one a core, up to 8 a GPU]", metavar="N"
        ),
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(help="use the workers of a Dask scheduler that runs already", metavar="tcp://HOST:PORT"),
    ] = None,
    device: Device = None,
    accuracy: Accuracy = None,
    duration: Annotated[
        float | None, typer.Option(help="simulated time of each point [s] [default: the scene's]")
    ] = None,
    errors: Annotated[
        bool, typer.Option("--errors", help="estimate each point's error: often longer than its run")
    ] = False,
    picture: Annotated[bool, typer.Option(help="draw DIR/sweep.png")] = True,
    yes: Annotated[bool, typer.Option("--yes", help="don't ask before more than 2 GB or an hour")] = False,
) -> None:
    """Simulate a scene over values of its keys; write one labelled dataset, DIR/sweep.zarr, and a picture.

    Of each point: peak and rms displacement and velocity of each skin, the course at its loudest place and at each
    sensor, peak ARP, force and level above threshold by observer; `xarray.open_zarr` opens it, keys are dimensions.

    Ctrl-C, a killed worker or a full disk lose only the points under way: the same command goes on. A point that fails
    is recorded with its error. It needs the extra [sweep]: pip install 'palmfield[sweep]'.

    Examples: palmfield sweep mjcf/scenes/palm_am200.xml --set stimulus.am_frequency_Hz=50:300:6 --out out/frequency

    palmfield sweep mjcf/scenes/palm_circle.xml --set stimulus.path_rate_Hz= --set stimulus.path_speed_m_s=1:11:6
    --set stimulus.path_diameter_m=0.02,0.04 --accuracy 0.2

    palmfield sweep mjcf/scenes/palm_am200.xml --sobol 64 --set "stimulus.focus_m[0]=-0.02:0.02" --set
    "stimulus.focus_m[1]=-0.02:0.02" --scheduler tcp://192.168.1.10:8786
    """
    from palmfield.cli.sweep import run_sweep

    _check_duration(duration)
    run_sweep(
        scene, out or Path("out") / f"{scene.stem}_sweep", settings or [], random_points=random, sobol_points=sobol,
        table=table, seed=seed, workers=workers, scheduler=scheduler, device=device, accuracy=accuracy,
        duration_s=duration, errors=errors, picture=picture, yes=yes, quiet=context.obj,
    )  # fmt: skip


@app.command("compare")
def compare_command(
    context: typer.Context,
    run: Annotated[Path, typer.Argument(help="folder of a run, or its result.nc", metavar="DIR")],
    measured: Annotated[Path, typer.Argument(help="file of a scan (docs/compare.md)", metavar="MEASURED")],
    instrument: Annotated[
        Path | None, typer.Option(help="how it was measured: TOML file with a table [vibrometer]", metavar="FILE.toml")
    ] = None,
    skin: Annotated[str | None, typer.Option(help="which skin, where the run has several", metavar="NAME")] = None,
    fiducials: Annotated[
        Path | None,
        typer.Option(help="points of the scan and where they are on the skin: x_m ... skin_z_m", metavar="FILE.csv"),
    ] = None,
    as_placed: Annotated[
        bool, typer.Option("--as-placed", help="leave the scan where the file or fiducials put it")
    ] = False,
    most_delay: Annotated[float, typer.Option(help="delays are sought within plus and minus this [s]")] = 5e-3,
    out: Annotated[Path | None, typer.Option(help="folder for the report [default: DIR/compare]")] = None,
    mode: Annotated[
        float | None, typer.Option(help="fit the guided mode of both scans at this frequency", metavar="HZ")
    ] = None,
    source: Annotated[
        tuple[float, float, float] | None,
        typer.Option(help="of the mode, on the skin [m] [default: where ours moves most]", metavar="X Y Z"),
    ] = None,
    source_radius: Annotated[
        float, typer.Option(help="left out about the source [m]: 1.5 times the spot's width")
    ] = 0.016,
    as_uff: Annotated[bool, typer.Option("--as-uff", help="write ours as computed.uff too")] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="replace another comparison in the folder")] = False,
    as_json: AsJson = False,
) -> None:
    """Hold a vibrometer's scan against a run: gain, delay, difference and coherence at each point, and wavenumbers.

    The scan is moved onto the skin, and ours passes the same instrument.

    Example: palmfield compare out/palm scan.csv --instrument head.toml
    """
    from palmfield.cli.compare import compare_scan

    folder = run if run.is_dir() else run.parent
    compare_scan(
        run, measured, instrument=instrument, skin=skin, fiducials=fiducials, as_placed=as_placed,
        most_delay_s=most_delay, mode_Hz=mode, source_m=source, source_radius_m=source_radius,
        out=out or folder / "compare", as_uff=as_uff, overwrite=overwrite, quiet=context.obj,
        as_json=as_json,
    )  # fmt: skip


@app.command("plot")
def plot_command(
    context: typer.Context,
    run: Annotated[
        Path | None,
        typer.Argument(help="folder of a run, or its result.nc; or a table of palmfield bench", metavar="[DIR]"),
    ] = None,
    kinds: Annotated[
        list[str] | None,
        typer.Argument(help="which, also A,B (see --list) [default: all that the run holds]", metavar="[KIND]..."),
    ] = None,
    time_ms: Annotated[
        float | None,
        typer.Option("--time", help="of maps, field and drives [ms] [default: when most happens]", metavar="MS"),
    ] = None,
    place: Annotated[
        list[str] | None,
        typer.Option(help="point of the skin in the world as the run begins [mm]; may be repeated", metavar="X,Y,Z"),
    ] = None,
    limits: Annotated[
        str | None, typer.Option(help="ends of the colours or of the axis, in its unit", metavar="LOW,HIGH")
    ] = None,
    skin: Annotated[str | None, typer.Option(help="which skin, where the run has several", metavar="NAME")] = None,
    quantity: Annotated[str, typer.Option(help="of the skin's motion: displacement or velocity")] = "displacement",
    observer: Annotated[str | None, typer.Option(help="of levels [default: each]", metavar="NAME")] = None,
    suffix: Annotated[str, typer.Option("--format", help="png, svg or pdf")] = "png",
    out: Annotated[Path | None, typer.Option(help="folder for the pictures [default: DIR/plots]")] = None,
    listed: Annotated[
        bool, typer.Option("--list", help="say which kinds there are; of a run, draw small ones into one")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Draw pictures of a run for a paper: field, drives, maps of motion and of levels, courses, spectra, wavefronts.

    PNG at 300 dpi, SVG or PDF. What a run doesn't hold is left out and said, or refused where it was named.

    Examples: palmfield plot out/palm

    palmfield plot out/palm motion wavefronts --time 12.5 --format svg

    palmfield plot skin.md --format pdf  (speed against error, after palmfield bench skin --out skin.md)
    """
    from palmfield.cli.plot import list_kinds, plot
    from palmfield.outputs.pictures.asked import asked_for

    if listed:
        list_kinds(run, out, as_json)
        return
    if run is None:
        raise SceneError("plot needs DIR, the folder of a run; `palmfield plot --list` says what it can draw")
    asked = asked_for(time_ms, place or (), limits, skin, quantity, observer)
    named = [name for word in kinds or () for name in word.split(",") if name]
    plot(run, named, asked, out=out, suffix=suffix, quiet=context.obj, as_json=as_json)


@app.command("render")
def render_command(
    context: typer.Context,
    run: Annotated[Path, typer.Argument(help="folder of a run, or its result.nc", metavar="DIR")],
    video: Annotated[Path, typer.Option(help="the film to write, an MP4", metavar="FILE.mp4")],
    start_ms: Annotated[float | None, typer.Option("--from", help="[ms] [default: the run's begin]")] = None,
    end_ms: Annotated[float | None, typer.Option("--to", help="[ms] [default: the run's end]")] = None,
    slow: Annotated[float, typer.Option(help="times slower than it was: at 200 a second of film is 5 ms")] = 200.0,
    magnify: Annotated[
        float | None, typer.Option(help="of the motion [default: the largest is seen as about 2 mm]")
    ] = None,
    show: Annotated[str, typer.Option(help="the colours: displacement, velocity or arp")] = "displacement",
    limits: Annotated[
        str | None, typer.Option(help="ends of the colours, in um, um/s or Pa", metavar="LOW,HIGH")
    ] = None,
    size: Annotated[str, typer.Option(help="[pixels]", metavar="WIDTHxHEIGHT")] = "960x720",
    as_json: AsJson = False,
) -> None:
    """Make a film of a run: the hand with the motion or the ARP on its skin, slowed down and magnified.

    Takes half a second of one core a frame, shared out among all; Ctrl-C keeps what is drawn by then. Needs the extra
    `video`.

    Example: palmfield render out/palm --video palm.mp4 --from 20 --to 40
    """
    from palmfield.cli.render import render, size_of
    from palmfield.outputs.film import Cut
    from palmfield.outputs.pictures.asked import asked_for

    ends = asked_for(None, (), limits, None, "displacement", None).limits
    start, end = (None if at is None else 1e-3 * at for at in (start_ms, end_ms))
    cut = Cut(start, end, slow, magnify, show, ends, size_of(size))
    render(run, video, cut, quiet=context.obj, as_json=as_json)


@app.command("view")
def view_command(
    context: typer.Context,
    scene: SceneFile,
    out: Annotated[
        Path | None, typer.Option(help="folder in which recordings are made [default: out/view_SCENE]")
    ] = None,
    device: Device = None,
    accuracy: Accuracy = None,
    board: BoardName = None,
    keys: Keys = None,
    modes: Annotated[
        bool,
        typer.Option(
            "--modes", help="skins move by modes for any sound, so that sliders act at once; made once, in minutes"
        ),
    ] = False,
    host: Annotated[
        str, typer.Option(help="address to listen at; another than this machine's own gets a token")
    ] = "127.0.0.1",
    port: Annotated[
        int | None, typer.Option(min=1, max=65535, help="[default: the first free one from 8080 on]")
    ] = None,
    rate: Annotated[
        float | None, typer.Option(help="pictures a second [default: 15, on a GPU 30]", metavar="HZ")
    ] = None,
    pace: Annotated[str, typer.Option(help="at most so many simulated seconds in a second, or max", metavar="X")] = "1",
    browser: Annotated[bool, typer.Option("--browser", help="open the page in the default browser")] = False,
) -> None:
    """Run a scene and watch it in the browser: hand, array, sound and motion on the skin, level above threshold.

    Sliders turn focus, modulation, path, level and the hand's pose; a recording is a result folder, as of
    `palmfield run`. Ctrl-C ends it. Needs the extra `view`.

    Example: palmfield view mjcf/scenes/palm_am200.xml
    """
    from palmfield.cli.view import show

    show(
        scene, out, device=device, accuracy=accuracy, board=board, keys=given_keys(keys), modes=modes, host=host,
        port=port, rate_Hz=rate, pace=pace, browser=browser, quiet=context.obj,
    )  # fmt: skip


@app.command("usd")
def usd_command(
    context: typer.Context,
    run: Annotated[Path | None, typer.Argument(help="folder of a run, or its result.nc", metavar="[DIR]")] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="the scene to write, .usdc, .usda or .usdz [default: DIR/scene.usdc]", metavar="FILE"),
    ] = None,
    colour: Annotated[
        str,
        typer.Option(help="what skins are coloured by (see --list), or none"),
    ] = "normal_displacement",
    limits: Annotated[
        str | None, typer.Option(help="ends of the colours, in m, m/s, Pa or dB", metavar="LOW,HIGH")
    ] = None,
    magnify: Annotated[
        float | None,
        typer.Option(
            help="of the motion in the variant 'magnified'; 0 for no such variant [default: the largest is seen as "
            "about 2 mm, if it takes 8 MB or less]"
        ),
    ] = None,
    quantities: Annotated[
        str | None, typer.Option(help="which are written as primvars [default: all]", metavar="NAME,...")
    ] = None,
    start_ms: Annotated[float | None, typer.Option("--from", help="[ms] [default: the run's begin]")] = None,
    end_ms: Annotated[float | None, typer.Option("--to", help="[ms] [default: the run's end]")] = None,
    frames: Annotated[int, typer.Option(help="at most so many time codes; others of the run are left out")] = 600,
    field: Annotated[
        list[str] | None, typer.Option(help="slice, points or isosurface of the sound; may be repeated")
    ] = None,
    field_ms: Annotated[
        list[float] | None,
        typer.Option("--field-time", help="when [ms]; may be repeated [default: when the array is loudest]"),
    ] = None,
    level_Pa: Annotated[
        float | None,
        typer.Option(
            "--level", help="of the isosurface, and from where on there are points [Pa] [default: half of most]"
        ),
    ] = None,
    observer: Annotated[str, typer.Option(help="of the level above threshold")] = "bolanowski_1988",
    check: Annotated[bool, typer.Option("--check", help="run all of USD's validators on the file")] = False,
    listed: Annotated[
        bool, typer.Option("--list", help="say what skins can be coloured by, and write nothing")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Write a run as a USD scene for usdview, Blender or Omniverse: hands, skins, arrays, foci, field, rigid bodies.

    Every skin has what the run recorded of it as primvars over time, and colours that any viewer shows. Exit code 4
    where --check finds something. What is in the file: docs/usd.md.

    Examples: palmfield usd out/palm --colour arp --out palm.usdz

    palmfield usd out/palm --from 20 --to 40 --magnify 5000 --field slice --field isosurface --check
    """
    from palmfield.cli.usd import list_quantities, write_scene
    from palmfield.outputs.pictures.asked import asked_for
    from palmfield.outputs.usd.shown import Shown

    if listed:
        list_quantities(as_json)
        return
    if run is None:
        raise SceneError(
            "usd needs DIR, the folder of a run; `palmfield usd --list` says what skins can be coloured by"
        )
    start, end = (None if at is None else 1e-3 * at for at in (start_ms, end_ms))
    shown = Shown(
        colour=colour, limits=asked_for(None, (), limits, None, "displacement", None).limits, magnify=magnify,
        quantities=None if quantities is None else tuple(name for name in quantities.split(",") if name),
        start_s=start, end_s=end, frames=frames, field=tuple(field or ()),
        field_times_s=tuple(1e-3 * at for at in field_ms or ()), level_Pa=level_Pa, observer=observer,
    )  # fmt: skip
    if write_scene(run, out, shown, check=check, quiet=context.obj, as_json=as_json):
        raise typer.Exit(4)


@app.command()
def recover(out: Annotated[Path, typer.Argument(help="folder of a run that was cut off", metavar="DIR")]) -> None:
    """Assemble the results of a run that was cut off into DIR/result.nc, marked incomplete, and draw its pictures.

    Example: palmfield recover out/palm
    """
    from palmfield.session.recorded_run import recover as finish

    for path in finish(out, progress=True).values():
        print(f"wrote {path}")


NOTHING_KEPT = "nothing is kept: PALMFIELD_CACHE is off"
cache_app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode=None,
    help="What earlier runs have left for later ones: small models of the skin and error estimates, in the user's "
    "cache folder or where PALMFIELD_CACHE says (off: nothing is kept), up to PALMFIELD_CACHE_MB [2048].\n\n"
    "Example: palmfield cache list",
)
app.add_typer(cache_app, name="cache")


@cache_app.command("list")
def cache_list() -> None:
    """Say what is kept, how large it is and when it was last used.

    Example: palmfield cache list
    """
    import time

    from palmfield import cache

    where, kept = cache.folder(), cache.entries()
    if where is None:
        print(NOTHING_KEPT)
        return
    for entry in kept:
        print(f"{entry.size_bytes / 1e6:8.1f} MB  used {_ago(time.time() - entry.used):>9} ago  {entry.path.name}")
    total = sum(entry.size_bytes for entry in kept)
    print(f"{len(kept)} kept in {where}: {total / 1e6:.1f} MB of {cache.limit_bytes() / 1e6:.0f} MB")


def _ago(seconds: float) -> str:
    for unit, length in (("days", 86400.0), ("hours", 3600.0), ("min", 60.0)):
        if seconds >= 2.0 * length:
            return f"{seconds / length:.0f} {unit}"
    return f"{max(seconds, 0.0):.0f} s"


@cache_app.command("clear")
def cache_clear() -> None:
    """Remove all that is kept: the next runs compute it again.

    Example: palmfield cache clear
    """
    from palmfield import cache

    where, kept = cache.folder(), cache.entries()
    if where is None:
        print(NOTHING_KEPT)
        return
    total = sum(entry.size_bytes for entry in kept)
    print(f"removed {cache.clear()} from {where}: {total / 1e6:.1f} MB")


app.add_typer(calibrate, name="calibrate")
app.add_typer(stimulus, name="stimulus")
app.add_typer(experiment, name="experiment")
app.add_typer(track, name="track")

bench = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode=None,
    help="Measure how fast palmfield is on this machine, and how exact.\n\nExample: palmfield bench field",
)
app.add_typer(bench, name="bench")


@bench.command("field")
def bench_field(
    out: Annotated[Path | None, typer.Option(help="markdown file to write the table to")] = None,
    picture: Annotated[Path | None, typer.Option(help="PNG to draw speed against error in")] = None,
    device: Annotated[str, typer.Option(help="where it is computed: cpu or cuda:0")] = "cpu",
    points: Annotated[int, typer.Option(help="roughly how many points a range of distances has")] = 20_000,
    runs: Annotated[int, typer.Option(help="how often each method runs; medians are printed")] = 5,
    only: Annotated[str, typer.Option(help="leave out methods whose names lack this text")] = "",
    commit: Annotated[str, typer.Option(help="for the head, where no git is [default: git's]")] = "",
) -> None:
    """Speed and error of the pressure field, as a markdown table.

    996 transducers, two ranges of distances. Every method computes the same problem in a process of its own, in turns
    with the others, so that what else the machine does meets all alike. Errors are against float64. A yardstick in the
    head says how fast the machine was: compare speeds within one table, not between tables. In a clone of palmfield
    scripts/bench/compare_field.py puts other programs beside it.

    Examples: palmfield bench field --only gradient

    palmfield bench field --out field.md --picture field.png
    """
    from palmfield.studies.bench.field import main as measure

    print(measure(out, picture, device, points, runs, only, commit), end="")


@bench.command("skin")
def bench_skin(
    out: Annotated[Path | None, typer.Option(help="markdown file to write the table to")] = None,
    picture: Annotated[Path | None, typer.Option(help="PNG to draw time against error in")] = None,
    device: Annotated[str, typer.Option(help="where it is computed: cpu or cuda:0")] = "cpu",
    runs: Annotated[int, typer.Option(help="how often each method runs; medians are printed")] = 3,
    only: Annotated[str, typer.Option(help="leave out methods whose names lack this text")] = "",
    commit: Annotated[str, typer.Option(help="for the head, where no git is [default: git's]")] = "",
) -> None:
    """Time and error of the skin solvers on one slab, as a markdown table.

    Each at several wanted accuracies. Errors are against plane waves in depth, which are exact. It takes some minutes.
    In a clone of palmfield scripts/bench/compare_skin.py puts scikit-fem, warp.fem and MuJoCo's flexes beside them.

    Examples: palmfield bench skin --only lateral_waves

    palmfield bench skin --out skin.md --picture skin.png
    """
    from palmfield.studies.bench.skin import main as measure

    print(measure(out, picture, device, runs, only, commit), end="")


@bench.command("scene")
def bench_scene(
    scenes: Annotated[
        list[str] | None, typer.Argument(help="files, or names of shipped scenes [default: eleven shipped ones]")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", "--write", help="markdown file to write the table to")] = None,
    device: Annotated[str, typer.Option(help="where scenes are computed: cpu or cuda:0")] = "cpu",
    steps: Annotated[int, typer.Option(help="steps that sound, at least, for each scene")] = 2000,
    known: Annotated[bool, typer.Option("--known", help="scenes as they are, with their load known ahead")] = False,
    error: Annotated[bool, typer.Option("--error", help="also hold each run against the whole layer")] = False,
    seed: Annotated[int, typer.Option(help="of what is drawn at random")] = 0,
    commit: Annotated[str, typer.Option(help="for the head, where no git is [default: git's]")] = "",
) -> None:
    """Speed of whole scenes, and with --error their error beside it, as a markdown table.

    Wall milliseconds for a simulated one, in plain mj_step over whole runs. Path, level and pose are drawn after the
    model is built, so that skins move by modes that serve every load; --known measures the scenes as they are. Each
    scene runs in processes of its own: once with an empty cache, once with what that left there. --error takes
    minutes a scene.

    Examples: palmfield bench scene palm_am200 palm_circle

    palmfield bench scene --known --write realtime.md
    """
    from palmfield.studies.bench.scene import main as measure

    print(measure(scenes, out, device, steps, known, error, seed, commit), end="")


def main() -> None:
    """Entry point: users' errors become one line on standard error and exit code 2."""
    try:
        app(_anywhere(sys.argv[1:]), standalone_mode=True)
    except PalmfieldError as error:
        complain(str(error))
        sys.exit(2)
    except (KeyboardInterrupt, SystemExit, Exception) as error:
        if isinstance(error, SystemExit) and not _unsaid(error):
            raise
        if not _from_ctrl_c(error):
            raise
        complain("interrupted")
        sys.exit(INTERRUPTED_CODE)


def _unsaid(error: SystemExit) -> bool:
    """Whether Typer ended the program for Ctrl-C, of which it says nothing; commands that do raise Exit from None."""
    ended = error.__context__
    return error.code == INTERRUPTED_CODE and ended is not None and isinstance(ended.__cause__, KeyboardInterrupt)


def _from_ctrl_c(error: BaseException) -> bool:
    """Whether an error stands for Ctrl-C: libraries that it meets while they are loaded raise errors of their own."""
    causes = (error.__cause__, error.__context__)
    return isinstance(error, KeyboardInterrupt) or any(_from_ctrl_c(cause) for cause in causes if cause is not None)


def _anywhere(arguments: list[str]) -> list[str]:
    """Arguments with the options of the whole program before the command."""
    first, rest, waiting = [], [], 0
    for argument in arguments:
        name, equals, _ = argument.partition("=")
        if waiting or name in ANYWHERE:
            first.append(argument)
            waiting = waiting - 1 if waiting else ANYWHERE[name] * (not equals)
        else:
            rest.append(argument)
    return first + rest
