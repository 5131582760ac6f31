"""Mark the moment at which sound begins, for Lab Streaming Layer and on a line of a serial port."""

import time
from typing import Any, Protocol, Self

from palmfield.drive.trigger_line import TriggerLine
from palmfield.errors import OutputError
from palmfield.studies.experiment.design import Design


class Marker(Protocol):
    """Marks the moment of each presentation."""

    def mark(self, text: str, when: float) -> None:
        """Mark the event `text` at a time of time.monotonic in the near future or past; return at once."""

    def close(self) -> None: ...


class LslMarker:
    """A stream `palmfield` of type Markers: each sample is a text, stamped with the moment of emission.

    source_id: identifies the stream when it is reopened
    """

    def __init__(self, name: str) -> None:
        """Raises OutputError without the extra `lsl`."""
        try:
            import pylsl
        except (ImportError, RuntimeError) as error:
            raise OutputError(f"Lab Streaming Layer is not installed ({error}): pip install 'palmfield[lsl]'") from None
        self._clock, self.source_id = pylsl.local_clock, f"palmfield-{name}"
        info = pylsl.StreamInfo(
            "palmfield", "Markers", 1, pylsl.IRREGULAR_RATE, pylsl.cf_string, self.source_id
        )  # fmt: skip
        self._outlet: Any = pylsl.StreamOutlet(info)

    def mark(self, text: str, when: float) -> None:
        self._outlet.push_sample([text], self._clock() + (when - time.monotonic()))

    def close(self) -> None:
        del self._outlet


class Markers:
    """All markers of an experiment. A context manager."""

    def __init__(self, parts: list[Marker]) -> None:
        self.parts = parts

    @classmethod
    def of(cls, design: Design) -> Self:
        """Return the markers that a design requests."""
        parts: list[Marker] = [LslMarker(design.name)] if design.lsl else []
        if (trigger := design.trigger) is not None:
            parts.append(TriggerLine(trigger.port, trigger.line, trigger.byte, trigger.pulse_s))
        return cls(parts)

    def mark(self, text: str, when: float) -> None:
        for part in self.parts:
            part.mark(text, when)

    @property
    def trigger_late_s(self) -> float | None:
        """Return the delay of the last trigger [s], None without one."""
        return next((part.late_s for part in self.parts if isinstance(part, TriggerLine)), None)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        for part in self.parts:
            part.close()
