"""Predict the time of a step on a consumer GPU of 12 GB from numbers of bytes and operations. This is no measurement.

A MuJoCo step is one launch: field and ARP at the points of the skins and at the force samples, then all substeps. In
the model, stages do not overlap, and only constants are kept from one step to the next. Shadows, boundary elements, and
the work of MuJoCo and Python on the host are not included.
"""

from dataclasses import dataclass

from palmfield.simulation.model import HapticModel
from palmfield.simulation.posed_scene import reference_scene


@dataclass(frozen=True)
class Card:
    """Peak performance of a GPU, from its data sheet.

    instructions_per_s: single-precision instructions per second of all lanes
    double: double-precision throughput relative to single precision
    bytes_per_s: memory bandwidth [B/s]
    """

    name: str
    instructions_per_s: float
    double: float
    bytes_per_s: float


CARD = Card("GeForce RTX 3060, 12 GB", 3584 * 1.777e9, 1.0 / 64.0, 360e9)
PAIR = 44.75
"""Instructions for pressure and gradient of one transducer at one point, see docs/bench/gpu.md."""
SHARE = 0.75
"""Reached fraction of the peak instruction rate and bandwidth. Measured for the field kernel on an H200."""
KERNELS, KERNEL_s = 20, 2e-6
"""Number of kernels of a step without those of the skins; time to begin and end one kernel in a captured graph [s]."""
SKIN_KERNELS = 6
BEGIN_s = 25e-6
"""Time to pass a pose, launch a captured graph, wait for it, and fetch forces and sensors [s]."""
SINGLE_BYTES, DOUBLE_BYTES = 4, 8


@dataclass(frozen=True)
class Work:
    """Cost of one stage of a MuJoCo step: operations in single and double precision, bytes read, and kernels."""

    single: float = 0.0
    double: float = 0.0
    bytes: float = 0.0
    kernels: float = 0.0

    def __add__(self, other: "Work") -> "Work":
        return Work(
            self.single + other.single,
            self.double + other.double,
            self.bytes + other.bytes,
            self.kernels + other.kernels,
        )

    def seconds(self, card: Card) -> float:
        """Return the time of the stage [s]."""
        rate = SHARE * card.instructions_per_s
        computing = self.single / rate + self.double / (rate * card.double)
        return computing + self.bytes / (SHARE * card.bytes_per_s) + self.kernels * KERNEL_s


def predicted_s(model: HapticModel, card: Card = CARD) -> float | None:
    """Predict the wall time of one MuJoCo step [s]; None for steppers that solve sparse systems one after another.

    model: a model whose steppers are built
    """
    resting = all(config.path == "point" for config in model.configs) and not model.response_on
    patterns = 1 if resting else model.substeps + 1
    total = Work(kernels=KERNELS)
    for part, begin in zip(model.skins, model.begin, strict=True):
        stepper = begin.value
        points = len(part.layer.quadrature.weights) if stepper.points is None else len(stepper.points)
        skin = stepper.work(patterns, model.substeps)
        if skin is None:
            return None
        read = SINGLE_BYTES * skin.single_read + DOUBLE_BYTES * skin.double_read
        field = PAIR * len(model.arrays) * points * patterns
        total += Work(skin.single + field, skin.double, read, skin.kernels + SKIN_KERNELS)
    for body in reference_scene(model).bodies:
        total += Work(single=PAIR * len(model.arrays) * len(body.samples[0]))
    return BEGIN_s + total.seconds(card)
