"""`palmfield plan`: report what a run would model."""

from typing import Annotated

import typer

from palmfield.cli import options
from palmfield.cli.as_json import print_json


def plan(
    scene: options.SceneFile,
    device: options.Device = None,
    duration: options.Duration = None,
    accuracy: options.Accuracy = None,
    board: options.BoardName = None,
    keys: options.Keys = None,
    details: Annotated[bool, typer.Option("--details", help="print all decisions with their reasons")] = False,
    as_json: options.AsJson = False,
) -> None:
    """Report, without simulation, the modelled and ignored effects with reasons, and the expected time and error.

    Example: palmfield plan mjcf/scenes/palm_am200.xml --accuracy 0.02 --duration 0.5
    """
    import palmfield

    options.check_duration(duration)
    made = palmfield.plan(
        scene, device=device, accuracy=accuracy, board=board, keys=options.parsed_keys(keys), duration_s=duration
    )  # fmt: skip
    if as_json:
        print_json(made.as_dict())
    else:
        print(made if details else made.short(), end="")
