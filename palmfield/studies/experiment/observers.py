"""Observers of an experiment: a person at the keyboard, a psychometric function, or a model of the simulated skin."""

import math
import select
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple, Protocol, TextIO

import numpy as np

from palmfield.errors import OutputError, refuse_unknown
from palmfield.perception.detection import detection_probability
from palmfield.perception.registry import ALL_OBSERVERS
from palmfield.session.duration import step_count
from palmfield.session.simulation import Simulation
from palmfield.studies.experiment.design import Design
from palmfield.studies.sweeps.point import measured
from palmfield.types import Float

NAMES = ("keyboard", "simulated", "skin")
PRESS = {"yes_no": {"y": "yes", "n": "no"}, "adjustment": {"+": "stronger", "-": "weaker", "d": "done"}}


class Shown(NamedTuple):
    """A trial that is presented to an observer.

    levels, keys: level, and keys of the scene, in each interval
    target: number of the interval with the stimulus, from 1
    number: number of the trial, from 0
    """

    number: int
    condition: str
    levels: tuple[float, ...]
    keys: tuple[Mapping[str, object], ...]
    target: int
    adjusting: bool


class Respondent(Protocol):
    """Answers trials. Returns the answer and the response time [s].

    The answer is `yes`, `no`, the number of an interval, `stronger`, `weaker` or `done`.
    """

    def answer(self, shown: Shown) -> tuple[str, float]: ...


class Stopped(Exception):
    """Exception for a session that the participant has ended."""


class Keyboard:
    """A person at a terminal, who presses one key per answer. If the input is a file, lines are read.

    `q` ends the session.
    """

    def __init__(self, design: Design, keys: TextIO | None = None, screen: TextIO | None = None) -> None:
        self.design = design
        self.keys, self.screen = keys or sys.stdin, screen or sys.stderr

    def answer(self, shown: Shown) -> tuple[str, float]:
        task = self.design.task
        if shown.adjusting:
            allowed = PRESS["adjustment"]
            question = "Stronger (+), weaker (-), or just felt (d)?"
        elif task.kind == "yes_no":
            allowed, question = PRESS["yes_no"], "Did you feel it (y, n)?"
        else:
            allowed = {str(n): str(n) for n in range(1, task.intervals + 1)}
            question = f"In which interval was it ({', '.join(allowed)})?"
        self._write(f"{task.question or question} ")
        begun = time.monotonic()
        while True:
            key = self._key()
            if key in allowed:
                self._write(f"{allowed[key]}\n")
                return allowed[key], time.monotonic() - begun
            if key == "q":
                raise Stopped
            if key.strip():
                self._write(f"[{key}: press one of {', '.join(allowed)}; q ends] ")

    def announce(self, interval: int, of: int) -> None:
        """Print that an interval begins."""
        if of > 1:
            self._write(f"{interval} ")

    def _write(self, text: str) -> None:
        self.screen.write(text)
        self.screen.flush()

    def _key(self) -> str:
        if not self.keys.isatty():
            line = self.keys.readline()
            if not line:
                raise Stopped
            return line.strip()
        # termios does not exist on Windows
        try:
            import termios
            import tty
        except ImportError:
            return self.keys.readline().strip()
        number = self.keys.fileno()
        before = termios.tcgetattr(number)
        try:
            # Keys pressed before the question are not an answer
            termios.tcflush(number, termios.TCIFLUSH)
            tty.setcbreak(number)
            while not select.select([self.keys], [], [], 0.5)[0]:
                pass
            return self.keys.read(1)
        finally:
            termios.tcsetattr(number, termios.TCSADRAIN, before)


class SimulatedObserver:
    """An observer with the function in table `simulated` of the design. Its answers depend only on seed and trial."""

    def __init__(self, design: Design) -> None:
        if design.simulated is None:
            raise OutputError(f"experiment '{design.name}' has no table [simulated]; give its thresholds and spread")
        self.design, self.lapse = design, design.simulated.lapse

    def detected(self, shown: Shown, interval: int) -> float:
        """Return the probability that the sound of an interval is perceived."""
        scaled = self.design.varied.in_scale(shown.levels[interval])
        assert self.design.simulated is not None
        return 0.0 if scaled == -math.inf else float(self.design.simulated.function(shown.condition)(scaled))

    def answer(self, shown: Shown) -> tuple[str, float]:
        rng = np.random.default_rng((self.design.seed, 4, shown.number))
        chances = [self.detected(shown, interval) for interval in range(len(shown.levels))]
        detected = [bool(rng.random() < chance) for chance in chances]
        # A lapse is a guess and may be right, so its rate is higher than `lapse`, the rate of wrong answers
        lapsed = bool(rng.random() < self.lapse / (1.0 - self.design.task.chance))
        guessed = int(rng.integers(len(chances)))
        delay_s = float(rng.lognormal(math.log(0.5), 0.3))
        if shown.adjusting:
            # "Just felt": this level is felt, and the level before, weaker by a step, was not
            return ("done" if 0.3 < chances[0] < 0.7 else "weaker" if chances[0] >= 0.7 else "stronger"), delay_s
        if self.design.task.kind == "yes_no":
            yes = (detected[0] and not lapsed) or bool(rng.random() < self.design.task.guess)
            return ("yes" if yes else "no"), delay_s
        if lapsed or not any(detected):
            return str(1 + guessed), delay_s
        strongest = max((i for i in range(len(detected)) if detected[i]), key=lambda i: chances[i])
        return str(1 + strongest), delay_s


class FeelingObserver(SimulatedObserver):
    """A SimulatedObserver whose level is computed from the motion of the simulated skin.

    The level is that above the threshold of a model of perception.
    levels: cached levels [dB SL] by keys
    """

    def __init__(self, design: Design, scene: Path, board: str | None) -> None:
        name = design.skin.observer
        refuse_unknown(OutputError, "skin.observer is {}", name, ALL_OBSERVERS)
        self.design, self.lapse, self.scene, self.board = design, design.skin.lapse, scene, board
        self.levels: dict[str, float] = {}

    def detected(self, shown: Shown, interval: int) -> float:
        level_dB = self.level_dB(shown.keys[interval])
        return float(detection_probability(level_dB, slope=self.design.skin.slope))

    def level_dB(self, keys: Mapping[str, object]) -> float:
        """Return the level above threshold for some keys [dB SL]; -inf in silence.

        Raises OutputError, with the reason, if the observer has no threshold for this motion.
        """
        key = repr(sorted(keys.items()))
        if key not in self.levels:
            self.levels[key] = self._level_of(keys)
        return self.levels[key]

    def _level_of(self, keys: Mapping[str, object]) -> float:
        sim = Simulation(self.scene, board=self.board, keys=keys)
        names, skin = list(sim.skins), self.design.skin.skin
        if skin is not None:
            refuse_unknown(OutputError, "skin.skin is {}", skin, names)
        number = 0 if skin is None else names.index(skin)
        steps = step_count(self.design.duration_s, sim.runtime.spec.timestep_s)
        times: Float = np.arange(1.0, steps + 1.0) * sim.runtime.spec.timestep_s
        (point,) = measured(sim, self.design.duration_s, times, errors=False)
        if point["peak_arp"][number] == 0.0:
            return -math.inf
        which = list(ALL_OBSERVERS).index(self.design.skin.observer)
        level = float(point["level"][number, which])
        if math.isnan(level):
            why = point["level_why"][number, which] or "duration_s is shorter than two periods of the main frequency"
            raise OutputError(f"observer '{self.design.skin.observer}' has no threshold for {dict(keys)}: {why}")
        return level


def observer_of(name: str, design: Design, scene: Path, board: str | None) -> Respondent:
    """Return the observer with a name of NAMES. Raises OutputError for another name, and if its table is missing."""
    match name:
        case "keyboard":
            return Keyboard(design)
        case "simulated":
            return SimulatedObserver(design)
        case "skin":
            return FeelingObserver(design, scene, board)
    raise OutputError(f"--observer has value '{name}'; allowed: {', '.join(NAMES)}")
