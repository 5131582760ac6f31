"""`palmfield usd`: a run as a USD scene."""

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
    start_ms: From = None,
    end_ms: To = None,
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
    from palmfield.outputs.pictures.asked import asked_for
    from palmfield.outputs.store import RESULT, open_result
    from palmfield.outputs.usd.shown import Shown
    from palmfield.outputs.usd.validation import validate_usd
    from palmfield.outputs.usd.write import write_usd
    from palmfield.terminal import bars

    if listed:
        _list_quantities(as_json)
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
    file = run / RESULT if run.is_dir() else run
    path = out or file.parent / "scene.usdc"
    with open_result(file) as result, bars(not context.obj) as bar:
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
            print("USD's validators find nothing")
    if findings:
        raise typer.Exit(4)


def _list_quantities(as_json: bool) -> None:
    """Print what skins can be coloured by."""
    from palmfield.outputs.usd.quantities import QUANTITIES

    if as_json:
        print_json({name: {"unit": one.unit, "sign": one.sign} for name, one in QUANTITIES.items()})
        return
    for name, one in QUANTITIES.items():
        print(f"{name:20} [{one.unit}] {one.sign}")
