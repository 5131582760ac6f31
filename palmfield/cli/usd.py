"""`palmfield usd`: write a run as a USD scene."""

from pathlib import Path
from typing import Annotated

import typer

from palmfield.cli.as_json import print_json
from palmfield.cli.options import AsJson, From, To
from palmfield.errors import SceneError


def usd(
    context: typer.Context,
    run: Annotated[Path | None, typer.Argument(help="folder of a run, or its result.nc", metavar="[DIR]")] = None,
    out: Annotated[
        Path | None, typer.Option(help="file to write: .usdc, .usda or .usdz [default: DIR/scene.usdc]", metavar="FILE")
    ] = None,
    colour: Annotated[
        str, typer.Option(help="quantity shown by the colours of the skins (see --list), or none")
    ] = "normal_displacement",
    limits: Annotated[
        str | None, typer.Option(help="limits of the colour scale, in m, m/s, Pa or dB", metavar="LOW,HIGH")
    ] = None,
    magnify: Annotated[
        float | None,
        typer.Option(
            help="magnification of the motion in the variant 'magnified'; 0 for no such variant [default: the largest "
            "displacement appears as about 2 mm, if the variant takes 8 MB or less]"
        ),
    ] = None,
    quantities: Annotated[
        str | None, typer.Option(help="quantities written as primvars [default: all]", metavar="NAME,...")
    ] = None,
    start_ms: From = None,
    end_ms: To = None,
    frames: Annotated[
        int, typer.Option(help="largest number of time codes; further ones of the run are omitted")
    ] = 600,
    field: Annotated[
        list[str] | None, typer.Option(help="sound field to write: slice, points or isosurface; may be repeated")
    ] = None,
    field_ms: Annotated[
        list[float] | None,
        typer.Option(
            "--field-time", help="time of the sound field [ms]; may be repeated [default: time of the highest drive]"
        ),
    ] = None,
    level_Pa: Annotated[
        float | None,
        typer.Option(
            "--level", help="level of the isosurface and lowest level of the points [Pa] [default: half of the maximum]"
        ),
    ] = None,
    observer: Annotated[str, typer.Option(help="observer of the level above threshold")] = "bolanowski_1988",
    check: Annotated[bool, typer.Option("--check", help="check the file with all USD validators")] = False,
    listed: Annotated[bool, typer.Option("--list", help="list the quantities for --colour, and write no file")] = False,
    as_json: AsJson = False,
) -> None:
    """Write a run as a USD scene for usdview, Blender or Omniverse: hands, skins, arrays, foci, field, rigid bodies.

    Every skin has its recorded quantities as primvars over time, and colours for any viewer. The exit code is 4 if
    --check finds errors. docs/usd.md describes the file.

    Examples: palmfield usd out/palm --colour arp --out palm.usdz

    palmfield usd out/palm --from 20 --to 40 --magnify 5000 --field slice --field isosurface --check
    """
    from palmfield.interrupts import interrupts_delayed
    from palmfield.outputs.pictures.options import parse_options
    from palmfield.outputs.store import open_result
    from palmfield.terminal import bars

    with interrupts_delayed():  # OpenUSD would swallow Ctrl-C while it is loaded, and be incomplete
        from palmfield.outputs.usd.shown import Shown
        from palmfield.outputs.usd.validation import validate_usd
        from palmfield.outputs.usd.write import write_usd

    if listed:
        _list_quantities(as_json)
        return
    if run is None:
        raise SceneError("usd needs DIR, the folder of a run; `palmfield usd --list` lists the quantities for --colour")
    start, end = (None if at is None else 1e-3 * at for at in (start_ms, end_ms))
    shown = Shown(
        colour=colour, limits=parse_options(None, (), limits, None, "displacement", None).limits, magnify=magnify,
        quantities=None if quantities is None else tuple(name for name in quantities.split(",") if name),
        start_s=start, end_s=end, frames=frames, field=tuple(field or ()),
        field_times_s=tuple(1e-3 * at for at in field_ms or ()), level_Pa=level_Pa, observer=observer,
    )  # fmt: skip
    path = out or (run if run.is_dir() else run.parent) / "scene.usdc"
    with open_result(run) as result, bars(not context.obj) as bar:
        task = bar.add_task("writing frames", total=None)
        write_usd(result, path, shown, on_frame=lambda done, of: bar.update(task, completed=done, total=of))
    findings = validate_usd(path) if check else []
    if as_json:
        print_json({"usd": str(path), "bytes": path.stat().st_size, "findings": findings if check else None})
    else:
        print(f"wrote {path}: {path.stat().st_size / 1e6:.2f} MB")
        for line in findings:
            print(line)
        if check and not findings:
            print("the USD validators report no errors")
    if findings:
        raise typer.Exit(4)


def _list_quantities(as_json: bool) -> None:
    """Print the quantities for the colours of skins."""
    from palmfield.outputs.usd.quantities import QUANTITIES

    if as_json:
        print_json({name: {"unit": one.unit, "sign": one.sign} for name, one in QUANTITIES.items()})
        return
    for name, one in QUANTITIES.items():
        print(f"{name:20} [{one.unit}] {one.sign}")
