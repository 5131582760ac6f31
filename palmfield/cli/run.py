"""`palmfield run`: a scene simulated, with what is said before and after."""

import logging
from pathlib import Path

import typer
from rich.console import Console

import palmfield
from palmfield.cli.as_json import print_json
from palmfield.cli.messages import complain
from palmfield.outputs.summary_table import format_summary
from palmfield.planning.scene_plan import warnings

LOG = logging.getLogger("palmfield.cli")


def run_scene(
    scene: Path,
    out: Path,
    *,
    device: str | None,
    accuracy: float | None,
    board: str | None,
    keys: dict[str, str],
    duration_s: float | None,
    overwrite: bool,
    plots: list[str] | None,
    quiet: bool,
    details: bool,
    strict: bool,
    as_json: bool,
) -> None:
    """Run a scene and print its numbers and files, as a table or as JSON; exit code 130 on Ctrl-C.

    quiet: neither bars nor the table; details: the table with all numbers
    strict: exit code 3 where the accuracy of a skin is not reached, or has no estimate
    """
    with Console(stderr=True, quiet=quiet).status(f"loading {scene}"):
        simulation = palmfield.Simulation(scene, device=device, accuracy=accuracy, board=board, keys=keys)
        told = warnings(simulation, duration_s)
    for warning in told:
        LOG.warning(warning)
    try:
        result = palmfield.run(
            simulation, out, duration_s=duration_s, overwrite=overwrite, progress=not quiet, plots=plots
        )
    except KeyboardInterrupt as error:
        if hasattr(error, "result"):
            complain(f"interrupted; what was computed is in {out}; `palmfield recover {out}` draws its pictures")
        else:
            old = f"; what is in {out} is an earlier run's" if out.exists() else ""
            complain(f"interrupted before anything was computed{old}")
        raise typer.Exit(130) from None
    if as_json:
        files = {name: str(path) for name, path in result.files.items()}
        print_json({"scene": str(scene), "out": str(out), "files": files, "warnings": told, "summary": result.summary})
    elif not quiet:
        print(format_summary(result.summary, details), end="")
        for path in result.files.values():
            print(f"wrote {path}")
    if strict and not all(skin.get("accuracy_reached", True) for skin in result.summary["skins"]):
        raise typer.Exit(3)
