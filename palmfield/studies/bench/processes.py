"""Run methods in separate processes. The methods take turns, so that other load of the machine affects all equally."""

import hashlib
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmfield.errors import PalmfieldError
from palmfield.studies.bench.problem import Method

ROOT = Path(__file__).resolve().parents[3]
SIZE = 1000
"""Number of rows and columns of the matrices of `yardstick`."""
ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS", "RAYON_NUM_THREADS", "POLARS_MAX_THREADS"), "1"
)


@dataclass
class Measured:
    """Result of a method. `missing` names a distribution that is not installed; no other field is then set."""

    method: Method
    module: str
    missing: str = ""
    version: str = ""
    setup_s: float = 0.0
    clock_s: list[float] = field(default_factory=list)
    core_s: list[float] = field(default_factory=list)
    memory_MiB: float = 0.0
    result: NDArray[Any] = field(default_factory=lambda: np.zeros(0))

    @property
    def median_clock_s(self) -> float:
        return statistics.median(self.clock_s)

    @property
    def median_core_s(self) -> float:
        return statistics.median(self.core_s)


@dataclass(frozen=True)
class PeerMethods:
    """Methods of other programs, measured together with palmfield's own.

    methods: METHODS of `module`, a Python module in `folder` that imports only problem and types of palmfield
    python: interpreter with the programs installed; command: command of this comparison, printed in the report
    """

    methods: Sequence[Method]
    module: str
    folder: Path
    python: Path
    command: str


class Process:
    """A worker process that answers each line of input by a line of JSON.

    As a context manager it is stopped at the end.

    python, folders: interpreter of the worker, and folders on its path: those of palmfield and of the method's module
    words: file that receives the standard error of the worker
    """

    def __init__(self, python: Path, folders: Sequence[Path], one: Measured, problem: Path, words: Path) -> None:
        self.name = one.method.name
        self.words = words
        paths = [str(folder) for folder in folders]
        if python == Path(sys.executable) and os.environ.get("PYTHONPATH"):
            paths.append(os.environ["PYTHONPATH"])
        with words.open("w") as stream:
            self.child = subprocess.Popen(
                [python, "-m", "palmfield.studies.bench.worker", one.module, self.name, problem],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=stream,
                text=True,
                env={**os.environ, **ONE_THREAD, "PYTHONPATH": os.pathsep.join(paths)},
            )

    def __enter__(self) -> "Process":
        return self

    def __exit__(self, *_: object) -> None:
        self.child.kill()
        self.child.communicate()

    def request(self, order: str) -> dict[str, Any]:
        """Send an order (one line) to the worker process, and return its answer, decoded from JSON.

        Raises PalmfieldError if the worker has ended; the message has the last line of its standard error.
        """
        assert self.child.stdin is not None and self.child.stdout is not None
        try:
            self.child.stdin.write(order + "\n")
            self.child.stdin.flush()
            answer = self.child.stdout.readline()
        except BrokenPipeError:
            answer = ""
        if not answer:
            self.child.wait()
            words = self.words.read_text().strip().splitlines()
            raise PalmfieldError(
                f"benchmark of '{self.name}' failed at '{order}': {words[-1] if words else 'no message'}; correct "
                "this, or choose other methods with --only"
            )
        return json.loads(answer)


def yardstick() -> float:
    """Return the time of a float64 product of two 1000 x 1000 matrices on one thread [s], as a measure of speed."""
    matrix = np.random.default_rng(0).normal(size=(SIZE, SIZE))
    start = time.perf_counter()
    matrix @ matrix
    return time.perf_counter() - start


def cores() -> float:
    """Return the throughput of hashing with one thread per core, relative to one thread. Hashing releases the GIL."""
    data = bytes(20_000_000)
    count = os.cpu_count() or 1

    def seconds(threads: int) -> float:
        with ThreadPoolExecutor(threads) as pool:
            start = time.perf_counter()
            for job in [pool.submit(lambda: hashlib.sha256(data).digest()) for _ in range(threads)]:
                job.result()
            return time.perf_counter() - start

    return count * seconds(1) / seconds(count)


def measure(
    methods: list[Measured],
    problems: dict[str, Path],
    places: dict[str, tuple[Path, Sequence[Path]]],
    runs: int,
    folder: Path,
    tick: Callable[[str], None],
) -> list[tuple[float, float]]:
    """Prepare every method and run it `runs` times, in turns. Fill `methods`; return `yardstick` and `cores` by turn.

    problems: model -> file of the Problem
    places: module of a method -> interpreter and folders on its path
    folder: folder for files with results
    tick: function that is called after each step with the name of the method; a method has runs + 1 steps
    """
    processes: list[tuple[Measured, Process]] = []
    references = []
    with ExitStack() as stack:
        for i, one in enumerate(methods):
            process = Process(*places[one.module], one, problems[one.method.model], folder / f"{i}.txt")
            processes.append((one, stack.enter_context(process)))
            answer = process.request("prepare")
            one.missing = answer.get("missing", "")
            if not one.missing:
                one.setup_s, one.version = answer["setup_s"], answer["version"]
            tick(one.method.name)
        for _ in range(runs):
            references.append((yardstick(), cores()))
            for one, process in processes:
                if not one.missing:
                    answer = process.request("run")
                    one.clock_s.append(answer["clock_s"])
                    one.core_s.append(answer["core_s"])
                tick(one.method.name)
        for i, (one, process) in enumerate(processes):
            if not one.missing:
                path = folder / f"{i}.npy"
                one.memory_MiB = process.request(f"save {path}")["memory_MiB"]
                one.result = np.load(path)
    return references
