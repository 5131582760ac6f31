"""`palmfield replay`: send recorded bytes again."""

from typing import Annotated

import typer

from palmfield.cli.drive import show_performance
from palmfield.cli.options import BoardOfBytes, Keys, SentFile, parsed_keys


def replay(
    file: SentFile,
    port: Annotated[str, typer.Option(help="serial port or URL")],
    board: BoardOfBytes = None,
    keys: Keys = None,
) -> None:
    """Send recorded bytes to a port again, at their times; the board is off at the end.

    The duration of sound and the level at a head are checked before, against the limits in the log or in --set
    driver.KEY=VALUE. If they are exceeded, the exit code is 2.

    Examples: palmfield replay sent.jsonl --port /dev/ttyUSB0

    palmfield replay sent.jsonl --port /dev/ttyUSB0 --set driver.on_time_s=5
    """
    from palmfield.hardware.replay import replay as replay_file

    show_performance(replay_file(file, port, board, keys=parsed_keys(keys), progress=True))
