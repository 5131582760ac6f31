"""Run Warp kernels on a device, and share memory with NumPy."""

import atexit
import ctypes
import functools
import logging
import math
import os
import shutil
import tempfile
import threading
import weakref
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import filelock
import numpy as np
import platformdirs
import warp as wp
from numpy.typing import ArrayLike, NDArray

from palmfield.cache import WAIT_S
from palmfield.errors import DeviceError, PalmfieldError, reason_of
from palmfield.phases import phase

KERNELS = "WARP_CACHE_PATH"
"""Environment variable for the folder of compiled Warp kernels."""
ROOM_FILES, ROOM_BYTES = 16, 2**16
"""Number of files, and size of each [bytes], for which a folder must have space before a kernel is compiled."""


def _kernels_folder() -> None:
    """If the usual kernel folder cannot be made, use a folder of this process and its children."""
    named = os.environ.get(KERNELS)
    usual = os.path.join(named or platformdirs.user_cache_dir("warp", "NVIDIA"), wp.__version__)
    try:
        if not named and not os.path.isabs(usual):
            raise FileNotFoundError("this user has no home folder")
        os.makedirs(usual, exist_ok=True)
    except OSError as error:
        os.environ[KERNELS] = _temporary_folder(usual, error)


def _refusal(folder: str) -> OSError | None:
    """Return why files cannot be stored in a folder (full disk, quota, number of files), or None."""
    data = os.urandom(ROOM_BYTES)
    try:
        with tempfile.TemporaryDirectory(dir=folder) as made:
            for number in range(ROOM_FILES):
                Path(made, str(number)).write_bytes(data)
    except OSError as error:
        return error
    return None


def _temporary_folder(usual: str, error: OSError) -> str:
    """Return a new folder for the kernels of this process instead of the usual one, and log a warning why."""
    why = f"folder {usual} for compiled kernels is not writable ({reason_of(error)})"
    do = f"set {KERNELS} to a writable folder with free space"
    try:
        made = tempfile.mkdtemp(prefix="palmfield-kernels-")
        atexit.register(shutil.rmtree, made, ignore_errors=True)
        if full := _refusal(made):
            raise full
    except OSError as second:
        raise PalmfieldError(f"{why}, nor is a temporary folder ({reason_of(second)}); {do}") from error
    logging.getLogger(__name__).warning("%s, so each run compiles them again; %s", why, do)
    return made


def _start() -> None:
    """Initialise Warp without the message that there is no GPU. C code would write it directly to standard error."""
    wp.config.log_level = wp.LOG_WARNING
    if wp.config.kernel_cache_dir is None:
        _kernels_folder()
    saved, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        wp.init()
    finally:
        os.dup2(saved, 2)
        os.close(saved)
        os.close(nowhere)


_start()


def resolve(device: str = "auto") -> str:
    """Return the name of the Warp device for `auto` (first GPU, or else the CPU), `cpu` or `cuda:N`.

    Raises PalmfieldError if the device is not on this machine.
    """
    if device == "auto":
        return "cuda:0" if wp.is_cuda_available() else "cpu"
    names = [str(d) for d in wp.get_devices()]
    if device not in names:
        raise PalmfieldError(f"device '{device}' is not on this machine; use one of auto, {', '.join(names)}")
    return device


class SharedArray:
    """An array of fixed size: `host` for NumPy, `array` for kernels.

    On the CPU both use the same memory. On a GPU `host` is pinned memory. `upload` and `download` copy data in the
    order of the device's stream. Synchronise it (`wp.synchronize_stream`) before you read downloaded data.

    shape: shape of the Warp array; dtype: its type, for example wp.vec3; device: as returned by `resolve`
    """

    def __init__(self, shape: int | tuple[int, ...], dtype: Any, device: str) -> None:
        self.array: wp.array = wp.zeros(shape, dtype=dtype, device=device)
        self._pinned: wp.array | None = None
        if device != "cpu":
            self._pinned = wp.zeros(shape, dtype=dtype, device="cpu", pinned=True)
        self.host: NDArray[Any] = (self.array if self._pinned is None else self._pinned).numpy()

    def put(self, values: ArrayLike) -> None:
        """Write values to `host` and `array`. If a copy is in progress, wait for its end first."""
        if self._pinned is not None:
            wp.synchronize_stream(self.array.device)
            self.host[...] = values
            wp.copy(self.array, self._pinned)
        else:
            self.host[...] = values

    def upload(self, count: int = 0) -> None:
        """Copy `host`, or its first `count` values, to `array`.

        `host` must not change before the stream of the device is synchronised.
        """
        if self._pinned is not None:
            wp.copy(self.array, self._pinned, count=count)

    def download(self, count: int = 0) -> None:
        """Copy `array`, or its first `count` values, to `host`."""
        if self._pinned is not None:
            wp.copy(self._pinned, self.array, count=count)


PAGE = 256
"""Alignment of arrays in a SharedBlock [bytes], as in memory that Warp allocates."""


class SharedBlock:
    """Several arrays of fixed size in one block of memory. One operation copies the block to or from the device.

    hosts, arrays: by name, as `host` and `array` of a SharedArray; nbytes: size of the memory
    parts: shape and Warp type by name; device: as returned by `resolve`
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
        """Copy all arrays, or those before `before`, to the device, as SharedArray.upload does."""
        self._whole.upload(0 if before is None else self._starts[before])

    def download(self) -> None:
        """Copy all arrays to the host, as SharedArray.download does."""
        self._whole.download()


def nbytes(part: tuple[tuple[int, ...], Any]) -> int:
    """Return the size of an array with a shape and Warp type [bytes]."""
    shape, dtype = part
    return math.prod(shape) * wp.types.type_size_in_bytes(dtype)


def free_bytes(device: str) -> int | None:
    """Return the free memory of a device of `resolve` [bytes]; None for the CPU, which is not checked."""
    return None if device == "cpu" else int(wp.get_device(device).free_memory)


def check_room(needed: int, worlds: int, device: str) -> None:
    """Raise DeviceError if the free memory of a device is less than `needed` [bytes], for `worlds` worlds."""
    free = free_bytes(device)
    if free is not None and needed > free:
        raise DeviceError(
            f"{worlds} worlds need {needed / 2**30:.2f} GB on {device}, {needed / worlds / 2**20:.2f} MB each, but "
            f"{free / 2**30:.2f} GB are free; allowed: worlds <= {int(worlds * free / needed)}; or use fewer "
            "samples of the force",
            mends=("force_accuracy",),
        )


THREADS = 128
"""Number of threads of a block on a GPU."""


class _Loader:
    """A thread that loads modules, for one set of compiler flags. Warp then parses its headers once for all of them."""

    def __init__(self) -> None:
        self.waiting: deque[tuple[Future[None], Callable[[], None]]] = deque()
        self.busy, self.more = threading.Lock(), threading.Semaphore(0)  # busy: while it loads
        threading.Thread(target=self._work, name="palmfield-kernels", daemon=True).start()

    def _work(self) -> None:
        while self.more.acquire():
            with self.busy, suppress(IndexError):  # none waits when the process ends
                done, load = self.waiting.popleft()
                try:
                    done.set_result(load())
                except BaseException as error:
                    done.set_exception(error)


_moving = threading.Lock()
"""Lock that is acquired while the folder of kernels changes."""
absent: list[str] = []
"""Names of the modules that this process did not find compiled."""


def _load(module: wp.Module, device: str, block_dim: int) -> None:
    """Read a module that any process has compiled, or compile it; if its folder takes no new files, in another one."""
    with _moving:
        folder = str(wp.config.kernel_cache_dir)
        compiled = Path(folder, module.get_module_identifier(block_dim=block_dim))
        alone = not compiled.exists()
        if alone:
            absent.append(compiled.name)
        # Before the compilation, because LLVM ends the process if it cannot write
        if alone and (error := _refusal(folder)):
            wp.config.kernel_cache_dir = os.environ[KERNELS] = _temporary_folder(folder, error)
            alone = False  # no other process has this folder
    with _alone(compiled) if alone else nullcontext():
        wp.load_module(module, device=device, block_dim=block_dim)


@contextmanager
def _alone(compiled: Path) -> Iterator[None]:
    """Wait for another process that compiles this module, which is then read from the folder; not beyond the end of
    this process."""
    lock = filelock.FileLock(f"{compiled}.lock", timeout=1.0)
    with suppress(OSError, NotImplementedError):  # then both processes compile it
        for _ in range(round(WAIT_S)):
            if _ends.is_set():
                raise RuntimeError("this process ends")
            with suppress(filelock.Timeout):
                lock.acquire()
                break
    try:
        yield
    finally:
        lock.release()
        with suppress(OSError):
            os.unlink(lock.lock_file)


_Load = tuple[_Loader, tuple[Future[None], Callable[[], None]]]
_loads: dict[Any, dict[tuple[str, int], _Load]] = {}
_loaders: dict[object, _Loader] = {}
_ends = threading.Event()
"""Set when the process ends."""


def _load_of(module: Any, device: str, block_dim: int) -> _Load:
    """Return the load of a module. If it was not requested before, it waits behind all other loads."""
    module = module if isinstance(module, wp.Module) else wp.get_module(module.__name__)
    loads, key = _loads.setdefault(module, {}), (device, 1 if device == "cpu" else block_dim)
    if key not in loads:
        of = module.options["cpu_compiler_flags"] if device == "cpu" else len(_loads) % 4  # as many for a GPU
        loader = _loaders.get(of) or _loaders.setdefault(of, _Loader())
        load: _Load = loader, (Future(), functools.partial(_load, module, device, key[1]))
        if loads.setdefault(key, load) is load:  # another thread may have been quicker
            loader.waiting.append(load[1])
            loader.more.release()
    return loads[key]


def load_ahead(modules: Iterable[Any], device: str) -> None:
    """Begin to compile and load kernel modules, in this order. Launches wait for them, and raise their errors."""
    for module in modules:
        _load_of(module, device, THREADS)


def load_kernels(module: Any, device: str, block_dim: int = THREADS) -> None:
    """Load a module of kernels (or that of a kernel) before all others. Ctrl-C does not wait for the compiler.

    block_dim: threads per block on a GPU. Raises the errors of Warp.
    """
    loader, load = _load_of(module, device, block_dim)
    if not load[0].done():
        with suppress(ValueError):  # it is being loaded
            loader.waiting.remove(load)
            loader.waiting.appendleft(load)
            loader.more.release()  # the thread may have found it missing
        with phase("kernels"):
            load[0].exception()
    load[0].result()


def _end_loading() -> None:
    """Let compilers finish their present module, and start no other one. They must not run while the process ends."""
    _ends.set()
    for loader in list(_loaders.values()):
        loader.waiting.clear()
        with loader.busy:
            _loads.clear()


weakref.finalize(_Loader, int)  # so that temporary folders, as of Warp's headers, are removed after `_end_loading`
atexit.register(_end_loading)
os.register_at_fork(after_in_child=_loaders.clear)  # a forked process has none of the threads
os.register_at_fork(after_in_child=_loads.clear)


def run_kernel(kernel: Any, dim: Any, inputs: Sequence[Any], outputs: Sequence[Any] = (), **options: Any) -> Any:
    """Call `wp.launch` for a kernel, whose module `load_kernels` loads. options: of wp.launch; `device` is required"""
    load_kernels(kernel.module, str(options["device"]), options.get("block_dim", 256))
    return wp.launch(kernel, dim, inputs, outputs, **options)


def launch(kernel: Any, dim: int | tuple[int, ...], inputs: Sequence[Any], device: str) -> Callable[[], object]:
    """Return a call that launches a kernel with these arguments. Unlike `recorded`, `wp.ScopedCapture` records it."""
    return run_kernel(kernel, dim, inputs, device=device, block_dim=THREADS, record_cmd=True).launch


def matrix_product(left: Any, right: Any, result: Any, device: str) -> Callable[[], object]:
    """Return a call that sets `result` to left @ right. All are float32 matrices on the device."""
    from warp_kernels import products

    tiles = -(-result.shape[0] // products.ROWS), -(-result.shape[1] // products.COLUMNS)
    # All threads of a block compute one tile together
    return launch(products.product, (*tiles, 1 if device == "cpu" else THREADS), [left, right, result], device)


launching = threading.Lock()
"""Lock during the capture of a graph. Otherwise launches by other threads would become part of the graph."""


@dataclass(frozen=True)
class Branches:
    """Independent lists of calls. On a GPU, a graph runs the lists in parallel."""

    parts: tuple[Sequence[Callable[[], object]], ...]

    def __call__(self) -> None:
        """Run all calls, one list after the other."""
        for part in self.parts:
            for call in part:
                call()

    def captured(self, device: str) -> None:
        """Run all calls while a graph is captured on a GPU, each list on a separate stream."""
        main, others = wp.get_stream(device), _streams(device, len(self.parts) - 1)
        for stream in others:
            stream.wait_stream(main)
        for stream, part in zip(others, self.parts[1:], strict=True):
            with wp.ScopedStream(stream, sync_enter=False):
                for call in part:
                    call()
        for call in self.parts[0]:
            call()
        for stream in others:
            main.wait_stream(stream)


_side_streams: dict[str, list[Any]] = {}


def _streams(device: str, count: int) -> list[Any]:
    """Return streams on which graphs are captured. Later calls return the same streams."""
    made = _side_streams.setdefault(device, [])
    made += [wp.Stream(device) for _ in range(count - len(made))]
    return made[:count]


def replayed(calls: Sequence[Callable[[], object]], device: str) -> Callable[[], object]:
    """Return a call that runs launches and copies, in order, as one captured graph. They are also run once now.

    Other threads must acquire `launching` for their launches.
    """
    with launching:
        # Done once before capture, so that kernels are loaded and Warp has allocated its own memory
        for call in calls:
            call()
        if device != "cpu":
            # Downloads of this run must not overwrite data that the caller writes for the first replay
            wp.synchronize_stream(device)
            # Streams and their events cannot be made while a graph is captured
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
    replay.calls = calls  # a graph stores only addresses; the calls keep their arrays alive
    return replay


def filled(struct: Any, **values: Any) -> Any:
    """Set members of a Warp struct, and return it."""
    for name, value in values.items():
        setattr(struct, name, value)
    return struct


def whole_numbers(values: ArrayLike, device: str = "cpu") -> Any:
    """Return a Warp array of int32 with a copy of values."""
    return wp.array(np.asarray(values, dtype=np.int32), dtype=wp.int32, device=device)


def vectors(values: ArrayLike, device: str) -> Any:
    """Return a Warp array of vec3d with a copy of values, shape (n, 3)."""
    return wp.array(np.ascontiguousarray(values, np.float64), dtype=wp.vec3d, device=device)


def gather(arrays: Sequence[Any], out: NDArray[Any]) -> None:
    """Copy contiguous arrays one after the other into `out`."""
    start = 0
    for array in arrays:
        if array.size:
            numbers = array.numpy().ravel()
            out[start : start + len(numbers)] = numbers
            start += len(numbers)


def scatter(numbers: NDArray[Any], arrays: Sequence[Any]) -> None:
    """Copy numbers that `gather` wrote back to arrays."""
    start = 0
    for array in arrays:
        if array.size:
            shape = (*array.shape, wp.types.type_size(array.dtype))
            array.assign(numbers[start : start + math.prod(shape)].reshape(shape))
            start += math.prod(shape)


def available_bytes() -> int:
    """Return the memory that is available without swapping [bytes]. It is 8 GB if the system does not report it."""
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
    except OSError:
        return 2**33
    return next(1024 * int(line.split()[1]) for line in lines if line.startswith("MemAvailable:"))


DIRECT_LAUNCH = ("1.19",)
"""Versions of Warp whose compiled CPU kernels can be called directly with bounds and packed arguments."""


def recorded(kernel: Any, dim: int | tuple[int, ...], inputs: Sequence[Any], device: str) -> Callable[[], object]:
    """Return a call that launches a kernel with these arguments. The arrays are fixed; their values may change.

    A recorded launch of Warp packs its arguments each time, which takes 5 us and 10 to 20 Python calls. This function
    packs them once, on the CPU and with a tested version of Warp; a launch then takes 1 us. `wp.ScopedCapture` does not
    record such a launch.

    device: as returned by `resolve`; on a GPU blocks have 128 threads
    """
    command = run_kernel(kernel, dim, inputs, device=device, block_dim=THREADS, record_cmd=True)
    if device != "cpu" or command.block_dim != 1 or not wp.__version__.startswith(DIRECT_LAUNCH):
        return command.launch
    values = command.params[1:]
    arguments = _arguments(tuple(map(type, values)))(*values)
    arguments.command = command  # the arrays must live as long as the call
    return functools.partial(command.hooks.forward, ctypes.byref(command.bounds), ctypes.byref(arguments))


@functools.lru_cache(maxsize=256)
def _arguments(types: tuple[type, ...]) -> type[ctypes.Structure]:
    """Return a structure of packed arguments. Making one takes as long as recording a launch."""
    return type("Arguments", (ctypes.Structure,), {"_fields_": [(f"argument_{i}", of) for i, of in enumerate(types)]})
