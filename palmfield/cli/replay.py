"""`palmfield replay`: recorded bytes, sent again."""

from typing import Annotated

import typer

from palmfield.cli.drive import show_performance
from palmfield.cli.options import BoardOfBytes, Keys, SentFile, given_keys


def replay(
    file: SentFile,
    port: Annotated[str, typer.Option(help="serial port or URL")],
    board: BoardOfBytes = None,
    keys: Keys = None,
) -> None:
    """Send recorded bytes to a port again, at their times; the board is off at the end.

    How long they may sound and how loud at a head, as a log has it of its scene or --set driver.KEY=VALUE says, is
    checked before: what isn't allowed is refused with exit code 2.

    Examples: palmfield replay sent.jsonl --port /dev/ttyUSB0

    palmfield replay sent.jsonl --port /dev/ttyUSB0 --set driver.on_time_s=5
    """
    from palmfield.hardware.replay import replay as replay_file

    show_performance(replay_file(file, port, board, keys=given_keys(keys), progress=True))
