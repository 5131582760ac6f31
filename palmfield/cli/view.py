"""What `palmfield view` does with its options."""

import math
import webbrowser
from pathlib import Path

from rich.console import Console

from palmfield.errors import SceneError
from palmfield.studies.view import view


def show(
    scene: Path,
    out: Path | None,
    *,
    device: str | None,
    accuracy: float | None,
    board: str | None,
    keys: dict[str, str],
    modes: bool,
    host: str,
    port: int | None,
    rate_Hz: float | None,
    pace: str,
    browser: bool,
    quiet: bool,
) -> None:
    """Show a scene until Ctrl-C, which is no failure once the page is there."""
    status = Console(stderr=True, quiet=quiet).status(f"preparing {scene} (the skin's model may take a minute)")
    status.start()

    def ready(address: str) -> None:
        status.stop()
        print(f"{scene} is at {address} (Ctrl-C ends it)", flush=True)
        if browser:
            webbrowser.open(address)

    try:
        view(
            scene, out, device=device, accuracy=accuracy, board=board, keys=keys, modes=modes, host=host, port=port,
            rate_Hz=rate_Hz, pace=pace_of(pace), on_ready=ready,
        )  # fmt: skip
    finally:
        status.stop()


def pace_of(text: str) -> float:
    """`--pace`, a number or max. Raises SceneError for another text."""
    if text == "max":
        return math.inf
    try:
        return float(text)
    except ValueError:
        raise SceneError(f"--pace has value '{text}'; allowed: a number above 0, or max") from None
