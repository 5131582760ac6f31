"""`palmfield bench`: how fast palmfield is on this machine, and how exact."""

from pathlib import Path
from typing import Annotated

import typer

bench = typer.Typer(
    name="bench",
    no_args_is_help=True,
    rich_markup_mode=None,
    help="Measure how fast palmfield is on this machine, and how exact.\n\nExample: palmfield bench field",
)


@bench.command("field")
def field(
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
def skin(
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
def scene(
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
