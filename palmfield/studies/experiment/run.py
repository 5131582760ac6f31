"""Run an experiment from its next trial to its end: levels, presentations, answers, log."""

import datetime
import logging
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from palmfield.config.driver import SAFETY_KEYS
from palmfield.drive.ports import check_port
from palmfield.drive.virtual import VirtualBoard
from palmfield.errors import DeviceError, OutputError, naming
from palmfield.session.open_scene import no_scene
from palmfield.session.preview import Preview, preview
from palmfield.studies.experiment.design import Design, read_design
from palmfield.studies.experiment.log import LogWriter, Trial, next_trial
from palmfield.studies.experiment.observers import Keyboard, Respondent, Shown, Stopped, observer_of
from palmfield.studies.experiment.presentation import Markers, Sender, presentation
from palmfield.studies.experiment.procedures import Answered

OnTrial = Callable[[Trial, float], None]
"""Function that is called after each logged trial. Argument: mean duration of recent trials [s]."""


@dataclass(frozen=True)
class Done:
    """Result of a session.

    trials: number in the log; new: number in this session; finished: whether all trials are done
    """

    log: Path
    trials: int
    new: int
    finished: bool


def run_experiment(
    experiment: Path,
    log: Path,
    *,
    participant: str,
    observer: str = "keyboard",
    port: str | None = None,
    virtual: bool = False,
    board: str | None = None,
    answers: Respondent | None = None,
    on_trial: OnTrial | None = None,
) -> Done:
    """Run or continue an experiment. Each trial is in the log before the next trial begins.

    observer: keyboard, simulated or skin
    answers: a custom observer that replaces it, logged under the name `observer`
    port: port of the board
    virtual: whether to use a virtual board; with neither there is no sound, which suffices for simulated observers
    board: board that replaces that of the design or scene, as in `palmfield.load`
    Raises OutputError for an invalid design and a log of another design, SceneError and DeviceError like `drive`.
    """
    design = read_design(experiment)
    scene = experiment.parent / design.scene
    if not scene.is_file():
        raise OutputError(f"{experiment}: scene: {no_scene(scene)}")
    if port is not None and virtual:
        raise DeviceError(f"port {port} and --virtual exclude each other; give one of them")
    if port is not None:
        check_port(port)
    plays = virtual or port is not None
    if observer == "keyboard" and answers is None and not plays:
        raise DeviceError("a person needs a board to feel anything; give --port, or --virtual to rehearse")
    board_name = board or design.board
    with ExitStack() as opened:
        # Invalid keys and sound that the board cannot play raise errors before the first trial
        first = _checked(design, experiment, scene, board_name, 0)
        opened.enter_context(_warnings_once())
        for number in range(1, len(design.conditions)):
            _checked(design, experiment, scene, board_name, number)
        played = first.runtime.model.board
        if plays and played.exact:
            raise DeviceError(f"{scene} uses board '{played.name}', which takes no bytes; give another by --board")
        if plays and first.runtime.spec.driver.model_fields_set & set(SAFETY_KEYS):
            _allowed(design, experiment, scene, board_name)
        name = played.name if plays else board_name or "none"
        writer = opened.enter_context(LogWriter(log, design, scene, participant, observer, name))
        markers = opened.enter_context(Markers.of(design))
        if virtual:
            port = opened.enter_context(VirtualBoard(played)).port
        frames = log.with_name(f"{log.name}.frames") / f"session_{writer.session}.jsonl"
        sender = opened.enter_context(Sender(scene, board_name, port, design.duration_s, frames))
        who = answers or observer_of(observer, design, scene, board_name)
        before, begun, finished = len(writer.trials), time.monotonic(), True
        session = _Session(design, writer, sender, who, markers)
        try:
            while session.trial():
                if on_trial is not None:
                    on_trial(writer.trials[-1], (time.monotonic() - begun) / (len(writer.trials) - before))
        except Stopped:
            finished = False
        return Done(log, len(writer.trials), len(writer.trials) - before, finished)


@contextmanager
def _warnings_once() -> Iterator[None]:
    """Show the scene's messages about a change of the board only once. Otherwise every trial would print them."""
    log = logging.getLogger("palmfield.session")
    before = log.level
    log.setLevel(logging.WARNING)
    try:
        yield
    finally:
        log.setLevel(before)


def _checked(design: Design, experiment: Path, scene: Path, board: str | None, condition: int) -> Preview:
    """Return the scene at the first level of a condition. Also check the scene at the reference level."""
    first = design.procedure_of(0, condition).next_level([])
    assert first is not None
    levels = [first, design.varied.reference] if design.task.kind == "nafc" else [first]
    with naming(f"{experiment}", f"condition '{design.conditions[condition].name}'"):
        views = [preview(scene, board=board, keys=design.keys_at(condition, level)) for level in levels]
    return views[0]


def _allowed(design: Design, experiment: Path, scene: Path, board: str | None) -> None:
    """Prepare the highest level of each condition, so that errors for long or loud sound come before the trials."""
    level = design.highest()
    for number, condition in enumerate(design.conditions if level is not None else ()):
        assert level is not None
        with naming(f"{experiment}", f"condition '{condition.name}', level {level:g}"):
            presentation(scene, board, design.keys_at(number, level), design.duration_s)


class _Session:
    """A session of trials of one participant."""

    def __init__(self, design: Design, writer: LogWriter, sender: Sender, who: Respondent, markers: Markers) -> None:
        self.design, self.writer, self.sender, self.who, self.markers = design, writer, sender, who, markers

    def trial(self) -> bool:
        """Present and log the next trial; return False if there is none."""
        coming = next_trial(self.design, self.writer.trials)
        if coming is None:
            return False
        number, block, condition, level = coming
        design, varied = self.design, self.design.varied
        adjusting = design.procedure["kind"] == "adjustment"
        target = design.target(number)
        count = design.task.intervals if design.task.kind == "nafc" else 1
        levels = tuple(level if interval == target else varied.reference for interval in range(1, count + 1))
        keys = tuple(design.keys_at(condition, one) for one in levels)
        ready = [self.sender.prepare(one) for one in keys]
        asked_at = datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds")
        presented: list[dict[str, Any]] = []
        for interval, what in enumerate(ready, 1):
            if interval > 1 and what is not None:
                time.sleep(design.task.gap_s)
            if isinstance(self.who, Keyboard):
                self.who.announce(interval, count)
            text = f"trial {number} interval {interval} condition {design.conditions[condition].name}"

            def on_sound(when: float, text: str = f"{text} level {levels[interval - 1]:g}") -> None:
                self.markers.mark(text, when)

            emission = self.sender.send(what, on_sound)
            presented.append({"interval": interval, "level": levels[interval - 1], **emission.as_dict()})
            late_s = self.markers.trigger_late_s
            if late_s is not None:
                presented[-1]["trigger_late_s"] = round(late_s, 6)
        name = design.conditions[condition].name
        word, delay_s = self.who.answer(Shown(number, name, levels, keys, target, adjusting))
        right = word in ("yes", "done") if design.task.kind == "yes_no" else word == str(target)
        answered = Answered(level, right, word)
        self.writer.add(
            {
                "trial": number, "block": block, "condition": name, "level": level,
                "target": target if design.task.kind == "nafc" else None, "answer": word, "right": right,
                "response_time_s": round(delay_s, 4), "asked_at": asked_at,
                "participant": self.writer.participant, "presentations": presented,
            },
            condition, answered,
        )  # fmt: skip
        return True
