"""One BLAS thread while small dense products and triangular solves run.

SuperLU asks BLAS for blocks so small that its threads wait for each other: up to 200 times slower than one thread.
"""

import threading
from collections.abc import Callable
from functools import cached_property
from importlib import import_module
from typing import Any

from threadpoolctl import ThreadpoolController


class OneBlasThread:
    """A context in which every BLAS of this process uses one thread; it may be nested, and entered by many threads.

    The number of threads belongs to the whole process, so the first that enters remembers it and the last that leaves
    restores it: two threads that each restored what they found could leave the process at one thread for ever.
    threadpoolctl's own contexts take some 40 Python calls each; this one takes two.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._inside = 0
        self._before: list[int] = []

    @cached_property
    def _libraries(self) -> list[tuple[Callable[[], int], Callable[[int], Any]]]:
        """How to read and to set the number of threads of each BLAS."""
        # SciPy brings a BLAS of its own, which can be found once it is loaded.
        import_module("scipy.linalg")
        result = []
        for library in ThreadpoolController().lib_controllers:
            if library.user_api != "blas":
                continue
            read: Any = library.get_num_threads
            write: Any = library.set_num_threads
            # The C functions themselves where they can be had: threadpoolctl's are several Python calls deep.
            for prefix, suffix in (("scipy_", "64_"), ("scipy_", ""), ("", "64_"), ("", "")):
                names = (f"{prefix}openblas_{verb}_num_threads{suffix}" for verb in ("get", "set"))
                functions = [getattr(library.dynlib, name, None) for name in names]
                if library.internal_api == "openblas" and all(functions):
                    read, write = functions
                    break
            result.append((read, write))
        return result

    def __enter__(self) -> None:
        with self._lock:
            if self._inside == 0:
                self._before.clear()
                for read, write in self._libraries:
                    self._before.append(read())
                    if self._before[-1] != 1:
                        write(1)
            self._inside += 1

    def __exit__(self, *error: object) -> None:
        with self._lock:
            self._inside -= 1
            if self._inside == 0:
                for (_, write), count in zip(self._libraries, self._before, strict=True):
                    if count != 1:
                        write(count)


one_blas_thread = OneBlasThread()
