"""`palmfield calibrate`: make a calibration file from laboratory readings."""

from pathlib import Path
from typing import Annotated

import typer

from palmfield.cli.drive import show_performance
from palmfield.cli.options import group

calibrate = group(
    "calibrate",
    "Calibrate a real array, and write the result to a file for scenes and boards.\n\nEach measurement is a CSV "
    "file of readings and adds one part to the calibration (docs/calibration.md). Begin with `palmfield calibrate "
    "kinds`, or, without an array, with `palmfield calibrate rehearse trial`.\n\nExample: palmfield calibrate add "
    "elements readings.csv board.json --layout sonicsurface --source 'our lab'",
)
Layout = Annotated[str | None, typer.Option(help="layout of the array, for a new calibration (docs/arrays.md)")]


@calibrate.command("kinds")
def kinds() -> None:
    """List the kinds of measurements, with their procedure and the columns of their CSV files.

    Example: palmfield calibrate kinds
    """
    from palmfield.drive.calibration.readings import MEASUREMENTS

    for name, measurement in MEASUREMENTS.items():
        print(f"{name}: {measurement.about}")
        more = f"; also {', '.join(measurement.optional)}" if measurement.optional else ""
        print(f"  columns {', '.join(measurement.columns)}{more}")


@calibrate.command("add")
def add(
    kind: Annotated[str, typer.Argument(help="kind of measurement, see `palmfield calibrate kinds`", metavar="KIND")],
    readings: Annotated[Path, typer.Argument(help="CSV file", metavar="READINGS.csv")],
    board: Annotated[Path, typer.Argument(help="calibration file; created if it does not exist", metavar="BOARD.json")],
    layout: Layout = None,
    source: Annotated[str, typer.Option(help="who measured, when, and with which instrument")] = "",
    focus: Annotated[
        tuple[float, float, float] | None, typer.Option(help="focus that was commanded [m]", metavar="X Y Z")
    ] = None,
    plate: Annotated[
        tuple[float, float] | None, typer.Option(help="side lengths of the plate [m]", metavar="X Y")
    ] = None,
    level: Annotated[float, typer.Option(help="drive level during the measurement, relative to full drive")] = 1.0,
    temperature: Annotated[float, typer.Option(help="of the air [C]")] = 20.0,
    humidity: Annotated[float, typer.Option(help="of the air [%]")] = 50.0,
    pressure: Annotated[float, typer.Option(help="static pressure of the air [Pa]")] = 101325.0,
    microphone_error: Annotated[
        float, typer.Option(help="relative uncertainty of the calibration of the microphone, 95 % (0.12 is 1 dB)")
    ] = 0.12,
    place_sd: Annotated[
        float, typer.Option(help="standard deviation of the position of the microphone per axis [m]")
    ] = 1e-3,
    temperature_sd: Annotated[float, typer.Option(help="standard deviation of the air temperature [K]")] = 1.0,
) -> None:
    """Evaluate readings, add the result to a calibration, and print it with its uncertainty.

    Examples: palmfield calibrate add elements elements.csv board.json --layout sonicsurface --source "our lab"

    palmfield calibrate add plate plate.csv board.json --plate 0.1 0.1 --focus 0 0 0.15 --source "our lab, scale"
    """
    from palmfield.acoustics.air import check
    from palmfield.drive.calibration.readings import MEASUREMENTS, Circumstances
    from palmfield.errors import SceneError, refuse_unknown
    from palmfield.hardware.calibrate import add_readings
    from palmfield.types import Air

    refuse_unknown(SceneError, "kind {} is unknown", kind, MEASUREMENTS)
    air = Air(temperature, humidity, pressure)
    check(air)
    circumstances = Circumstances(source, air, microphone_error, place_sd, temperature_sd, focus, plate, level)
    for line in add_readings(kind, readings, board, layout, circumstances):
        print(line)
    print(f"wrote {board}")


@calibrate.command("import")
def import_(
    file: Annotated[Path, typer.Argument(help="file of the vendor for an OpenMPD board", metavar="BOARD_N.pat")],
    board: Annotated[Path, typer.Argument(help="the new calibration", metavar="BOARD.json")],
) -> None:
    """Convert the vendor's file for one OpenMPD board (pins, phases, polarities) to a calibration.

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
    record: Annotated[Path | None, typer.Option(help="write the bytes to this file instead")] = None,
    element: Annotated[
        list[int] | None,
        typer.Option(help="transducer number from 0, in the order of the layout; may be repeated [default: all]"),
    ] = None,
    dwell: Annotated[float, typer.Option(help="duration of each transducer [s]")] = 0.5,
    pause: Annotated[float, typer.Option(help="silence before each [s]")] = 0.2,
    times: Annotated[Path, typer.Option(help="CSV file of element, from_s, to_s, for cutting a recording")] = Path(
        "sounding.csv"
    ),
    log: Annotated[Path | None, typer.Option(help="log file of the frames sent and their times")] = None,
) -> None:
    """Sound one transducer after the other at full drive, as wired, for measurements of kind `elements`.

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
        Path | None, typer.Option(help="plot phase, polarity and gain over the board", metavar="FILE")
    ] = None,
) -> None:
    """Print which parts a calibration contains and which are missing, and draw it.

    Example: palmfield calibrate show board.json --png board.png
    """
    from palmfield.hardware.calibrate import described

    for line in described(board, png):
        print(line)


@calibrate.command("rehearse")
def rehearse(
    folder: Annotated[Path, typer.Argument(help="for the files", metavar="DIR")],
    layout: Annotated[str, typer.Option(help="layout of the array (docs/arrays.md)")] = "sonicsurface",
    seed: Annotated[int, typer.Option(help="seed of the random numbers")] = 0,
) -> None:
    """Write readings of an imaginary board, for practice without an array. Its true values are in truth.json.

    Example: palmfield calibrate rehearse trial
    """
    from palmfield.hardware.calibrate import rehearsed

    for line in rehearsed(layout, folder, seed):
        print(line)
