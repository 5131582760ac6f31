"""`palmfield plan`: what would be modelled."""

from palmfield.cli.as_json import print_json
from palmfield.cli.options import (
    Accuracy,
    AsJson,
    BoardName,
    Device,
    Duration,
    Keys,
    SceneFile,
    check_duration,
    given_keys,
)


def plan(
    scene: SceneFile,
    device: Device = None,
    duration: Duration = None,
    accuracy: Accuracy = None,
    board: BoardName = None,
    keys: Keys = None,
    as_json: AsJson = False,
) -> None:
    """Say what would be modelled and what left out, why, and at what cost and error. Simulates nothing.

    Example: palmfield plan mjcf/scenes/palm_am200.xml --accuracy 0.02 --duration 0.5
    """
    import palmfield

    check_duration(duration)
    made = palmfield.plan(
        scene, device=device, accuracy=accuracy, board=board, keys=given_keys(keys), duration_s=duration
    )  # fmt: skip
    if as_json:
        print_json(made.as_dict())
    else:
        print(made, end="")
