"""Run one method in a separate process, by commands: `python -m palmfield.studies.bench.worker MODULE NAME FILE`.

It answers each line of standard input by one line of JSON on standard output. The commands are `prepare` (returns
versions, seconds and memory), `run` (returns wall time and core time [s]) and `save PATH` (writes the last result as
.npy; returns the peak memory).
"""

import contextlib
import importlib
import importlib.metadata
import json
import os
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from palmfield.studies.bench.problem import Method, load


def memory_MiB(name: str) -> float:
    """Return VmRSS (present memory) or VmHWM (peak memory) of this process.

    getrusage would include the peak of the parent, because it survives vfork and exec.
    """
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(name + ":"):
            return int(line.split()[1]) / 1024.0
    return float("nan")


def version(method: Method) -> str:
    return f"{method.needs[0]} {importlib.metadata.version(method.needs[0])}" if method.needs else ""


class Worker:
    """One method, with its state between commands.

    Before the measurement the method computes a few points, so that imports and compilation are not measured.
    """

    def __init__(self, module: str, name: str, problem: Path) -> None:
        self.method = next(method for method in importlib.import_module(module).METHODS if method.name == name)
        self.problem = load(problem)
        self.state: Any = None
        self.result: Any = None
        self.before_MiB = 0.0

    def prepare(self) -> dict[str, Any]:
        for needed in self.method.needs:
            try:
                importlib.import_module(needed.replace("-", "_"))
            except ImportError:
                return {"missing": needed}
        few = replace(self.problem, steps=np.array([4, 4, 4]))
        self.method.run(self.method.prepare(few))
        self.before_MiB = memory_MiB("VmRSS")
        start = time.perf_counter()
        self.state = self.method.prepare(self.problem)
        return {"setup_s": time.perf_counter() - start, "version": version(self.method)}

    def run(self) -> dict[str, float]:
        start, worked = time.perf_counter(), time.process_time()
        self.result = self.method.run(self.state)
        return {"clock_s": time.perf_counter() - start, "core_s": time.process_time() - worked}

    def save(self, path: Path) -> dict[str, float]:
        np.save(path, self.result)
        return {"memory_MiB": memory_MiB("VmHWM") - self.before_MiB}


def main() -> None:
    # Programs may print, so only answers are written to the real standard output
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    module, name, problem = sys.argv[1:]
    worker = Worker(module, name, Path(problem))
    with contextlib.suppress(KeyboardInterrupt):
        for line in sys.stdin:
            order, _, rest = line.strip().partition(" ")
            answer = worker.save(Path(rest)) if order == "save" else getattr(worker, order)()
            print(json.dumps(answer), file=answers)


if __name__ == "__main__":
    main()
