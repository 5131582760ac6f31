"""`palmfield view`: show a running scene in the browser."""

import math
from pathlib import Path
from typing import Annotated

import typer

from palmfield.cli.options import Accuracy, Align, BoardName, Device, Keys, SceneFile, listening_at, parsed_keys
from palmfield.errors import SceneError


def view(
    context: typer.Context,
    scene: SceneFile,
    out: Annotated[Path | None, typer.Option(help="folder of the recordings [default: out/view_SCENE]")] = None,
    device: Device = None,
    accuracy: Accuracy = None,
    board: BoardName = None,
    keys: Keys = None,
    modes: Annotated[
        bool,
        typer.Option(
            "--modes",
            help="compute skins with modes for any sound, so that sliders act at once; building the modes takes "
            "minutes, once",
        ),
    ] = False,
    host: Annotated[
        str, typer.Option(help="address to listen at; addresses reachable from other machines need a token")
    ] = "127.0.0.1",
    port: Annotated[
        int | None, typer.Option(min=1, max=65535, help="port of the page [default: the first free port from 8080 on]")
    ] = None,
    rate: Annotated[
        float | None, typer.Option(help="pictures per second [default: 15, on a GPU 30]", metavar="HZ")
    ] = None,
    pace: Annotated[str, typer.Option(help="largest speed in simulated seconds per second, or max", metavar="X")] = "1",
    live: Annotated[
        str | None,
        typer.Option(
            help="follow a tracked hand whose samples arrive at this port, in place of the motion in the scene (see "
            "`palmfield track`), by UDP or with tcp:[HOST:]PORT by TCP",
            metavar="[HOST:]PORT",
        ),
    ] = None,
    align: Align = None,
    browser: Annotated[bool, typer.Option("--browser", help="open the page in the default browser")] = False,
) -> None:
    """Run a scene and show it in the browser: hand, array, sound, motion of the skin, and level above threshold.

    Sliders change focus, modulation, path, level and the pose of the hand. A recording is a result folder, as
    `palmfield run` writes it. Ctrl-C ends the view. This needs the extra `view`.

    Examples: palmfield view mjcf/scenes/palm_am200.xml

    palmfield view mjcf/scenes/hover_explore.xml --live 9100
    """
    import webbrowser

    from rich.console import Console

    from palmfield.studies.view import view as show

    changed = parsed_keys(keys)
    status = Console(stderr=True, quiet=context.obj).status(
        f"preparing {scene} (building the skin model may take a minute)"
    )
    status.start()

    def ready(address: str) -> None:
        status.stop()
        print(f"{scene} is at {address} (press Ctrl-C to end)", flush=True)
        if browser:
            webbrowser.open(address)

    try:
        show(
            scene, out, device=device, accuracy=accuracy, board=board, keys=changed, modes=modes, host=host,
            port=port, rate_Hz=rate, pace=_pace_of(pace), live=listening_at(live, align), on_ready=ready,
        )  # fmt: skip
    finally:
        status.stop()


def _pace_of(text: str) -> float:
    """Parse `--pace`, a number or max. Raises SceneError for another text."""
    if text == "max":
        return math.inf
    try:
        return float(text)
    except ValueError:
        raise SceneError(f"--pace has value '{text}'; allowed: a number above 0, or max") from None
