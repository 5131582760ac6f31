"""Measure processor time, wall time and memory of the phases of a run (`palmfield.phases`).

from palmfield.profile import measured
with measured() as profile:
    palmfield.run("mjcf/scenes/palm_am200.xml", "out/palm")
print(profile)
"""

import gc
import resource
import sys
import threading
import time
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

from numpy import ndarray

from palmfield.phases import running
from palmfield.terminal import printed, table

LEAST_BYTES, LEAST_S = 2**16, 0.005
"""Smallest array that is counted [bytes], and shortest phase that is printed [s]."""
BEFORE = "Python and its command line"
"""Name of the row for the time before the measurement."""
ELSEWHERE = "elsewhere"
"""Name of the row for the time outside phases."""


@dataclass
class Times:
    """Times of a phase, including all phases inside it.

    cpu_s: user and system time of its thread, and of helper threads that have no phase of their own [s]
    wall_s: wall time of the measured thread [s]
    beside_s: time of other threads, parallel to other phases [s]
    calls: number of calls
    peak_bytes: largest resident memory of the process up to the last end of the phase
    """

    cpu_s: float = 0.0
    wall_s: float = 0.0
    beside_s: float = 0.0
    calls: int = 0
    peak_bytes: int = 0


@dataclass
class Memory:
    """Arrays of one kind: present size and largest size [bytes], and number made."""

    now_bytes: int = 0
    most_bytes: int = 0
    count: int = 0


@dataclass
class _Thread:
    """A thread with open phases.

    It stores the names of its own phases and of the enclosing phase in the measured thread, and its CPU time at the
    last event [s].
    """

    around: tuple[str, ...]
    own: list[str]
    cpu_s: float

    def open(self) -> list[tuple[str, ...]]:
        """Return the keys of the open phases in Profile.phases, outermost first."""
        whole = (*self.around, *self.own)
        return [whole[:depth] for depth in range(1, len(whole) + 1)]


class Profile:
    """Measured times and memory; its text is a table.

    phases: Times by the names of a phase and its enclosing phases, outermost first. A phase in another thread
    belongs to the outermost phase of the measured thread.
    memory: Memory by kind of arrays.
    """

    def __init__(self) -> None:
        self.phases: dict[tuple[str, ...], Times] = {(BEFORE,): Times(time.process_time(), 0.0, 0.0, 1, peak_bytes())}
        self.memory: dict[str, Memory] = {}
        # A finalizer may run while this thread has the lock
        self._lock = threading.RLock()
        self._main, self._number = _Thread((), [], 0.0), threading.get_ident()
        self._others: dict[int, _Thread] = {}
        self._begun = self._wall = time.perf_counter()
        self._cpu = time.process_time()
        self._others_cpu_s = 0.0
        self._counted: set[int] = set()

    @property
    def total(self) -> Times:
        """CPU time of the processes, wall time since the beginning, and peak memory, up to the last event."""
        return Times(self._cpu + self._others_cpu_s, self._wall - self._begun, 0.0, 1, peak_bytes())

    def begin(self, name: str) -> None:
        """Begin a phase of this thread."""
        with self._lock:
            self.update()
            number = threading.get_ident()
            thread = self._main if number == self._number else self._others.get(number)
            if thread is None:
                thread = self._others[number] = _Thread(tuple(self._main.own[:1]), [], _clock(number))
            thread.own.append(name)
            self.phases.setdefault(thread.open()[-1], Times()).calls += 1

    def end(self) -> None:
        """End the last phase of this thread."""
        with self._lock:
            self.update()
            number = threading.get_ident()
            thread = self._main if number == self._number else self._others[number]
            self.phases[thread.open()[-1]].peak_bytes = peak_bytes()
            thread.own.pop()
            if not thread.own:
                self._others.pop(number, None)

    def update(self) -> None:
        """Add the time since the last event to the open phases."""
        with self._lock:
            wall, cpu = time.perf_counter(), time.process_time()
            took, used = wall - self._wall, cpu - self._cpu
            self._wall, self._cpu = wall, cpu
            for number, thread in self._others.items():
                before, thread.cpu_s = thread.cpu_s, _clock(number)
                used -= thread.cpu_s - before
                for key in thread.open():
                    self.phases[key].cpu_s += thread.cpu_s - before
                self.phases[key].beside_s += took
            for key in self._main.open():
                self.phases[key].cpu_s += used
                self.phases[key].wall_s += took

    def own_phases(self) -> dict[tuple[str, ...], Times]:
        """Return the phases measured so far, in the form for the profile of another process."""
        self.update()
        return {path: times for path, times in self.phases.items() if path != (BEFORE,)}

    def add_process(self, phases: dict[tuple[str, ...], Times]) -> None:
        """Add the phases of another process, which ran parallel to this process."""
        for path, times in phases.items():
            own = self.phases.setdefault(path, Times())
            own.cpu_s += times.cpu_s
            own.beside_s += times.wall_s + times.beside_s
            own.calls += times.calls
            own.peak_bytes = max(own.peak_bytes, times.peak_bytes)
            self._others_cpu_s += times.cpu_s * (len(path) == 1)

    def count(self, kind: str, thing: object) -> None:
        """Count the arrays of an object, each once, until they are freed."""
        with self._lock:
            memory = self.memory.setdefault(kind, Memory())
            memory.count += 1
            for array in arrays_of(thing):
                if id(array) not in self._counted:
                    self._counted.add(id(array))
                    memory.now_bytes += array.nbytes
                    weakref.finalize(array, self._freed, memory, id(array), array.nbytes).atexit = False
            memory.most_bytes = max(memory.most_bytes, memory.now_bytes)

    def _freed(self, memory: Memory, number: int, size: int) -> None:
        with self._lock:
            self._counted.discard(number)
            memory.now_bytes -= size

    def __str__(self) -> str:
        self.update()
        total, mebi = self.total, 2.0**20
        outer = [times for path, times in self.phases.items() if len(path) == 1]
        rest = Times(total.cpu_s - sum(one.cpu_s for one in outer), total.wall_s - sum(one.wall_s for one in outer))
        begun = list(self.phases)
        order = sorted(begun, key=lambda path: [begun.index(path[: depth + 1]) for depth in range(len(path))])
        listed = [("  " * (len(path) - 1) + path[-1], self.phases[path]) for path in order]
        rows = [
            (name, *(f"{number:.2f}" if number else "" for number in (one.cpu_s, one.wall_s, one.beside_s)),
             *(f"{number:.0f}" if number else "" for number in (one.calls, one.peak_bytes / mebi)))
            for name, one in [*listed, (ELSEWHERE, rest), ("all", total)]
            if max(one.cpu_s, one.wall_s + one.beside_s) >= LEAST_S
        ]  # fmt: skip
        arrays = [
            (kind, f"{one.most_bytes / mebi:.1f}", f"{one.now_bytes / mebi:.1f}", f"{one.count}")
            for kind, one in self.memory.items()
            if one.most_bytes >= LEAST_BYTES
        ]
        heads = ("phase", "CPU [s]", "wall [s]", "in parallel [s]", "calls", "peak RSS [MiB]")
        tables = [table(rows, heads), table(arrays, ("arrays", "at most [MiB]", "now [MiB]", "made"))]
        return printed(*tables, most=120)


@contextmanager
def measured() -> Iterator[Profile]:
    """Measure the phases of the block in this thread, and phases of other threads at the same time."""
    profile = Profile()
    running.append(profile)
    try:
        yield profile
    finally:
        running.remove(profile)
        profile.update()


def count_arrays(name: str, thing: object) -> None:
    """Count the arrays to which an object refers, under a name, until they are freed."""
    if running:
        running[-1].count(name, thing)


def peak_bytes() -> int:
    """Return the highest resident memory of the process so far [bytes]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def own_peak_bytes() -> int:
    """Return `peak_bytes` of a copied process, without the memory that it still shares with other processes [bytes]."""
    lines = Path("/proc/self/smaps_rollup").read_text().splitlines()
    return peak_bytes() - 1024 * sum(int(line.split()[1]) for line in lines if line.startswith("Shared_"))


def arrays_of(thing: object) -> list[Any]:
    """Return the NumPy arrays to which an object refers. They own their memory and have at least LEAST_BYTES."""
    found, todo, seen = [], [thing], set[int]()
    while todo:
        one = todo.pop()
        if id(one) in seen or isinstance(one, type | ModuleType):
            continue
        seen.add(id(one))
        if isinstance(one, ndarray) and isinstance(one.base, ndarray):
            todo.append(one.base)
        elif isinstance(one, ndarray):
            found += [one] if one.nbytes >= LEAST_BYTES else []
        else:
            todo += one.__closure__ or () if isinstance(one, FunctionType) else gc.get_referents(one)
    return found


def _clock(thread: int) -> float:
    """Return the CPU time of a running thread [s].

    If the system does not report it, 0, so the measured thread gets the time.
    """
    number = getattr(time, "pthread_getcpuclockid", None)
    return time.clock_gettime(number(thread)) if number else 0.0
