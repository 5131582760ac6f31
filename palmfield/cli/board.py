"""`palmfield board`: show the properties of a board, or start a virtual board."""

import time
from pathlib import Path
from typing import Annotated, Literal

import typer

from palmfield.cli.boards import describe
from palmfield.errors import DeviceError, refuse_unknown
from palmfield.files import writing


def board(
    name: Annotated[str, typer.Argument(help="name of the board (see `palmfield boards`)", metavar="BOARD")],
    virtual: Annotated[bool, typer.Option("--virtual", help="start a virtual board and print its port")] = False,
    by: Annotated[str, typer.Option(help="kind of port: pty (a pseudo-terminal) or tcp")] = "pty",
    tcp_port: Annotated[int, typer.Option(help="TCP port, with --by tcp; 0 for any free port")] = 0,
    duration: Annotated[float | None, typer.Option(help="duration [s] [default: until Ctrl-C]")] = None,
    drop: Annotated[float, typer.Option(help="share of bytes to drop")] = 0.0,
    flip: Annotated[float, typer.Option(help="share of bytes in which one bit is flipped")] = 0.0,
    stall: Annotated[
        tuple[float, float] | None,
        typer.Option(help="accept no bytes for L seconds, from time T on [s]", metavar="T L"),
    ] = None,
    unplug: Annotated[float | None, typer.Option(help="remove the port at this time [s]")] = None,
    received: Annotated[Path | None, typer.Option(help="write the received bytes to this file")] = None,
) -> None:
    """Start a virtual board, which reads bytes at the rate of the real line and reports its sound and errors.

    Example: palmfield board sonicsurface --virtual
    """
    from palmfield.drive.board import frames_in_words
    from palmfield.drive.boards import playable_board
    from palmfield.drive.virtual import Faults, VirtualBoard

    if not virtual:
        describe(name, False)
        return
    played = playable_board(name)
    refuse_unknown(DeviceError, "--by has value {}", by, ("pty", "tcp"))
    kind: Literal["pty", "tcp"] = "pty" if by == "pty" else "tcp"
    with VirtualBoard(played, by=kind, tcp_port=tcp_port, faults=Faults(drop, flip)) as made:
        print(made.port)
        # Only boards with one array play a focus
        what = "--focus 0 0 0.15" if played.arrays[0] == 1 else "SCENE.xml"
        print(f"next, in another terminal: palmfield drive {what} --board {played.name} --port {made.port}", flush=True)
        try:
            while duration is None or made.clock < duration:
                time.sleep(0.005)
                now = made.clock
                if stall is not None:
                    made.stall(stall[0] <= now < stall[0] + stall[1])
                if unplug is not None and now >= unplug:
                    made.unplug()
        except KeyboardInterrupt:
            pass
        if received is not None:
            with writing(received):
                received.write_bytes(bytes(made.received))
        on = int((abs(made.twin.emitted) > 0.0).sum())
        print(
            f"{played.name}: {len(made.received)} bytes; {frames_in_words(made.emitted)}; {on} of "
            f"{made.twin.count} transducers emit at the end"
        )
        for flag in made.flags[:10]:
            print(f"at {flag.time_s:.3f} s {flag.kind}: {flag.text}")
