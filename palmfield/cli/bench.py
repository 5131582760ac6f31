"""`palmfield bench`: how fast palmfield is on this machine, and how exact."""

from pathlib import Path
from typing import Annotated

import typer

from palmfield.cli.options import group

bench = group(
    "bench", "Measure the speed and the accuracy of palmfield on this machine.\n\nExample: palmfield bench field"
)


@bench.command("field")
def field(
    out: Annotated[Path | None, typer.Option(help="Markdown file for the table")] = None,
    picture: Annotated[Path | None, typer.Option(help="PNG for the plot of speed against error")] = None,
    device: Annotated[str, typer.Option(help="compute device: cpu or cuda:0")] = "cpu",
    points: Annotated[int, typer.Option(help="approximate number of points per range of distances")] = 20_000,
    runs: Annotated[int, typer.Option(help="runs per method; medians are printed")] = 5,
    only: Annotated[str, typer.Option(help="run only methods whose names contain this text")] = "",
    commit: Annotated[str, typer.Option(help="commit named in the head of the report [default: from git]")] = "",
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
    out: Annotated[Path | None, typer.Option(help="Markdown file for the table")] = None,
    picture: Annotated[Path | None, typer.Option(help="PNG for the plot of time against error")] = None,
    device: Annotated[str, typer.Option(help="compute device: cpu or cuda:0")] = "cpu",
    runs: Annotated[int, typer.Option(help="runs per method; medians are printed")] = 3,
    only: Annotated[str, typer.Option(help="run only methods whose names contain this text")] = "",
    commit: Annotated[str, typer.Option(help="commit named in the head of the report [default: from git]")] = "",
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
        list[str] | None,
        typer.Argument(help="scene files, or names of shipped scenes [default: eleven shipped scenes]"),
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", "--write", help="Markdown file for the table")] = None,
    device: Annotated[str, typer.Option(help="compute device of the scenes: cpu or cuda:0")] = "cpu",
    steps: Annotated[int, typer.Option(help="least number of steps with sound for each scene")] = 2000,
    known: Annotated[bool, typer.Option("--known", help="run scenes unchanged, with predicted loads")] = False,
    error: Annotated[bool, typer.Option("--error", help="also compare each run with the full wedge model")] = False,
    seed: Annotated[int, typer.Option(help="seed of the random numbers")] = 0,
    commit: Annotated[str, typer.Option(help="commit named in the head of the report [default: from git]")] = "",
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
