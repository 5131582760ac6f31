"""One effect that a run omits, and its size."""

from dataclasses import dataclass

from palmfield.outputs.budget_text import bias_text

QUANTITY = (
    "displacement amplitude at the skin point nearest to the focus, static and at the main frequency, under the "
    "loudest sound of the run; relative to its value"
)


@dataclass(frozen=True)
class Bias:
    """The effect of one omission on the displacement of the skin where the sound is loudest.

    low, high: least and largest bias, (true - computed) / computed displacement; None
            if it is not estimated.
        why: how the value was found, or the sign of the bias.
    """

    what: str
    low: float | None
    high: float | None
    why: str

    @property
    def size(self) -> str:
        """The range of the bias in words, with sign."""
        return "not estimated" if self.low is None or self.high is None else bias_text(self.low, self.high)
