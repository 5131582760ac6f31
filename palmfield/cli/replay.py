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

    Before anything is sent, the duration of sound and the level at a head are checked against limits. The limits are
    those in the log, or those of --set driver.KEY=VALUE. If a limit is exceeded, the exit code is 2.

    Examples: palmfield replay sent.jsonl --port /dev/ttyUSB0

    palmfield replay sent.jsonl --port /dev/ttyUSB0 --set driver.on_time_s=5
    """
    from palmfield.hardware.replay import replay as replay_file

    show_performance(replay_file(file, port, board, keys=parsed_keys(keys), progress=True))
