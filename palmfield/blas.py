"""Limit BLAS to one thread for small dense products and triangular solves.

SuperLU calls BLAS for very small blocks. For these, several threads are up to 200 times slower than one.
"""

import threading
from collections.abc import Callable
from functools import cached_property
from importlib import import_module
from typing import Any

from threadpoolctl import ThreadpoolController


class OneBlasThread:
    """A context in which every BLAS of this process uses one thread. It may be nested, and used by several threads.

    The number of threads is a setting of the whole process. The first thread that enters the context stores it, and the
    last thread that leaves restores it. If each thread restored its own value, the process could remain at one thread.
    A context of threadpoolctl takes about 40 Python calls; this one takes two.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._inside = 0
        self._before: list[int] = []

    @cached_property
    def _libraries(self) -> list[tuple[Callable[[], int], Callable[[int], Any]]]:
        """Return functions that read and set the number of threads, for each BLAS library."""
        # SciPy has its own BLAS, which is found after it is loaded
        import_module("scipy.linalg")
        result = []
        for library in ThreadpoolController().lib_controllers:
            if library.user_api != "blas":
                continue
            read: Any = library.get_num_threads
            write: Any = library.set_num_threads
            # Use the C functions if available, because those of threadpoolctl take several Python calls
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
