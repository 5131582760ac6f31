"""`palmfield boards`: list the boards and their properties."""

from typing import TYPE_CHECKING, Annotated, Any

import typer

from palmfield.cli.as_json import print_json
from palmfield.cli.options import AsJson

if TYPE_CHECKING:
    from palmfield.drive.board import Board


def boards(
    name: Annotated[str | None, typer.Argument(help="one board", metavar="[BOARD]")] = None,
    markdown: Annotated[bool, typer.Option(help="print the page docs/boards.md")] = False,
    as_json: AsJson = False,
) -> None:
    """List the boards with their limits, or all properties and limits of one board.

    Example: palmfield boards sonicsurface
    """
    from palmfield.drive.boards import BOARDS, board_named

    if as_json:
        print_json({one.name: facts(one) for one in (BOARDS.values() if name is None else [board_named(name)])})
    else:
        describe(name, markdown)


def facts(board: "Board") -> dict[str, Any]:
    """Return the properties of a board. The names contain the units."""
    steps = 1 if board.amplitude == "on_off" else board.amplitude_steps
    return {
        "board": board.name,
        "description": board.description,
        "layouts": list(board.layouts),
        "transducers": None if board.exact else board.unit,
        "most_units": board.most_units,
        "arrays": list(board.arrays),
        "takes": "any" if board.exact else board.takes,
        "line": None if board.line is None else str(board.line),
        "frame_bytes": board.frame_bytes,
        "max_frame_rate_Hz": None if board.exact else board.max_frame_rate_Hz,
        "phase_steps": board.phase_steps,
        "amplitude": board.amplitude,
        "amplitude_steps": steps,
        "keys": list(board.keys),
        "start_hex": board.start.hex(),
        "stop_hex": board.stop.hex(),
        "when_host_dies": board.when_host_dies,
        "cannot_guarantee": board.cannot_guarantee,
    }


def as_text() -> str:
    """Return all boards with their descriptions."""
    from palmfield.drive.boards import BOARDS

    width = max(len(name) for name in BOARDS)
    return "".join(f"{board.name:<{width}}  {board.description}\n" for board in BOARDS.values())


def as_markdown() -> str:
    """Return the table and the sections of the page docs/boards.md."""
    from palmfield.drive.boards import BOARDS

    lines = [
        "| board | layouts | transducers | frame | line | frames/s | phases | amplitudes |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for board in BOARDS.values():
        if board.exact:
            lines.append(f"| {board.name} | any | any | none | none | any | any | any |")
            continue
        count = f"{board.unit}" + (f", up to {board.most_units} units" if board.most_units > 1 else "")
        amplitudes = "off or full" if board.amplitude == "on_off" else f"{board.amplitude_steps} pulse widths"
        takes = f"{board.frame_bytes} bytes" + (", a focus and its level" if board.takes == "focus" else "")
        lines.append(
            f"| {board.name} | {', '.join(board.layouts)} | {count} | {takes} | {board.line} | "
            f"{board.frame_rate} | {board.phase_steps} | {amplitudes} |"
        )
    for board in BOARDS.values():
        if board.exact:
            continue
        lines += ["", f"### {board.name}", "", f"{board.description[0].upper()}{board.description[1:]}.", ""]
        lines.append(f"- If the host stops: {board.when_host_dies}.")
        lines.append(f"- Limits: {board.cannot_guarantee}")
        start, stop = _bytes(board.start), _bytes(board.stop)
        lines.append(f"- Start and stop: {start}." if start == stop else f"- Start: {start}. Stop: {stop}.")
        if board.keys:
            lines.append(f"- Keys of `palmfield.driver`: {', '.join(f'`{key}`' for key in board.keys)}.")
    return "\n".join(lines) + "\n"


def _bytes(data: bytes) -> str:
    """Return bytes as decimal numbers. A repeated byte is written as N x BYTE."""
    runs: list[tuple[int, int]] = []
    for byte in data:
        if runs and runs[-1][1] == byte:
            runs[-1] = runs[-1][0] + 1, byte
        else:
            runs.append((1, byte))
    half = len(runs) // 2
    twice = len(runs) % 2 == 0 and half > 1 and runs[:half] == runs[half:]
    shown = runs[:half] if twice else runs
    words = " ".join(str(byte) if count == 1 else f"{count} x {byte}" for count, byte in shown[:12])
    more = f" ... ({len(data)} bytes)" if len(shown) > 12 else ""
    return f"`{words}{more}`" + (", twice" if twice else "")


def describe(board: str | None, markdown: bool) -> None:
    """Print the properties of one board, the table of all boards, or the part of the documentation page."""
    from palmfield.drive.boards import playable_board

    if markdown:
        print(as_markdown(), end="")
    elif board is None:
        print(as_text(), end="")
    else:
        chosen = playable_board(board)
        # Long sequences are abbreviated as N x BYTE; `--json` prints every byte
        sequences = {"start_hex": ("start", chosen.start), "stop_hex": ("stop", chosen.stop)}
        for key, value in facts(chosen).items():
            if key == "max_frame_rate_Hz":
                value = chosen.frame_rate
            if key in sequences:
                key, data = sequences[key]
                value = f"{_bytes(data)} ({len(data)} bytes, in decimals)"
            print(f"{key:<20}{value if not isinstance(value, list) else ', '.join(map(str, value)) or '-'}")
