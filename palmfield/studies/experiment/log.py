"""The log of an experiment: one line of JSON for each trial, written to disk before the next trial begins.

The first line is the head: `palmfield_experiment` (1), design and its digest, digest of the scene, participant,
observer, and versions. Each session that continues the experiment adds a line `session` with the date, and with the
wall-clock time at which the time axis of the log is 0. Each other line is a trial.
"""

import datetime
import hashlib
import json
import os
import time
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

from filelock import FileLock, Timeout

from palmfield.closing import Closing
from palmfield.errors import OutputError, unwritable
from palmfield.files import plain, read_bytes, reading, writing
from palmfield.session.scene_text import read_scene_text
from palmfield.studies.experiment.design import Design
from palmfield.studies.experiment.procedures import Answered

VERSION = 1


class Trial(NamedTuple):
    """A logged trial. number, block, condition: numbers from 0; content: its line in the log"""

    number: int
    block: int
    condition: int
    answered: Answered
    content: Mapping[str, Any]


class Log(NamedTuple):
    head: Mapping[str, Any]
    design: Design
    sessions: int
    trials: list[Trial]
    whole_bytes: int


def read_experiment_log(path: Path) -> Log:
    """Read the content of a log. An incomplete last line, for instance after a power failure, is ignored.

    Raises OutputError for a file that cannot be read or is not a log of this version.
    """
    with reading(path, OutputError, "the log of `palmfield experiment run`"):
        data = read_bytes(path)
    whole = data[: data.rfind(b"\n") + 1]
    rows = []
    for number, line in enumerate(whole.decode("utf-8", errors="replace").splitlines(), 1):
        try:
            rows.append(plain(json.loads, line))
        except ValueError:
            raise OutputError(f"{path}: line {number} is not JSON; give an unedited log") from None
    if not rows or not isinstance(rows[0], dict) or rows[0].get("palmfield_experiment") != VERSION:
        raise OutputError(
            f"{path} is not an experiment log of version {VERSION}; give a log of `palmfield experiment run`"
        )
    head, design = rows[0], Design.model_validate(rows[0]["design"])
    names = [condition.name for condition in design.conditions]
    trials = []
    for row in rows[1:]:
        if "session" in row and "trial" not in row:
            continue
        answered = Answered(float(row["level"]), bool(row["right"]), str(row["answer"]))
        trials.append(Trial(int(row["trial"]), int(row["block"]), names.index(row["condition"]), answered, row))
    return Log(head, design, sum("trial" not in row for row in rows[1:]), trials, len(whole))


def next_trial(design: Design, trials: list[Trial]) -> tuple[int, int, int, float] | None:
    """Return number, block, condition and level of the next trial. None at the end."""
    for block in range(design.blocks):
        unfinished: list[int] = []
        coming: dict[int, float] = {}
        own = [trial for trial in trials if trial.block == block]
        for condition in range(len(design.conditions)):
            run = [trial.answered for trial in own if trial.condition == condition]
            level = design.procedure_of(block, condition).next_level(run)
            if level is not None:
                unfinished.append(condition)
                coming[condition] = level
        if unfinished:
            chosen = design.next_condition(block, len(own), unfinished)
            return len(trials), block, chosen, coming[chosen]
    return None


class LogWriter(Closing):
    """Context manager that writes the log of an experiment, new or continued.

    Other processes cannot write it meanwhile.

    trials: trials so far, in order
    session: number of this session, from 1
    """

    def __init__(self, path: Path, design: Design, scene: Path, participant: str, observer: str, board: str) -> None:
        """Open the log. Raises OutputError for an unwritable file, another experiment, and a log that is in use."""
        self.path, self.design, self.participant = path, design, participant
        head = {
            "palmfield_experiment": VERSION, "name": design.name, "digest": design.digest(observer),
            "scene_digest": _scene_digest(scene), "participant": participant, "observer": observer,
            "board": board, "palmfield": version("palmfield"), "design": design.model_dump(mode="json"),
        }  # fmt: skip
        self._lock = FileLock(path.with_name(f"{path.name}.lock"))
        try:
            self._lock.acquire(timeout=0)
        except Timeout:
            raise OutputError(f"{path} is being written by another run; wait for it, or give another --log") from None
        except OSError as error:
            raise unwritable(self.path, error) from None
        try:
            self.trials: list[Trial] = []
            self.session = 1
            fresh = not path.exists() or path.stat().st_size == 0
            if not fresh:
                earlier = read_experiment_log(path)
                self._check(earlier.head, head)
                self.trials, self.session = earlier.trials, earlier.sessions + 1
                os.truncate(path, earlier.whole_bytes)
            self._file = path.open("a", encoding="utf-8")
            if fresh:
                self._line(head)
            zero = time.time() - time.monotonic()
            self._line({"session": self.session, "begun": _iso(time.time()), "clock_zero": _iso(zero)})
        except OSError as error:
            self._lock.release()
            raise unwritable(self.path, error) from None
        except BaseException:
            self._lock.release()
            raise

    def _check(self, logged: Mapping[str, Any], head: Mapping[str, Any]) -> None:
        for key, what in (("digest", "design"), ("scene_digest", "scene"), ("participant", "participant"),
                          ("observer", "observer"), ("board", "board")):  # fmt: skip
            if logged.get(key) != head[key]:
                difference = f"'{logged.get(key)}', not '{head[key]}'"
                if key == "digest":
                    difference = _difference(logged["design"], head["design"])
                raise OutputError(f"{self.path} contains trials of another {what} ({difference}); give another --log")

    def add(self, trial: Mapping[str, Any], condition: int, answered: Answered) -> None:
        """Write a trial. It is on the disk when this returns. Raises OutputError if writing fails."""
        self._line({**trial, "session": self.session})
        self.trials.append(Trial(int(trial["trial"]), int(trial["block"]), condition, answered, trial))

    def _line(self, value: Mapping[str, Any]) -> None:
        with writing(self.path):
            self._file.write(json.dumps(value) + "\n")
            self._file.flush()
            os.fsync(self._file.fileno())

    def close(self) -> None:
        self._file.close()
        self._lock.release()
        Path(self._lock.lock_file).unlink(missing_ok=True)


def _scene_digest(scene: Path) -> str:
    """Return a digest of the scene file and of the files that it includes."""
    text = read_scene_text(scene)
    result = hashlib.sha256()
    for file in (scene, *text.included):
        result.update(read_bytes(file))
    return result.hexdigest()[:16]


def _difference(logged: Any, own: Any, place: str = "") -> str:
    """Return the first difference between two designs, with its key."""
    if isinstance(logged, dict) and isinstance(own, dict):
        for key in {**logged, **own}:
            if logged.get(key) != own.get(key):
                return _difference(logged.get(key), own.get(key), f"{place}.{key}" if place else key)
        return "written by another version"
    return f"{place}: {json.dumps(logged)[:60]}, not {json.dumps(own)[:60]}"


def _iso(seconds: float) -> str:
    return datetime.datetime.fromtimestamp(seconds, datetime.UTC).isoformat(timespec="microseconds")
