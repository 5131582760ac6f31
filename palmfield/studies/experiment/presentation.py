"""Make the frames of a scene in advance, send them to a board, return when they sounded, and mark these moments."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Protocol, Self

from palmfield.closing import Closing
from palmfield.drive.board import Board
from palmfield.drive.frame_log import FrameLog, LogHead
from palmfield.drive.limits import SoundLimits
from palmfield.drive.playback import TimedFrame
from palmfield.drive.player import Player
from palmfield.drive.trigger_line import TriggerLine
from palmfield.errors import DeviceError, OutputError
from palmfield.files import made_folder
from palmfield.hardware.log_head import log_head
from palmfield.hardware.play import scene_frames
from palmfield.hardware.safety.scene_sound import warn_at_head
from palmfield.session.preview import preview
from palmfield.studies.experiment.design import Design

OnSound = Callable[[float], None]
"""Function that is called as soon as the start of the sound is measured. Argument: this time [s, time.monotonic]."""
MOST_PREPARED = 256


@dataclass(frozen=True)
class Presentation:
    """The frames of a scene for its board. head: head of a frame log"""

    frames: tuple[TimedFrame, ...]
    board: Board
    head: LogHead
    duration_s: float


class Emission(NamedTuple):
    """Times at which the frames of a presentation sounded, i.e.

    when their last bytes were on the line [s, time.monotonic].

    first_s, last_s: times of the first and the last frame
    frames: number of frames
    skipped: number of dropped frames
    log: file of sent frames with their times; None without a board, when times are those of the calls
    log_s: time of the first frame on the clock of the log [s]
    """

    first_s: float
    last_s: float
    frames: int
    skipped: int
    log: str | None
    log_s: float

    def as_dict(self) -> dict[str, Any]:
        """Return times rounded to microseconds."""
        return {key: round(value, 6) if isinstance(value, float) else value for key, value in self._asdict().items()}


def presentation(
    scene: Path, board: str | None, keys: Mapping[str, object], duration_s: float
) -> Presentation:  # fmt: skip
    """Return the frames of a scene with changed keys, as `drive` sends them, within the limits of its driver.

    Raises SceneError for a bad scene or key. Raises DeviceError for a scene that the board cannot play, for a board
    that takes no bytes, and for sound that is longer or louder than the keys of the driver allow.
    """
    view = preview(scene, board=board, keys=keys)
    model = view.runtime.model
    if model.board.exact:
        raise DeviceError(f"{view.name} uses board '{model.board.name}', which takes no bytes; give another by --board")
    warn_at_head(view, duration_s)
    frames = tuple(scene_frames(view, duration_s))
    SoundLimits.of(model.spec.driver).check([one.time_s for one in frames], [one.sounds for one in frames], duration_s)
    return Presentation(frames, model.board, log_head(model), duration_s)


class Sender(Closing):
    """Context manager that sends presentations to a port, all by one player process. Without a port nothing is sent.

    An experiment sends data only here. At the end of the block, the board is silent.
    """

    def __init__(self, scene: Path, board: str | None, port: str | None, duration_s: float, log: Path) -> None:
        """scene, board, duration_s: as in `presentation`

        port: port of the board, None for no output
        log: log of frames; its folder is created when needed. The logs of further players have a number in their names
        """
        self.scene, self.board, self.port, self.duration_s, self.log = scene, board, port, duration_s, log
        self._prepared: dict[str, Presentation] = {}
        self._open: tuple[Board, Path, Player] | None = None
        self._players = 0

    def prepare(self, keys: Mapping[str, object]) -> Presentation | None:
        """Return the presentation for some keys, which is made at the first call. None without a port."""
        if self.port is None:
            return None
        key = repr(sorted(keys.items()))
        if key not in self._prepared:
            if len(self._prepared) >= MOST_PREPARED:
                del self._prepared[next(iter(self._prepared))]
            self._prepared[key] = presentation(self.scene, self.board, keys, self.duration_s)
        return self._prepared[key]

    def send(self, what: Presentation | None, on_sound: OnSound) -> Emission:
        """Play a presentation to its end, and return when it sounded. Raises DeviceError if the board is lost."""
        if what is None or self.port is None:
            now = time.monotonic()
            on_sound(now)
            return Emission(now, now + self.duration_s, 0, 0, None, 0.0)
        log, player = self._player(what, self.port)
        report = player.play(what.frames, duration_s=what.duration_s, on_sound=on_sound)
        if report.first_s is None or report.last_s is None:
            raise DeviceError(f"no frame reached {self.port} in {what.duration_s:g} s; give a longer duration_s")
        file = f"{log.parent.name}/{log.name}"
        begun_s = report.first_s - player.begin_s
        return Emission(report.first_s, report.last_s, report.frames, report.skipped, file, begun_s)

    def _player(self, what: Presentation, port: str) -> tuple[Path, Player]:
        """Return the player for the board of a presentation.

        There is one player for each pair of start and stop bytes.
        """
        if self._open is not None and self._open[0] == what.board:
            return self._open[1:]
        self.close()
        self._players += 1
        number = f"_{self._players}" if self._players > 1 else ""
        log = self.log.with_name(f"{self.log.stem}{number}{self.log.suffix}")
        made_folder(log.parent)
        FrameLog(log, what.head).close()
        self._open = what.board, log, Player(what.board, port, log=log)
        return self._open[1:]

    def close(self) -> None:
        """Silence the board and free the port."""
        if self._open is not None:
            player, self._open = self._open[2], None
            player.close()


class Marker(Protocol):
    """Marks the moment of each presentation."""

    def mark(self, text: str, when: float) -> None:
        """Mark the event `text` at a time of time.monotonic, in the near future or past. Returns at once."""

    def close(self) -> None: ...


class LslMarker:
    """A stream `palmfield` of type Markers. Each sample is a text with the time of emission.

    source_id: identifies the stream when it is opened again
    """

    def __init__(self, name: str) -> None:
        """Open the stream. Raises OutputError if the extra `lsl` is not installed."""
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
    """Context manager for all markers of an experiment."""

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
        """Return the delay of the last trigger [s]; None without a trigger."""
        return next((part.late_s for part in self.parts if isinstance(part, TriggerLine)), None)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        for part in self.parts:
            part.close()
