"""Design of an experiment, read from a file: scene, varied key, question, conditions, procedure, order. No physics."""

import hashlib
import json
import math
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from palmfield.config import CONFIGS
from palmfield.errors import OutputError, PalmfieldError, fault_of
from palmfield.files import read_json, read_toml, reading
from palmfield.perception.psychometric import PsychometricFunction, Shape
from palmfield.studies.experiment.procedures import Adjustment, ConstantStimuli, Limits, Procedure, Staircase

KINDS: dict[str, type[Any]] = {
    "staircase": Staircase,
    "limits": Limits,
    "constant": ConstantStimuli,
    "adjustment": Adjustment,
}
ONE_LEVEL = ("limits", "adjustment")
"""Procedures with one interval, in which the question is whether the stimulus was perceived."""
Scalar = bool | float | int | str | list[float]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Number = Annotated[float, Field(allow_inf_nan=False)]


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Varied(_Part):
    """The key that the procedure varies.

    key: INSTANCE.KEY, as in --set
    reference: value of the key in the other intervals, for a task with several intervals
    scale: log for levels that are ratios, which are reported in dB as 20 lg
    unit: unit of the level, for tables
    """

    key: str
    reference: Number = 0.0
    scale: Literal["log", "linear"] = "log"
    unit: str = ""

    def in_scale(self, level: float) -> float:
        """Return a level in the scale of fits and pictures. For ratios this is dB re 1, and -inf for level 0."""
        if self.scale == "linear":
            return level
        return 20.0 * math.log10(level) if level > 0.0 else -math.inf

    def level(self, scaled: float) -> float:
        """Return the level for a value in the scale. This is the inverse of `in_scale`."""
        return scaled if self.scale == "linear" else float(10.0 ** (scaled / 20.0))


class Task(_Part):
    """The question after each trial.

    kind: yes_no (was the stimulus perceived?) or nafc (in which of several intervals was the target?)
    question: question in words
    gap_s: pause between intervals [s]
    guess: for yes_no, the rate of answers "yes" without sound, which fits use
    """

    kind: Literal["yes_no", "nafc"] = "nafc"
    intervals: Annotated[int, Field(ge=2, le=8)] = 2
    gap_s: Annotated[float, Field(ge=0, le=60)] = 0.4
    question: str = ""
    guess: Annotated[float, Field(ge=0, lt=0.5)] = 0.0

    @property
    def chance(self) -> float:
        """Rate of correct answers by chance."""
        return 1.0 / self.intervals if self.kind == "nafc" else self.guess


class Condition(_Part):
    """Other values of keys of the scene. name: label of the condition; keys: INSTANCE.KEY, as in --set"""

    name: str = Field(min_length=1)
    keys: dict[str, Scalar] = {}


class Simulated(_Part):
    """A simulated observer with a psychometric function that the design defines.

    threshold, spread: values in the unit of the varied key, or in dB for ratios
    lapse: rate of wrong answers at any level
    thresholds: other thresholds, by condition
    """

    threshold: Number
    spread: Positive
    shape: Shape = "normal"
    lapse: Annotated[float, Field(ge=0, le=0.2)] = 0.02
    thresholds: dict[str, Number] = {}

    def function(self, condition: str) -> PsychometricFunction:
        """Return the probability of detection as a function of the level, without guesses."""
        return PsychometricFunction(self.shape, self.thresholds.get(condition, self.threshold), self.spread)


class SkinObserver(_Part):
    """An observer that responds to the motion of the simulated skin.

    observer: name of an observer of `palmfield.perception`; a level of 0 dB above its threshold is detected with
        probability 1/2
    slope: b in 1 - exp(-ln 2 E^b), where E is the level as a ratio
    lapse: as for Simulated
    skin: instance of the skin, None for the first
    """

    observer: str = "bolanowski_1988"
    slope: Positive = 2.0
    lapse: Annotated[float, Field(ge=0, le=0.2)] = 0.02
    skin: str | None = None


class Trigger(_Part):
    """A serial line that is raised when sound begins.

    port: serial port
    line: DTR, RTS, or a byte that is sent
    pulse_s: duration of the pulse [s]
    """

    port: str
    line: Literal["dtr", "rts", "byte"] = "dtr"
    byte: Annotated[int, Field(ge=0, le=255)] = 1
    pulse_s: Positive = 0.005


class Design(_Part):
    """An experiment. See docs/experiments.md for each key.

    scene: file of the scene, relative to the file of the experiment
    blocks: number of runs of each condition
    order: order of the trials in each block: all conditions interleaved, or one condition after another. The order is
        random, by the seed
    """

    name: str = Field(min_length=1)
    scene: str
    seed: Annotated[int, Field(ge=0)]
    duration_s: Positive
    varied: Varied
    procedure: dict[str, Any]
    conditions: Annotated[tuple[Condition, ...], Field(min_length=1)]
    task: Task = Task()
    keys: dict[str, Scalar] = {}
    board: str | None = None
    blocks: Annotated[int, Field(ge=1, le=1000)] = 1
    order: Literal["interleaved", "blocked"] = "interleaved"
    simulated: Simulated | None = None
    skin: SkinObserver = SkinObserver()
    lsl: bool = False
    trigger: Trigger | None = None

    @model_validator(mode="after")
    def _fits(self) -> "Design":
        names = [condition.name for condition in self.conditions]
        if len(set(names)) < len(names):
            raise ValueError(f"conditions are {', '.join(names)}; allowed: each name once")
        varied = self.varied.key
        twice = [key for keys in (self.keys, *(c.keys for c in self.conditions)) for key in keys if key == varied]
        if twice:
            raise ValueError(f"key '{varied}' is both varied and set; allowed: one of the two")
        kind = self.procedure.get("kind")
        if kind not in KINDS:
            raise ValueError(f"procedure.kind is {kind!r}; allowed: {', '.join(KINDS)}")
        if kind in ONE_LEVEL and self.task.kind != "yes_no":
            raise ValueError(
                f"task.kind is 'nafc'; allowed with procedure '{kind}': yes_no, because each trial has one level"
            )
        if self.procedure.get("scale", self.varied.scale) != self.varied.scale:
            raise ValueError(
                f"procedure.scale is '{self.procedure['scale']}' and varied.scale '{self.varied.scale}'; allowed: equal"
            )
        if "seed" in self.procedure:
            raise ValueError("procedure.seed is not a key; set seed of the whole experiment")
        if self.simulated is not None and (stray := set(self.simulated.thresholds) - set(names)):
            raise ValueError(f"simulated.thresholds names '{min(stray)}'; allowed: {', '.join(names)}")
        self.procedure_of(0, 0)
        return self

    def procedure_of(self, block: int, condition: int) -> Procedure:
        """Return the procedure of one run. Each run has its own random order."""
        keys = {key: value for key, value in self.procedure.items() if key != "kind"}
        kind = KINDS[self.procedure["kind"]]
        if kind is not ConstantStimuli:
            keys.setdefault("scale", self.varied.scale)
        if kind not in (Staircase, Limits):
            keys["seed"] = (self.seed, block, condition)
        from pydantic import TypeAdapter

        try:
            made: Procedure = TypeAdapter(kind).validate_python(keys)
        except ValidationError as error:
            raise ValueError(f"procedure.{fault_of(error)}") from None
        except PalmfieldError as error:
            raise ValueError(f"procedure: {error}") from None
        return made

    def digest(self, observer: str) -> str:
        """Return a digest of the settings that are fixed within a log.

        Observers, markers and the board are excluded.
        """
        others = {"simulated", "skin"} - {observer}
        own = self.model_dump(mode="json", exclude=others | {"lsl", "trigger", "board"})
        return hashlib.sha256(json.dumps(own, sort_keys=True).encode()).hexdigest()[:16]

    def playable(self) -> tuple[float, float]:
        """Return the smallest and the largest level that the varied key allows and the procedure uses.

        Without a limit they are infinite.
        """
        part, _, key = self.varied.key.rpartition(".")
        models = [one for one in CONFIGS if key in one.model_fields]
        models = [one for one in models if one.plugin == f"palmfield.{part}"] or models
        schema = models[0].model_json_schema()["properties"][key] if len(models) == 1 else {}
        lows, highs = [self.procedure.get("low", -math.inf)], [self.procedure.get("high", math.inf)]
        for option in schema.get("anyOf", [schema]):
            lows += [option[name] for name in ("minimum", "exclusiveMinimum") if name in option]
            highs += [option[name] for name in ("maximum", "exclusiveMaximum") if name in option]
        return max(lows), min(highs)

    def keys_at(self, condition: int, level: float) -> dict[str, object]:
        """Return the keys of a presentation, in the form for `palmfield.load`."""
        return {**self.keys, **self.conditions[condition].keys, self.varied.key: level}

    def highest(self) -> float | None:
        """Return the highest level that may be played. None if the procedure has no upper limit."""
        levels: list[float] = self.procedure.get("levels") or [self.procedure.get("high", math.inf)]
        return None if math.isinf(max(levels)) else max(levels)

    def next_condition(self, block: int, number: int, unfinished: list[int]) -> int:
        """Return the condition of a trial of a block. It is one of the conditions that have trials left."""
        if self.order == "blocked":
            order = np.random.default_rng((self.seed, 1, block)).permutation(len(self.conditions)).tolist()
            return next(int(condition) for condition in order if condition in unfinished)
        return unfinished[int(np.random.default_rng((self.seed, 2, block, number)).integers(len(unfinished)))]

    def target(self, trial: int) -> int:
        """Return the number of the interval, from 1, that contains the target of a trial. trial: number from 0"""
        if self.task.kind == "yes_no":
            return 1
        return 1 + int(np.random.default_rng((self.seed, 3, trial)).integers(self.task.intervals))


def read_design(path: Path) -> Design:
    """Read an experiment from a TOML or JSON file.

    Raises OutputError, with the key, for a file that cannot be read and for values that are not allowed.
    """
    with reading(path, OutputError, "a TOML file, or JSON (docs/experiments.md)"):
        content = read_toml(path) if path.suffix.lower() == ".toml" else read_json(path)
    try:
        return Design.model_validate(content)
    except ValidationError as error:
        raise OutputError(f"{path}: {fault_of(error)}") from None
