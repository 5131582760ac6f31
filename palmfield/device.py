"""Where Warp kernels run, and the memory that they share with NumPy."""

import atexit
import ctypes
import functools
import logging
import math
import os
import shutil
import tempfile
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import platformdirs
import warp as wp
from numpy.typing import ArrayLike, NDArray

from palmfield.errors import DeviceError, PalmfieldError, reason_of
from palmfield.phases import phase
from warp_kernels import products

KERNELS = "WARP_CACHE_PATH"
"""The environment's name for the folder in which Warp keeps compiled kernels."""


def _kernels_folder() -> None:
    """Have kernels kept in a folder of this process and its children where the usual one can't be written."""
    usual = os.environ.get(KERNELS) or platformdirs.user_cache_dir("warp", "NVIDIA", wp.__version__)
    try:
        if not os.environ.get(KERNELS) and not os.path.isabs(usual):
            raise FileNotFoundError("this user has no home folder")
        os.makedirs(usual, exist_ok=True)
        tempfile.TemporaryFile(dir=usual).close()
        return
    except OSError as error:
        why = reason_of(error)
    try:
        made = tempfile.mkdtemp(prefix="palmfield-kernels-")
    except OSError as error:
        raise PalmfieldError(
            f"folder {usual} for compiled kernels is not writable ({why}), and neither is a temporary one: set "
            f"{KERNELS} to a writable folder"
        ) from error
    atexit.register(shutil.rmtree, made, ignore_errors=True)
    os.environ[KERNELS] = made
    logging.getLogger(__name__).warning(
        "folder %s for compiled kernels is not writable (%s), so each run compiles them again; set %s to a "
        "writable folder", usual, why, KERNELS,
    )  # fmt: skip


def _start() -> None:
    """Initialise Warp without its notice that there is no GPU, which C code writes straight to standard error."""
    wp.config.log_level = wp.LOG_WARNING
    if wp.config.kernel_cache_dir is None:
        _kernels_folder()
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        wp.init()
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


_start()


def resolve(device: str = "auto") -> str:
    """Name of the Warp device for `auto`, `cpu` or `cuda:N`; `auto` takes the first GPU if there is one.

    Raises PalmfieldError when the device is not on this machine.
    """
    if device == "auto":
        return "cuda:0" if wp.is_cuda_available() else "cpu"
    known = [str(d) for d in wp.get_devices()]
    if device not in known:
        raise PalmfieldError(f"device '{device}' is not on this machine; use one of auto, {', '.join(known)}")
    return device


class SharedArray:
    """An array of fixed size that NumPy sees as `host` and kernels as `array`.

    On the CPU both are one memory. On a GPU `host` is pinned memory: `upload` and `download` copy, in the order of the
    device's stream, which must be waited for (`wp.synchronize_stream`) before `host` holds what was downloaded.

    shape: of the Warp array; dtype: its type, for example wp.vec3; device: of `resolve`
    """

    def __init__(self, shape: int | tuple[int, ...], dtype: Any, device: str) -> None:
        self.array: wp.array = wp.zeros(shape, dtype=dtype, device=device)
        self._pinned: wp.array | None = None
        if device != "cpu":
            self._pinned = wp.zeros(shape, dtype=dtype, device="cpu", pinned=True)
        self.host: NDArray[Any] = (self.array if self._pinned is None else self._pinned).numpy()

    def put(self, values: ArrayLike) -> None:
        """Give kernels these values, which `host` then holds; a copy that is still under way is waited for."""
        if self._pinned is not None:
            wp.synchronize_stream(self.array.device)
            self.host[...] = values
            wp.copy(self.array, self._pinned)
        else:
            self.host[...] = values

    def upload(self, count: int = 0) -> None:
        """Give kernels what `host` holds, or its first `count` values.

        Until the device's stream is waited for, they must stay as they are.
        """
        if self._pinned is not None:
            wp.copy(self.array, self._pinned, count=count)

    def download(self, count: int = 0) -> None:
        """Fetch into `host` what kernels have written, or the first `count` values of it."""
        if self._pinned is not None:
            wp.copy(self._pinned, self.array, count=count)


PAGE = 256
"""Bytes to whose multiples arrays are aligned in a SharedBlock, as in memory that Warp allocates."""


class SharedBlock:
    """Several arrays of fixed size in one memory, which one copy takes to the device or back, and which it owns.

    hosts, arrays: by name, as `host` and `array` of a SharedArray; nbytes: of the memory
    parts: shape and Warp type by name; device: of `resolve`
    """

    def __init__(self, parts: Mapping[str, tuple[tuple[int, ...], Any]], device: str) -> None:
        sizes = [nbytes(part) for part in parts.values()]
        starts = np.cumsum([0, *(-(-size // PAGE) * PAGE for size in sizes)]).tolist()
        self._starts = dict(zip(parts, starts, strict=False))
        self.nbytes = max(starts[-1], 1)
        self._whole = SharedArray(self.nbytes, wp.uint8, device)
        self.arrays: dict[str, Any] = {}
        self.hosts: dict[str, NDArray[Any]] = {}
        for (name, (shape, dtype)), start in zip(parts.items(), starts, strict=False):
            there: Any = wp.array(ptr=self._whole.array.ptr + start, dtype=dtype, shape=shape, device=device)
            here: Any = there
            if device != "cpu":
                here = wp.array(ptr=self._whole.host.ctypes.data + start, dtype=dtype, shape=shape, device="cpu")
            self.arrays[name], self.hosts[name] = there, here.numpy()

    def upload(self, before: str | None = None) -> None:
        """As SharedArray.upload, for all arrays, or those before this one."""
        self._whole.upload(0 if before is None else self._starts[before])

    def download(self) -> None:
        """As SharedArray.download, for all arrays."""
        self._whole.download()


def nbytes(part: tuple[tuple[int, ...], Any]) -> int:
    """What an array takes, by its shape and Warp type."""
    shape, dtype = part
    return math.prod(shape) * wp.types.type_size_in_bytes(dtype)


def free_bytes(device: str) -> int | None:
    """Memory that is free on a device of `resolve`; None for the CPU, whose memory nobody limits here."""
    return None if device == "cpu" else int(wp.get_device(device).free_memory)


def check_room(needed: int, worlds: int, device: str) -> None:
    """Raise DeviceError where so many bytes for so many worlds are not free on a device, before they are taken."""
    free = free_bytes(device)
    if free is not None and needed > free:
        raise DeviceError(
            f"{worlds} worlds need {needed / 2**30:.2f} GB on {device}, {needed / worlds / 2**20:.2f} MB each, but "
            f"{free / 2**30:.2f} GB are free; allowed: worlds <= {int(worlds * free / needed)}; or use fewer "
            "samples of the force",
            mends=("force_accuracy",),
        )


_loading = threading.Lock()
"""Held while a kernel's module may be loaded: of two threads that load the same one, Warp may leave one with code that
the other has unloaded."""


def load_kernels(module: Any, device: str) -> None:
    """Load a module of kernels, or the one of `kernel.module`, before several threads launch from it."""
    with _loading, phase("kernels"):
        wp.load_module(module, device=device)


def launch(kernel: Any, dim: int | tuple[int, ...], inputs: Sequence[Any], device: str) -> Callable[[], object]:
    """A call that launches a kernel with these arguments, as `recorded`, but one that `wp.ScopedCapture` sees."""
    return _command(kernel, dim, inputs, device).launch


THREADS = 128
"""In a block, on a GPU."""


def _command(kernel: Any, dim: int | tuple[int, ...], inputs: Sequence[Any], device: str) -> Any:
    with _loading, phase("kernels"):
        return wp.launch(kernel, dim=dim, inputs=inputs, device=device, block_dim=THREADS, record_cmd=True)


def matrix_product(left: Any, right: Any, result: Any, device: str) -> Callable[[], object]:
    """A call as `launch` gives it that makes `result` left @ right: float32 arrays on the device, each of two axes."""
    tiles = -(-result.shape[0] // products.ROWS), -(-result.shape[1] // products.COLUMNS)
    # All threads of a block do one tile together
    return launch(products.product, (*tiles, 1 if device == "cpu" else THREADS), [left, right, result], device)


launching = threading.Lock()
"""Held while a graph is captured: what another thread launches meanwhile on the device would become part of it."""


@dataclass(frozen=True)
class Branches:
    """Lists of calls of which none needs what another list does: on a GPU a graph does them side by side."""

    parts: tuple[Sequence[Callable[[], object]], ...]

    def __call__(self) -> None:
        """All of them, one list after the other."""
        for part in self.parts:
            for call in part:
                call()

    def captured(self, device: str) -> None:
        """The same while a graph is captured on a GPU, each list on a stream of its own."""
        main, beside = wp.get_stream(device), _streams(device, len(self.parts) - 1)
        for stream in beside:
            stream.wait_stream(main)
        for stream, part in zip(beside, self.parts[1:], strict=True):
            with wp.ScopedStream(stream, sync_enter=False):
                for call in part:
                    call()
        for call in self.parts[0]:
            call()
        for stream in beside:
            main.wait_stream(stream)


_beside: dict[str, list[Any]] = {}


def _streams(device: str, count: int) -> list[Any]:
    """Streams for graphs to be captured on; kept."""
    known = _beside.setdefault(device, [])
    known += [wp.Stream(device) for _ in range(count - len(known))]
    return known[:count]


def replayed(calls: Sequence[Callable[[], object]], device: str) -> Callable[[], object]:
    """A call that does all of these launches and copies, in order, as one captured graph; they are done once here.

    Other threads launch theirs under `launching`.
    """
    with launching:
        # Done before they are captured: kernels are loaded then, and memory that Warp needs beside ours is there
        for call in calls:
            call()
        if device != "cpu":
            # What comes back now must not come over what the caller puts there for the graph's first replay
            wp.synchronize_stream(device)
            # Streams, and the events by which they wait for one another, can't be made while a graph is captured
            most = max((len(call.parts) for call in calls if isinstance(call, Branches)), default=1)
            for stream in (wp.get_stream(device), *_streams(device, most - 1)):
                assert stream.cached_event is not None
        with wp.ScopedCapture(device=device) as capture:
            for call in calls:
                if isinstance(call, Branches) and device != "cpu":
                    call.captured(device)
                else:
                    call()
    replay: Any = functools.partial(wp.capture_launch, capture.graph)
    replay.calls = calls  # a graph knows addresses only: with its calls their arrays live as long
    return replay


def filled(struct: Any, **values: Any) -> Any:
    """The Warp struct with its members set."""
    for name, value in values.items():
        setattr(struct, name, value)
    return struct


def whole_numbers(values: ArrayLike, device: str = "cpu") -> Any:
    """A Warp array of int32, with a copy of these values."""
    return wp.array(np.asarray(values, dtype=np.int32), dtype=wp.int32, device=device)


def vectors(values: ArrayLike, device: str) -> Any:
    """A Warp array of vec3d, with a copy of these values, shape (n, 3)."""
    return wp.array(np.ascontiguousarray(values, np.float64), dtype=wp.vec3d, device=device)


def gather(arrays: Sequence[Any], out: NDArray[Any]) -> None:
    """Write the numbers of contiguous arrays one after the other into `out`."""
    start = 0
    for array in arrays:
        if array.size:
            numbers = array.numpy().ravel()
            out[start : start + len(numbers)] = numbers
            start += len(numbers)


def scatter(numbers: NDArray[Any], arrays: Sequence[Any]) -> None:
    """Fill arrays from what `gather` has written."""
    start = 0
    for array in arrays:
        if array.size:
            shape = (*array.shape, wp.types.type_size(array.dtype))
            array.assign(numbers[start : start + math.prod(shape)].reshape(shape))
            start += math.prod(shape)


def available_bytes() -> int:
    """Memory that programs can take without swapping; 8 GB where the system doesn't say."""
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
    except OSError:
        return 2**33
    return next(1024 * int(line.split()[1]) for line in lines if line.startswith("MemAvailable:"))


DIRECT_LAUNCH = ("1.19",)
"""Versions of Warp whose compiled kernels on the CPU are known to take a launch's bounds and its packed arguments."""


def recorded(kernel: Any, dim: int | tuple[int, ...], inputs: Sequence[Any], device: str) -> Callable[[], object]:
    """A call that launches a kernel with these arguments: the same arrays, whatever they hold by then.

    A launch that Warp records packs its arguments again each time, in 5 us and 10 to 20 Python calls. On the CPU, with
    a version of Warp where that is known to work, they are packed once here, and a launch takes 1 us. Such a launch is
    not seen by `wp.ScopedCapture`.

    device: of `resolve`; on a GPU blocks have 128 threads
    """
    command = _command(kernel, dim, inputs, device)
    if device != "cpu" or command.block_dim != 1 or not wp.__version__.startswith(DIRECT_LAUNCH):
        return command.launch
    values = command.params[1:]
    arguments = _arguments(tuple(map(type, values)))(*values)
    arguments.command = command  # the arrays must live as long as the call
    return functools.partial(command.hooks.forward, ctypes.byref(command.bounds), ctypes.byref(arguments))


@functools.lru_cache(maxsize=256)
def _arguments(types: tuple[type, ...]) -> type[ctypes.Structure]:
    """A structure of packed arguments; to make one takes as long as to record a launch."""
    return type("Arguments", (ctypes.Structure,), {"_fields_": [(f"argument_{i}", of) for i, of in enumerate(types)]})
