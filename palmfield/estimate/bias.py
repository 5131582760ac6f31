"""One thing that a run leaves out, and what that does."""

from dataclasses import dataclass

from palmfield.outputs.budget_text import bias_text


@dataclass(frozen=True)
class Bias:
    """What leaving something out does to the displacement of the skin where the sound is loudest.

    low, high: the true displacement's least and largest difference from the computed one, over the computed one; None
        where it is not estimated
    why: how the figure was found, or which way it goes
    """

    what: str
    low: float | None
    high: float | None
    why: str

    @property
    def size(self) -> str:
        """The range in words, with its sign."""
        return "not estimated" if self.low is None or self.high is None else bias_text(self.low, self.high)
