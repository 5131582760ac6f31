"""Make the head of a log, which describes the scene of its bytes."""

from palmfield.config.driver import SAFETY_KEYS
from palmfield.drive.frame_log import LogHead
from palmfield.simulation.model import HapticModel, array_instances


def log_head(model: HapticModel) -> LogHead:
    """Return the head of a log of the frames of a model, with the limits that its driver sets."""
    spec, driver = model.spec, model.spec.driver
    own = driver.of_board(model.board.keys)
    limits = driver.model_dump(include=set(SAFETY_KEYS), exclude_none=True, exclude_defaults=True)
    p0 = array_instances(spec)[0].p0
    name = spec.arrays[0].config.layout
    head = LogHead(
        model.board.name, len(model.arrays), name, model.arrays.air, own, limits, p0_Pa_m=p0.value, p0_high_Pa_m=p0.high
    )
    return head.measured(model.arrays.parts[0], model.board.places)
