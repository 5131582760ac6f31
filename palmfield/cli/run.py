"""`palmfield run`: simulate a scene, and print messages before and after."""

import logging
import platform
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from palmfield.cli import options
from palmfield.cli.as_json import print_json
from palmfield.cli.messages import print_message
from palmfield.errors import SceneError
from palmfield.phases import phase
from palmfield.threads import cores

LOG = logging.getLogger("palmfield.cli")


def run(
    context: typer.Context,
    scene: options.SceneFile,
    out: Annotated[Path | None, typer.Option(help="folder of the results [default: out/SCENE]")] = None,
    device: options.Device = None,
    duration: options.Duration = None,
    accuracy: options.Accuracy = None,
    board: options.BoardName = None,
    keys: options.Keys = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="replace the results of another run in the folder")
    ] = False,
    plots: Annotated[
        str | None,
        typer.Option(
            help="kinds of plots in place of the usual three (see `palmfield plot --list`)", metavar="KIND,..."
        ),
    ] = None,
    no_plots: Annotated[bool, typer.Option("--no-plots", help="draw no pictures")] = False,
    no_usd: Annotated[bool, typer.Option("--no-usd", help="write no scene.usdc")] = False,
    estimate: Annotated[
        str,
        typer.Option(
            help="error estimate: quick, full (with a finer mesh; takes several times as long), or none",
            metavar="KIND",
        ),
    ] = "quick",
    details: Annotated[
        bool, typer.Option("--details", help="print all numbers, observers and parts of the error")
    ] = False,
    strict: Annotated[
        bool, typer.Option("--strict", help="exit with code 3 if the target accuracy is not reached")
    ] = False,
    profile: Annotated[
        bool,
        typer.Option(
            "--profile", help="print time and memory of each phase to standard error at the end (for bug reports)"
        ),
    ] = False,
    as_json: options.AsJson = False,
) -> None:
    """Simulate a scene and write result.nc, summary.json, pictures and scene.usdc.

    Ctrl-C keeps the results so far (marked incomplete). After a crash of the machine, `palmfield recover DIR` assembles
    the data on the disk. A folder with results is overwritten only with --overwrite.

    Example: palmfield run mjcf/scenes/palm_am200.xml --out out/palm --set stimulus.am_frequency_Hz=100
    """
    from rich.console import Console

    quiet = context.obj
    if profile:
        context.with_resource(_printed_profile())
    # The imports take seconds
    with Console(stderr=True, quiet=quiet).status("loading palmfield"), phase("imports"):
        import palmfield
        from palmfield.estimate.estimated_run import checked_kind
        from palmfield.outputs.summary_table import format_summary
        from palmfield.planning.scene_plan import warnings
        from palmfield.session.recorded_run import second_process_draws

        run_scene = palmfield.run

    options.check_duration(duration)
    if plots is not None and no_plots:
        raise SceneError("--plots and --no-plots exclude each other; give one of them")
    kind = checked_kind(estimate)
    if strict and kind == "none":
        raise SceneError("--strict needs an error estimate; give --estimate quick or full")
    kinds = [] if no_plots else None if plots is None else [kind for kind in plots.split(",") if kind]
    changed, out = options.parsed_keys(keys), out or Path("out") / scene.stem
    if kinds is None or not no_usd:
        context.with_resource(second_process_draws())
    with Console(stderr=True, quiet=quiet).status(f"loading {scene}"):
        with phase("reading and building the scene"):
            simulation = palmfield.Simulation(scene, device=device, accuracy=accuracy, board=board, keys=changed)
        with phase("warnings"):
            messages = warnings(simulation, duration)
    for warning in messages:
        LOG.warning(warning)
    try:
        result = run_scene(
            simulation,
            out,
            duration_s=duration,
            overwrite=overwrite,
            progress=not quiet,
            plots=kinds,
            usd=not no_usd,
            estimate=kind,
        )
    except KeyboardInterrupt as error:
        if hasattr(error, "result"):
            print_message(f"interrupted; the partial results are in {out}; `palmfield recover {out}` draws their plots")
        else:
            old = f"; {out} contains the results of an earlier run" if out.exists() else ""
            print_message(f"interrupted before the first step{old}")
        raise typer.Exit(130) from None
    if as_json:
        files = {name: str(path) for name, path in result.files.items()}
        print_json(
            {"scene": str(scene), "out": str(out), "files": files, "warnings": messages, "summary": result.summary}
        )
    elif not quiet:
        print(format_summary(result.summary, details), end="")
        for path in result.files.values():
            print(f"wrote {path}")
    if strict and not all(skin.get("accuracy_reached", True) for skin in result.summary["skins"]):
        raise typer.Exit(3)


@contextmanager
def _printed_profile() -> Iterator[None]:
    from palmfield.profile import measured

    with measured() as profile:
        yield
    import palmfield

    system = f"Python {platform.python_version()}, {platform.platform()}, {cores()} cores"
    print(f"palmfield {palmfield.__version__}, {system}\n{profile}", end="", file=sys.stderr)
