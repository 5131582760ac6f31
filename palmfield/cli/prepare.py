"""`palmfield prepare`: what a run keeps on disk, made before it."""

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
    """Compile kernels and make the meshes, modes and reduced models of a scene, which later runs then find.

    Runs give the same results without. Only the error estimate is left to the run.

    Example: palmfield prepare mjcf/scenes/palm_am200.xml
    """
    from palmfield.estimate.preparation import prepare as make

    if scene is None and not kernels:
        raise SceneError("there is nothing to prepare: give a scene, or --kernels")
    made = make(
        scene, only_kernels=kernels, device=device, accuracy=accuracy, board=board, keys=options.parsed_keys(keys)
    )
    if not made.kernels and not made.answers:
        print("nothing to prepare: all of it is there")
        return
    print(f"compiled {made.kernels} modules of kernels and kept {len(made.answers)} answers in {made.seconds:.1f} s")
    for answer in made.answers:
        print(answer)
