"""`palmfield prepare`: compute, before a run, the data that the run stores on disk."""

from pathlib import Path
from typing import Annotated

import typer

from palmfield.cli import options
from palmfield.errors import SceneError


def prepare(
    scene: Annotated[
        Path | None, typer.Argument(help="MJCF scene with palmfield plugins", metavar="[SCENE.xml]", show_default=False)
    ] = None,
    kernels: Annotated[
        bool, typer.Option("--kernels", help="only compile the kernels that runs of the shipped scenes use")
    ] = False,
    device: options.Device = None,
    accuracy: options.Accuracy = None,
    board: options.BoardName = None,
    keys: options.Keys = None,
) -> None:
    """Compile kernels, and compute the meshes, modes and reduced models of a scene before its runs.

    Runs then read these data from disk. The results of a run do not change. The error estimate is computed only in the
    run.

    Example: palmfield prepare mjcf/scenes/palm_am200.xml
    """
    from palmfield.estimate.preparation import prepare as make

    if scene is None and not kernels:
        raise SceneError("`palmfield prepare` needs a scene or --kernels; give one of them")
    made = make(
        scene, only_kernels=kernels, device=device, accuracy=accuracy, board=board, keys=options.parsed_keys(keys)
    )
    if not made.kernels and not made.answers:
        print("all data are already in the cache")
        return
    print(
        f"compiled {made.kernels} kernel modules and stored {len(made.answers)} cache entries in {made.seconds:.1f} s"
    )
    for answer in made.answers:
        print(answer)
