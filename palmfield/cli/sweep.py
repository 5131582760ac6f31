"""`palmfield sweep`: run a scene for many values of its keys, and report the result."""

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from palmfield.cli.messages import print_message
from palmfield.cli.options import Accuracy, Device, SceneFile, check_duration

if TYPE_CHECKING:
    from palmfield.studies.sweeps.whole_sweep import Sweep

MOST_REASONS = 3


def sweep(
    context: typer.Context,
    scene: SceneFile,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="values of a key: a:b:n for n evenly spaced numbers from a to b, a:b:n:log for logarithmic spacing, "
            "v1,v2,... for a list, one value for all points, or no value to remove the key. Separate the numbers "
            "of a vector by spaces, or sweep one component as KEY[0], KEY[1], ... May be repeated for several keys",
            metavar="INSTANCE.KEY=VALUES",
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="folder of the dataset [default: out/SCENE_sweep]")] = None,
    random: Annotated[
        int | None, typer.Option(help="N points drawn at random from ranges a:b, a:b:log or v1,v2,...", metavar="N")
    ] = None,
    sobol: Annotated[
        int | None, typer.Option(help="like --random, but N Sobol points, which fill the ranges evenly", metavar="N")
    ] = None,
    table: Annotated[
        Path | None,
        typer.Option("--list", help="CSV file of the points, with the keys in its first line", metavar="FILE.csv"),
    ] = None,
    seed: Annotated[int, typer.Option(help="seed of --random and --sobol; the same seed gives the same points")] = 0,
    workers: Annotated[
        int | None,
        typer.Option(
            help="number of worker processes on this machine; 0: run in this process [default: one per core, up to "
            "8 per GPU]",
            metavar="N",
        ),
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(help="address of a running Dask scheduler whose workers are used", metavar="tcp://HOST:PORT"),
    ] = None,
    device: Device = None,
    accuracy: Accuracy = None,
    duration: Annotated[float | None, typer.Option(help="duration of each point [s] [default: from the scene]")] = None,
    errors: Annotated[
        bool, typer.Option("--errors", help="estimate the error of each point; this often takes longer than the run")
    ] = False,
    picture: Annotated[bool, typer.Option(help="draw DIR/sweep.png")] = True,
    yes: Annotated[bool, typer.Option("--yes", help="do not ask for confirmation above 2 GB or one hour")] = False,
) -> None:
    """Simulate a scene over values of its keys; write one labelled dataset, DIR/sweep.zarr, and a picture.

    A point is one combination of values. For each point the dataset contains peak and rms displacement and velocity of
    each skin, the motion over time at the point of largest motion and at each sensor, peak ARP, force, and level above
    threshold by observer. Open it by `xarray.open_zarr`; keys are dimensions.

    Ctrl-C, a killed worker or a full disk lose only the points in progress; the same command continues the sweep. A
    failed point is recorded with its error. This needs the extra [sweep]: pip install 'palmfield[sweep]'.

    Examples: palmfield sweep mjcf/scenes/palm_am200.xml --set stimulus.am_frequency_Hz=50:300:6 --out out/frequency

    palmfield sweep mjcf/scenes/palm_circle.xml --set stimulus.path_rate_Hz= --set stimulus.path_speed_m_s=1:11:6
    --set stimulus.path_diameter_m=0.02,0.04 --accuracy 0.2

    palmfield sweep mjcf/scenes/palm_am200.xml --sobol 64 --set "stimulus.focus_m[0]=-0.02:0.02" --set
    "stimulus.focus_m[1]=-0.02:0.02" --scheduler tcp://192.168.1.10:8786
    """
    from palmfield.studies.sweeps.keys import read_design
    from palmfield.studies.sweeps.whole_sweep import sweep as whole_sweep

    check_duration(duration)
    design, fixed = read_design(settings or [], random_points=random, sobol_points=sobol, table=table, seed=seed)
    out = out or Path("out") / f"{scene.stem}_sweep"
    try:
        result = whole_sweep(
            scene, design, out, keys=fixed, workers=workers, scheduler=scheduler, device=device, accuracy=accuracy,
            duration_s=duration, errors=errors, picture=picture, yes=yes, progress=not context.obj,
            ask=typer.confirm if sys.stdin.isatty() else None,
        )  # fmt: skip
    except KeyboardInterrupt:
        print_message(
            f"interrupted; the finished points are in {out}; repeat the command to continue: "
            f"{shlex.join(['palmfield', *sys.argv[1:]])}"
        )
        raise typer.Exit(130) from None
    if not context.obj:
        print(in_words(result), end="")
    if not result.done:
        raise typer.Exit(1)


def in_words(result: "Sweep") -> str:
    """Describe the number of completed points, the reasons why other points failed, and the files."""
    lines = [f"{result.done} of {result.points} points are done"]
    reasons: dict[str, list[int]] = {}
    for number, reason in result.failed.items():
        reasons.setdefault(reason, []).append(number)
    for reason, numbers in list(reasons.items())[:MOST_REASONS]:
        lines.append(f"{len(numbers)} failed; the first is point {numbers[0]}: {reason}")
    if len(reasons) > MOST_REASONS:
        lines.append(f"{len(reasons) - MOST_REASONS} other reasons are in variable `failure` of the dataset")
    lines += [f"wrote {path}" for path in result.files.values()]
    return "\n".join(lines) + "\n"
