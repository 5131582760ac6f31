"""`palmfield sweep`: from options to a sweep, and what came of it in words."""

import shlex
import sys
from pathlib import Path

import typer

from palmfield.cli.messages import complain
from palmfield.studies.sweeps.texts import read_design
from palmfield.studies.sweeps.whole_sweep import Sweep, sweep

MOST_REASONS = 3


def run_sweep(
    scene: Path,
    out: Path,
    settings: list[str],
    *,
    random_points: int | None,
    sobol_points: int | None,
    table: Path | None,
    seed: int,
    workers: int | None,
    scheduler: str | None,
    device: str | None,
    accuracy: float | None,
    duration_s: float | None,
    errors: bool,
    picture: bool,
    yes: bool,
    quiet: bool,
) -> None:
    """Sweep and say what was written; exit code 130 on Ctrl-C, 1 where no point is done."""
    design, fixed = read_design(
        settings, random_points=random_points, sobol_points=sobol_points, table=table, seed=seed
    )
    try:
        result = sweep(
            scene, design, out, keys=fixed, workers=workers, scheduler=scheduler, device=device, accuracy=accuracy,
            duration_s=duration_s, errors=errors, picture=picture, yes=yes, progress=not quiet,
            ask=typer.confirm if sys.stdin.isatty() else None,
        )  # fmt: skip
    except KeyboardInterrupt:
        complain(
            f"interrupted; the points that were done are in {out}; the same command goes on: "
            f"{shlex.join(['palmfield', *sys.argv[1:]])}"
        )
        raise typer.Exit(130) from None
    if not quiet:
        print(in_words(result), end="")
    if not result.done:
        raise typer.Exit(1)


def in_words(result: Sweep) -> str:
    """How many points are done, why others have failed, and the files."""
    lines = [f"{result.done} of {result.points} points are done"]
    reasons: dict[str, list[int]] = {}
    for number, reason in result.failed.items():
        reasons.setdefault(reason, []).append(number)
    for reason, numbers in list(reasons.items())[:MOST_REASONS]:
        lines.append(f"{len(numbers)} failed, the first of them point {numbers[0]}: {reason}")
    if len(reasons) > MOST_REASONS:
        lines.append(f"{len(reasons) - MOST_REASONS} other reasons are in the dataset's `failure`")
    lines += [f"wrote {path}" for path in result.files.values()]
    return "\n".join(lines) + "\n"
