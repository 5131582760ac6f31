"""What the command line says of boards, and the virtual ones that it starts."""

import time
from pathlib import Path
from typing import Any, Literal

import typer

from palmfield.cli.messages import complain
from palmfield.drive.board import Board, frames_in_words
from palmfield.drive.boards import BOARDS, playable_board
from palmfield.drive.virtual import Faults, VirtualBoard
from palmfield.errors import DeviceError, unwritable
from palmfield.hardware.play import Performance

UNSENT_CODE = 4
"""Exit code where more frames were due than could be sent."""


def facts(board: Board) -> dict[str, Any]:
    """What is known of a board, with units in the names."""
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


def amplitudes_in_words(board: Board) -> str:
    """Which amplitudes each transducer takes."""
    if board.exact:
        return "any"
    return "off or full" if board.amplitude == "on_off" else f"{board.amplitude_steps} pulse widths"


def as_text() -> str:
    """All boards, each with its description."""
    width = max(len(name) for name in BOARDS)
    return "".join(f"{board.name:<{width}}  {board.description}\n" for board in BOARDS.values())


def as_markdown() -> str:
    """The page docs/boards.md's table and its sections."""
    lines = [
        "| board | layouts | transducers | frame | line | frames/s | phases | amplitudes |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for board in BOARDS.values():
        if board.exact:
            lines.append(f"| {board.name} | any | any | none | none | any | any | any |")
            continue
        count = f"{board.unit}" + (f", up to {board.most_units} units" if board.most_units > 1 else "")
        takes = f"{board.frame_bytes} bytes" + (", a focus and its level" if board.takes == "focus" else "")
        lines.append(
            f"| {board.name} | {', '.join(board.layouts)} | {count} | {takes} | {board.line} | "
            f"{board.frame_rate} | {board.phase_steps} | {amplitudes_in_words(board)} |"
        )
    for board in BOARDS.values():
        if board.exact:
            continue
        lines += ["", f"### {board.name}", "", f"{_capital(board.description)}.", ""]
        lines.append(f"- When the host dies: {board.when_host_dies}.")
        lines.append(f"- What it can't guarantee: {board.cannot_guarantee}")
        lines.append(f"- Start: {_bytes(board.start)}. Stop: {_bytes(board.stop)}.")
        if board.keys:
            lines.append(f"- Keys of `palmfield.driver`: {', '.join(f'`{key}`' for key in board.keys)}.")
    return "\n".join(lines) + "\n"


def _capital(text: str) -> str:
    return text[0].upper() + text[1:]


def _bytes(data: bytes) -> str:
    """Bytes in decimals, runs of one byte as N x BYTE."""
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


def run_virtual(
    name: str,
    by: str,
    tcp_port: int,
    duration_s: float | None,
    *,
    drop: float,
    flip: float,
    stall: tuple[float, float] | None,
    unplug_s: float | None,
    received: Path | None,
) -> None:
    """Start a virtual board, print its port, and say at the end what it noticed; Ctrl-C ends it.

    stall: from when on and for how long it takes no bytes [s]; unplug_s: when its port is taken away [s]
    Raises DeviceError for a board without bytes, and shares out of range.
    """
    board = playable_board(name)
    if by not in ("pty", "tcp"):
        raise DeviceError(f"--by has value '{by}'; allowed: pty or tcp")
    kind: Literal["pty", "tcp"] = "pty" if by == "pty" else "tcp"
    with VirtualBoard(board, by=kind, tcp_port=tcp_port, faults=Faults(drop, flip)) as virtual:
        print(virtual.port)
        # A focus is played by boards of one array
        what = "--focus 0 0 0.15" if board.arrays[0] == 1 else "SCENE.xml"
        print(
            f"next, in another terminal: palmfield drive {what} --board {board.name} --port {virtual.port}", flush=True
        )
        try:
            while duration_s is None or virtual.clock < duration_s:
                time.sleep(0.005)
                now = virtual.clock
                if stall is not None:
                    virtual.stall(stall[0] <= now < stall[0] + stall[1])
                if unplug_s is not None and now >= unplug_s:
                    virtual.unplug()
        except KeyboardInterrupt:
            pass
        if received is not None:
            try:
                received.write_bytes(bytes(virtual.received))
            except OSError as error:
                raise unwritable(received, error) from None
        on = int((abs(virtual.twin.emitted) > 0.0).sum())
        print(
            f"{board.name}: {len(virtual.received)} bytes; {frames_in_words(virtual.emitted)}; {on} of "
            f"{virtual.twin.count} transducers sound at the end"
        )
        for flag in virtual.flags[:10]:
            print(f"at {flag.time_s:.3f} s {flag.kind}: {flag.text}")


def describe(board: str | None, markdown: bool) -> None:
    """Print one board's facts, all boards, or the page's part."""
    if markdown:
        print(as_markdown(), end="")
    elif board is None:
        print(as_text(), end="")
    else:
        known = playable_board(board)
        # Of hundreds of bytes people read what they are, runs as N x BYTE; `--json` has each
        sequences = {"start_hex": ("start", known.start), "stop_hex": ("stop", known.stop)}
        for key, value in facts(known).items():
            if key == "max_frame_rate_Hz":
                value = known.frame_rate
            if key in sequences:
                key, data = sequences[key]
                value = f"{_bytes(data)} ({len(data)} bytes, in decimals)"
            print(f"{key:<20}{value if not isinstance(value, list) else ', '.join(map(str, value)) or '-'}")


def show_performance(done: Performance) -> None:
    """Print how playing went. Raises typer.Exit where frames were left out."""
    print(done)
    if done.warning:
        complain(f"warning: {done.warning}")
        raise typer.Exit(UNSENT_CODE)
