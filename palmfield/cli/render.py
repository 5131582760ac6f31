"""What `palmfield render` does with its options."""

from pathlib import Path

from palmfield.cli.as_json import print_json
from palmfield.errors import OutputError
from palmfield.outputs.film import FPS, Cut, film
from palmfield.outputs.store import RESULT, open_result
from palmfield.terminal import bars


def size_of(text: str) -> tuple[int, int]:
    """ "960x720" as numbers. Raises OutputError for another text."""
    width, _, height = text.partition("x")
    if not (width.isdigit() and height.isdigit()):
        raise OutputError(f"--size has value '{text}'; allowed: WIDTHxHEIGHT, for example 960x720")
    return int(width), int(height)


def render(run: Path, video: Path, cut: Cut, *, quiet: bool, as_json: bool) -> None:
    """Make the film and say what was written. Raises KeyboardInterrupt after a film that Ctrl-C has ended early."""
    file = run / RESULT if run.is_dir() else run
    with open_result(file) as result, bars(not quiet) as bar:
        task = bar.add_task("drawing frames", total=None)
        frames = film(result, video, cut, lambda done, of: bar.update(task, completed=done, total=of))
    if as_json:
        print_json({"video": str(video), "frames": frames, "fps": FPS})
    else:
        print(f"wrote {video}: {frames} frames, {frames / FPS:.1f} s")
    if not bar.finished:
        raise KeyboardInterrupt
