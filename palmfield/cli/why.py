"""`palmfield why`: check why nothing is felt."""

from pathlib import Path
from typing import Annotated

import typer

from palmfield.cli.as_json import print_json
from palmfield.cli.options import AsJson, BoardName, Keys, parsed_keys


def why(
    scene: Annotated[
        Path | None, typer.Argument(help="MJCF scene with palmfield plugins", metavar="SCENE.xml", show_default=False)
    ] = None,
    board: BoardName = None,
    port: Annotated[
        str | None, typer.Option(help="port of the board, which is opened and closed; nothing is sent")
    ] = None,
    keys: Keys = None,
    measured: Annotated[
        float | None,
        typer.Option(help="peak pressure that a microphone reads at the focus at the loudest level", metavar="PA"),
    ] = None,
    no_run: Annotated[
        bool, typer.Option("--no-run", help="do not run the scene for its level above threshold, which takes seconds")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Say why nothing is felt: board, firmware, polarity, level, focus, modulation, distance, threshold.

    The checks are in the order in which to look, and the last line says where to begin. Boards do not answer: what
    only a microphone or an ear can check has the verdict "unseen", with the expected reading.

    Examples: palmfield why mjcf/scenes/palm_am200.xml --board autd3 --port /dev/ttyUSB0

    palmfield why --board sonicsurface --port COM3
    """
    from palmfield.studies.why import why as check

    made = check(
        scene, board=board, port=port, keys=parsed_keys(keys) or None, measured_Pa=measured, felt=not no_run
    )  # fmt: skip
    if as_json:
        print_json(made.as_dict())
    else:
        print(made, end="")
