"""`palmfield calibrate`: from a laboratory's readings to a calibration file."""

from pathlib import Path
from typing import Annotated

import typer

from palmfield.cli.drive import show_performance

calibrate = typer.Typer(
    name="calibrate",
    no_args_is_help=True,
    rich_markup_mode=None,
    help="Measure what a real array does, and write it into a file that scenes and boards take.\n\n"
    "Each measurement is a CSV file of readings and adds its part to the calibration (docs/calibration.md). Begin with "
    "`palmfield calibrate kinds`, or without an array with `palmfield calibrate rehearse trial`.\n\n"
    "Example: palmfield calibrate add elements readings.csv board.json --layout sonicsurface --source 'our lab'",
)
Layout = Annotated[str | None, typer.Option(help="the array, where the calibration is new (docs/arrays.md)")]


@calibrate.command("kinds")
def kinds() -> None:
    """List the kinds of measurements: what is done, and the columns of their CSV files.

    Example: palmfield calibrate kinds
    """
    from palmfield.drive.calibration.readings import MEASUREMENTS

    for name, measurement in MEASUREMENTS.items():
        print(f"{name}: {measurement.about}")
        more = f"; also {', '.join(measurement.optional)}" if measurement.optional else ""
        print(f"  columns {', '.join(measurement.columns)}{more}")


@calibrate.command("add")
def add(
    kind: Annotated[str, typer.Argument(help="of the measurement: see `palmfield calibrate kinds`", metavar="KIND")],
    readings: Annotated[Path, typer.Argument(help="CSV file", metavar="READINGS.csv")],
    board: Annotated[Path, typer.Argument(help="the calibration, made if it is not there", metavar="BOARD.json")],
    layout: Layout = None,
    source: Annotated[str, typer.Option(help="who measured when, and with what")] = "",
    focus: Annotated[
        tuple[float, float, float] | None, typer.Option(help="that the board was told to make [m]", metavar="X Y Z")
    ] = None,
    plate: Annotated[tuple[float, float] | None, typer.Option(help="sides of the plate [m]", metavar="X Y")] = None,
    level: Annotated[float, typer.Option(help="pressure relative to full drive at which it sounded")] = 1.0,
    temperature: Annotated[float, typer.Option(help="of the air [C]")] = 20.0,
    humidity: Annotated[float, typer.Option(help="of the air [%]")] = 50.0,
    pressure: Annotated[float, typer.Option(help="of the air [Pa]")] = 101325.0,
    microphone_error: Annotated[
        float, typer.Option(help="of the microphone's own calibration, 95 %, relative (0.12 is 1 dB)")
    ] = 0.12,
    place_sd: Annotated[float, typer.Option(help="standard deviation of the microphone's places by axis [m]")] = 1e-3,
    temperature_sd: Annotated[float, typer.Option(help="standard deviation of the temperature [K]")] = 1.0,
) -> None:
    """Put what readings say into a calibration, and print it with its uncertainty.

    Examples: palmfield calibrate add elements elements.csv board.json --layout sonicsurface --source "our lab"

    palmfield calibrate add plate plate.csv board.json --plate 0.1 0.1 --focus 0 0 0.15 --source "our lab, scale"
    """
    from palmfield.acoustics.air import check
    from palmfield.drive.calibration.readings import MEASUREMENTS, Circumstances
    from palmfield.errors import SceneError, did_you_mean
    from palmfield.hardware.calibrate import add_readings
    from palmfield.types import Air

    if kind not in MEASUREMENTS:
        raise SceneError(
            f"kind '{kind}' is not known{did_you_mean(kind, MEASUREMENTS)}; allowed: {', '.join(MEASUREMENTS)}"
        )
    air = Air(temperature, humidity, pressure)
    check(air)
    circumstances = Circumstances(source, air, microphone_error, place_sd, temperature_sd, focus, plate, level)
    for line in add_readings(kind, readings, board, layout, circumstances):
        print(line)
    print(f"wrote {board}")


@calibrate.command("import")
def import_(
    file: Annotated[Path, typer.Argument(help="the vendor's file of an OpenMPD board", metavar="BOARD_N.pat")],
    board: Annotated[Path, typer.Argument(help="the new calibration", metavar="BOARD.json")],
) -> None:
    """Write a vendor's file of one OpenMPD board (pins, phases, polarities) as a calibration.

    Example: palmfield calibrate import board_10.pat board.json
    """
    from palmfield.hardware.calibrate import imported

    for line in imported(file, board):
        print(line)
    print(f"wrote {board}")


@calibrate.command("sound")
def sound(
    board: Annotated[str, typer.Argument(help="which board (see `palmfield boards`)", metavar="BOARD")],
    port: Annotated[str | None, typer.Option(help="of the board")] = None,
    record: Annotated[Path | None, typer.Option(help="file for the bytes instead")] = None,
    element: Annotated[
        list[int] | None, typer.Option(help="by number from 0, in the layout's order; may be repeated [default: all]")
    ] = None,
    dwell: Annotated[float, typer.Option(help="how long each sounds [s]")] = 0.5,
    pause: Annotated[float, typer.Option(help="silence before each [s]")] = 0.2,
    times: Annotated[Path, typer.Option(help="CSV file of element, from_s, to_s, to cut a recording by")] = Path(
        "sounding.csv"
    ),
    log: Annotated[Path | None, typer.Option(help="file of what was sent when")] = None,
) -> None:
    """Sound one transducer after the other at full drive, as they are wired: what kind `elements` is measured on.

    Examples: palmfield calibrate sound sonicsurface --port /dev/ttyUSB0

    palmfield calibrate sound sonicsurface --port /dev/ttyUSB0 --element 17 --dwell 5
    """
    from palmfield.hardware.one_by_one import sound_one_by_one
    from palmfield.hardware.play import Target

    done = sound_one_by_one(
        board, Target(port, record, log), times, elements=element or None, dwell_s=dwell, pause_s=pause, progress=True
    )
    print(f"wrote {times}")
    show_performance(done)


@calibrate.command("show")
def show(
    board: Annotated[Path, typer.Argument(help="the calibration", metavar="BOARD.json")],
    png: Annotated[
        Path | None, typer.Option(help="draw phase, polarity and gain over the board", metavar="FILE")
    ] = None,
) -> None:
    """Say what a calibration holds and what is missing, and draw it.

    Example: palmfield calibrate show board.json --png board.png
    """
    from palmfield.hardware.calibrate import described

    for line in described(board, png):
        print(line)


@calibrate.command("rehearse")
def rehearse(
    folder: Annotated[Path, typer.Argument(help="for the files", metavar="DIR")],
    layout: Annotated[str, typer.Option(help="the array (docs/arrays.md)")] = "sonicsurface",
    seed: Annotated[int, typer.Option(help="of what is drawn at random")] = 0,
) -> None:
    """Write readings of an imaginary board, and truth.json, what it is like, to try a calibration without an array.

    Example: palmfield calibrate rehearse trial
    """
    from palmfield.hardware.calibrate import rehearsed

    for line in rehearsed(layout, folder, seed):
        print(line)
