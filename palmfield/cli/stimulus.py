"""`palmfield stimulus`: import and export tables of foci, STM files of AUTD3 devices, and patterns of Adaptics."""

from pathlib import Path
from typing import Annotated, cast

import typer

from palmfield.cli.as_json import print_json
from palmfield.cli.options import SceneFile, group, parsed_keys

stimulus = group(
    "stimulus",
    "Import a stimulus into a scene, or export it, as a table of focus positions and intensities over time.\n\nA "
    "table is a CSV file with columns t, x, y, z, intensity (x1, y1, ... for several foci) and a head with frame, "
    "rate, units and the quantity of the intensities (docs/stimuli.md). A .json file is an STM of AUTD3 "
    "units, an .adaptics file a pattern of the design tool Adaptics.\n\nExample: "
    "palmfield stimulus export mjcf/scenes/palm_circle.xml circle.csv",
)
Kinds = Annotated[Path, typer.Argument(help="table (.csv), STM of AUTD3 units (.json), or .adaptics", metavar="FILE")]
Which = Annotated[
    str | None,
    typer.Option("--stimulus", help="name of the stimulus instance [default: the only one]", metavar="INSTANCE"),
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="replace existing files")]
SetKeys = Annotated[
    list[str] | None, typer.Option("--set", help="set a key, as in `palmfield run`", metavar="INSTANCE.KEY=VALUE")
]


@stimulus.command("import")
def import_command(
    file: Kinds,
    scene: Annotated[
        Path, typer.Option(help="scene that receives the stimulus; its file is not changed", metavar="SCENE")
    ],
    out: Annotated[
        Path | None, typer.Option(help="scene to write, in SCENE's folder [default: SCENE_FILE.xml]", metavar="NEW.xml")
    ] = None,
    which: Which = None,
    site: Annotated[
        str | None, typer.Option(help="for a table with frame skin: the site whose frame it uses", metavar="SITE")
    ] = None,
    repeat: Annotated[bool, typer.Option("--repeat", help="repeat the table from its beginning when it ends")] = False,
    rate: Annotated[
        float | None,
        typer.Option(help="samples per second of .adaptics [default: 10 or more in each period of AM and brush, "
                     "1000 to 40000]", metavar="HZ"),
    ] = None,
    duration: Annotated[
        float | None, typer.Option(help="duration of .adaptics [s] [default: to its stop or last keyframe]")
    ] = None,
    parameters: Annotated[
        list[str] | None,
        typer.Option("--set-parameter", help="set a parameter of .adaptics; may be repeated", metavar="NAME=VALUE"),
    ] = None,
    overwrite: Overwrite = False,
) -> None:  # fmt: skip
    """Write a scene that plays the foci of FILE, and next to it the table that the scene reads.

    Path, focus, modulation and bursts of the stimulus in the scene are removed, because the table gives positions and
    intensities of the foci. Level (drive_amplitude or arp_peak_Pa, for intensity 1), start and end are kept. The
    commands plan, run and drive accept the new scene. An invalid table gives an error with line and column.

    Example: palmfield stimulus import circle.csv --scene first/first.xml --repeat
    """
    from palmfield.errors import SceneError
    from palmfield.session.stimulus_import import import_stimulus
    from palmfield.stimulus.adaptics import Sampling

    try:
        values = {name: float(value) for name, _, value in (text.rpartition("=") for text in parameters or ())}
    except ValueError:
        raise SceneError(f"--set-parameter has value {' '.join(parameters or ())}; allowed: NAME=NUMBER") from None
    done = import_stimulus(
        file, scene, out, stimulus=which, site=site, repeat=repeat, overwrite=overwrite,
        sampling=Sampling(rate, duration, values) if (rate, duration, parameters) != (None,) * 3 else None,
    )  # fmt: skip
    foci = "one focus" if done.foci == 1 else f"{done.foci} foci at once"
    print(f"{done.scene}: stimulus '{done.stimulus}' plays {done.table.name}: {foci}, {done.rows} rows, "
          f"{done.length_s:g} s at {done.rate_Hz:g} Hz")  # fmt: skip
    if done.dropped:
        print(f"removed keys: {', '.join(done.dropped)}")
    print(f"next: palmfield plan {done.scene}")


@stimulus.command("export")
def export_command(
    scene: SceneFile,
    file: Kinds,
    which: Which = None,
    rate: Annotated[
        float | None,
        typer.Option(help="samples per second [default: the step rate of the stimulus, or 1000]", metavar="HZ"),
    ] = None,
    quantity: Annotated[
        str | None,
        typer.Option(
            help="quantity of the intensities: duty, amplitude or arp [default: arp, or that of the table in the "
            "scene; for .adaptics amplitude]"
        ),
    ] = None,
    frame: Annotated[str, typer.Option(help="frame of the table: array, or skin (the site of the stimulus)")] = "array",
    duration: Annotated[float | None, typer.Option(help="duration [s] [default: from the scene]")] = None,
    repeat: Annotated[bool, typer.Option("--repeat", help="for an STM: repeat without end")] = False,
    keys: SetKeys = None,
    overwrite: Overwrite = False,
) -> None:
    """Write positions and intensities of the foci of a stimulus over time.

    Each row is one sample; a row equal to the previous row is omitted. Positions in the frame of the array follow
    moving hands and arrays. The rates of AUTD3 devices are 40 kHz divided by a whole number.

    Examples: palmfield stimulus export mjcf/scenes/palm_circle.xml circle.csv --rate 2000

    palmfield stimulus export mjcf/scenes/palm_circle.xml circle.json --rate 1000 --duration 0.1 --repeat
    """
    from typing import get_args

    from palmfield.errors import SceneError, refuse_unknown
    from palmfield.session.stimulus_export import export_stimulus, exported
    from palmfield.stimulus.focus_table import Quantity, TableFrame

    if quantity is None and file.suffix.lower() == ".adaptics":
        quantity = "amplitude"
    if quantity is not None:
        refuse_unknown(SceneError, "--quantity has value {}", quantity, get_args(Quantity))
    refuse_unknown(SceneError, "--frame has value {}", frame, ("array", "skin"))
    result = exported(
        scene, stimulus=which, rate_Hz=rate, quantity=cast(Quantity | None, quantity), frame=cast(TableFrame, frame),
        duration_s=duration, keys=parsed_keys(keys),
    )  # fmt: skip
    notes = export_stimulus(result, file, again=repeat, overwrite=overwrite)
    table = result.table
    print(f"{file}: {table.foci} x {len(table.samples)} rows at {table.rate_Hz:g} Hz, {table.length_s:g} s, "
          f"intensities of {table.quantity}, frame {table.frame}, between rows {table.between}")  # fmt: skip
    for warning in (*notes, *result.warnings):
        print(f"note: {warning}")


@stimulus.command("standard")
def standard_command(
    name: Annotated[str | None, typer.Argument(help="name of one stimulus [default: list all]", metavar="NAME")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="for other programs")] = False,
) -> None:
    """Show the standard stimuli, which are taken from published experiments, with source, published result and keys.

    `palmfield new SCENE --stimulus NAME` writes a scene with one of them.

    Example: palmfield stimulus standard lm_small_steps
    """
    from palmfield.stimulus.standard import names, standard

    shown = [standard(one) for one in ([name] if name is not None else names())]
    if as_json:
        print_json({"stimuli": [one.model_dump() for one in shown]} if name is None else shown[0].model_dump())
    elif name is None:
        width = max(map(len, names()))
        for one in shown:
            print(f"{one.name:<{width}}  {one.about}")
    else:
        (one,) = shown
        print(f"{one.name}: {one.about}\nsource: {one.source} (read: {one.read})\npublished: {one.published}")
        if one.assumed:
            print(f"chosen by palmfield: {one.assumed}")
        print(f"duration {one.duration_s:g} s, keys of palmfield.stimulus:")
        for key, value in one.texts().items():
            print(f'  <config key="{key}" value="{value}"/>')
