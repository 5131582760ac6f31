"""`palmfield render`: make a video of a run."""

from pathlib import Path
from typing import Annotated

import typer

from palmfield.cli.as_json import print_json
from palmfield.cli.options import AsJson, From, RunFolder, To
from palmfield.errors import OutputError


def render(
    context: typer.Context,
    run: RunFolder,
    video: Annotated[Path, typer.Option(help="MP4 file to write", metavar="FILE.mp4")],
    start_ms: From = None,
    end_ms: To = None,
    slow: Annotated[float, typer.Option(help="slow-motion factor: with 200, one second of film shows 5 ms")] = 200.0,
    magnify: Annotated[
        float | None,
        typer.Option(help="magnification of the motion [default: the largest displacement appears as about 2 mm]"),
    ] = None,
    show: Annotated[
        str, typer.Option(help="quantity shown by the colours: displacement, velocity or arp")
    ] = "displacement",
    limits: Annotated[
        str | None, typer.Option(help="limits of the colour scale, in um, um/s or Pa", metavar="LOW,HIGH")
    ] = None,
    size: Annotated[str, typer.Option(help="[pixels]", metavar="WIDTHxHEIGHT")] = "960x720",
    as_json: AsJson = False,
) -> None:
    """Make a video of a run: the hand, with the motion or the ARP on its skin, slowed down and magnified.

    One frame takes half a second on one core; the frames are divided among all cores. Ctrl-C keeps the frames drawn so
    far. This needs the extra `video`.

    Example: palmfield render out/palm --video palm.mp4 --from 20 --to 40
    """
    from palmfield.outputs.film import FPS, Cut, film
    from palmfield.outputs.pictures.options import parse_options
    from palmfield.outputs.store import open_result
    from palmfield.terminal import bars

    ends = parse_options(None, (), limits, None, "displacement", None).limits
    start, end = (None if at is None else 1e-3 * at for at in (start_ms, end_ms))
    cut = Cut(start, end, slow, magnify, show, ends, _size_of(size))
    with open_result(run) as result, bars(not context.obj) as bar:
        task = bar.add_task("drawing frames", total=None)
        frames = film(result, video, cut, lambda done, of: bar.update(task, completed=done, total=of))
    if as_json:
        print_json({"video": str(video), "frames": frames, "fps": FPS})
    else:
        print(f"wrote {video}: {frames} frames, {frames / FPS:.1f} s")
    if not bar.finished:
        raise KeyboardInterrupt


def _size_of(text: str) -> tuple[int, int]:
    """Parse a size such as 960x720. Raises OutputError for another text."""
    width, _, height = text.partition("x")
    if not (width.isdigit() and height.isdigit()):
        raise OutputError(f"--size has value '{text}'; allowed: WIDTHxHEIGHT, for example 960x720")
    return int(width), int(height)
