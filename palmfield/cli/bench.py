"""`palmfield bench`: measure speed and accuracy of palmfield on this machine."""

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
    """Measure speed and error of the pressure field, as a Markdown table.

    The problem has 996 transducers and two ranges of distances. Each method runs in a separate process, and the methods
    take turns, so that other load affects all of them equally. Errors are relative to float64. The head of the report
    states the speed of the machine; compare speeds only within one table. In a clone of palmfield,
    scripts/bench/compare_field.py also measures other programs.

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
    """Measure time and error of the skin solvers on one slab, as a Markdown table.

    Each solver runs at several target accuracies. Errors are relative to the exact solution by plane waves in depth.
    This takes some minutes. In a clone of palmfield, scripts/bench/compare_skin.py also measures scikit-fem, warp.fem
    and MuJoCo's flexes.

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
    """Measure the speed of whole scenes, and with --error their error, as a Markdown table.

    Speed is wall time per simulated time in plain mj_step over whole runs. Path, level and pose are changed at random
    after the model is built, so skins must use modes that are valid for every load. With --known, the scenes are
    unchanged. Each scene runs in two separate processes, the first with an empty cache, the second with the cache of
    the first. --error takes minutes for each scene.

    Examples: palmfield bench scene palm_am200 palm_circle

    palmfield bench scene --known --write realtime.md
    """
    from palmfield.studies.bench.scene import main as measure

    print(measure(scenes, out, device, steps, known, error, seed, commit), end="")
