"""What a step would take on a consumer's GPU of 12 GB: a prediction from bytes and operations, not a measurement.

All of a MuJoCo step is one launch there: field and ARP at the points of the skins and at the samples for the force,
then all substeps of the skins. Nothing overlaps in this model, and nothing is kept from one step to the next but what
is constant in a run. Shadows, boundary elements, and what MuJoCo and Python do on the host come on top.
"""

from dataclasses import dataclass

from palmfield.simulation.model import HapticModel
from palmfield.simulation.posed_scene import reference_scene


@dataclass(frozen=True)
class Card:
    """Peak figures of a GPU, as its maker prints them.

    instructions_per_s: of single precision in all lanes; double: share of them in double precision
    bytes_per_s: of its memory
    """

    name: str
    instructions_per_s: float
    double: float
    bytes_per_s: float


CARD = Card("GeForce RTX 3060, 12 GB", 3584 * 1.777e9, 1.0 / 64.0, 360e9)
PAIR = 44.75
"""Instructions for pressure and gradient of one transducer at one point, see docs/bench/gpu.md."""
SHARE = 0.75
"""Of the peak of instructions and bytes that is reached: what the field's kernel reaches on an H200."""
KERNELS, KERNEL_s = 20, 2e-6
"""Kernels of a step beside the skins', and what one of a captured graph takes to begin and end [s]."""
SKIN_KERNELS = 6
BEGIN_s = 25e-6
"""To hand over a pose, launch a captured graph, wait for it and fetch forces and sensors [s]."""
SINGLE_BYTES, DOUBLE_BYTES = 4, 8


@dataclass(frozen=True)
class Work:
    """What a stage of one MuJoCo step takes: operations of single and double precision, bytes read, kernels."""

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
        """[s]"""
        rate = SHARE * card.instructions_per_s
        computing = self.single / rate + self.double / (rate * card.double)
        return computing + self.bytes / (SHARE * card.bytes_per_s) + self.kernels * KERNEL_s


def predicted_s(model: HapticModel, card: Card = CARD) -> float | None:
    """Wall time of one MuJoCo step [s]; None for steppers that are sparse solves, one after another.

    model: with steppers that are made
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
