"""Dask workers: a local cluster, with one GPU for each worker if GPUs are used, or an external cluster."""

import logging
import os
import re
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

from palmfield import cache
from palmfield.errors import PalmfieldError, reason_of
from palmfield.threads import cores

REACH_S = 5.0
"""Longest wait for a scheduler [s]."""
WORKERS_S = 60.0
"""Longest wait for workers to start [s]."""
ADDRESS = r"\w+://.+:\d+"
EXAMPLE = "such as tcp://192.168.1.10:8786"


class Slot(NamedTuple):
    """One thread of a worker. address: address of the worker; threads: number of cores that a point may use"""

    address: str
    threads: int


@contextmanager
def local_cluster(workers: int, gpus: list[str]) -> Iterator[Any]:
    """Yield a Dask client with new workers on this machine: processes with one thread, which are stopped at the end.

    gpus: names of GPUs as in CUDA_VISIBLE_DEVICES, one for each worker; empty for no GPU
    Raises PalmfieldError if they do not start.
    """
    from distributed import Client, Nanny, Scheduler  # noqa: F401
    from distributed.deploy.spec import SpecCluster
    from distributed.deploy.subprocess import SubprocessWorker

    # A worker that uses much memory continues; it is ended just before the system would end another process
    memory: dict[str, Any] = {f"distributed.worker.memory.{name}": False for name in ("target", "spill", "pause")}
    specs = {}
    for number in range(workers):
        options = {"nthreads": 1, "host": "127.0.0.1", "silence_logs": logging.ERROR, "config": memory}
        if gpus:
            options["env"] = {"CUDA_VISIBLE_DEVICES": gpus[number % len(gpus)]}
        # A separately started process does not run the user's script again; one spawned by Python would
        specs[number] = {"cls": SubprocessWorker, "options": {"name": str(number), "worker_kwargs": options}}
    scheduler: dict[str, Any] = {
        "cls": Scheduler,
        "options": {"host": "127.0.0.1", "port": 0, "dashboard": False, "dashboard_address": "127.0.0.1:0"},
    }
    # Dask must not retry a batch of a lost worker: `palmfield.studies.sweeps.whole_sweep` retries its points one by one
    scheduler["options"]["allowed_failures"] = 0
    try:
        cluster = SpecCluster(workers=specs, scheduler=scheduler, silence_logs=logging.CRITICAL)
    except Exception as error:
        raise PalmfieldError(f"the local workers did not start: {reason_of(error, 300)}; use --workers 0") from error
    try:
        with Client(cluster, set_as_default=False) as client:
            try:
                client.wait_for_workers(workers, timeout=WORKERS_S)
            except TimeoutError:
                there = len(client.scheduler_info()["workers"])
                busy = os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0
                cause = (
                    f"the machine is busy ({busy:.0f} programs on {cores()} cores)"
                    if busy > cores()
                    else "the cause is unknown"
                )
                raise PalmfieldError(
                    f"only {there} of {workers} local workers started within {WORKERS_S:g} s: {cause}; close other "
                    "programs, give fewer by --workers, or --workers 0"
                ) from None
            yield client
    finally:
        with suppress(Exception):
            cluster.close(timeout=10)


@contextmanager
def remote_cluster(address: str) -> Iterator[Any]:
    """Yield a Dask client of a running scheduler. Raises PalmfieldError if it cannot be reached."""
    from distributed import Client

    if not re.fullmatch(ADDRESS, address):
        raise PalmfieldError(f"--scheduler has value '{address}'; allowed: PROTOCOL://HOST:PORT, {EXAMPLE}")
    try:
        client = Client(address, timeout=REACH_S, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise PalmfieldError(
            f"--scheduler {address} was not reached within {REACH_S:g} s ({reason_of(error, 300)}); give the address "
            f"of a running `dask scheduler`, {EXAMPLE}"
        ) from None
    try:
        _wait(client, 1, f"a worker of {address} (start some with `dask worker {address}`)", 2 * REACH_S)
        yield client
    finally:
        with suppress(Exception):
            client.close(timeout=5)


def slots(client: Any, scene: Path) -> list[Slot]:
    """Return the threads of all workers. Check that each worker has the same palmfield and can read the scene.

    Raises PalmfieldError with the name of the worker if the check fails.
    """
    own = cache.code_mark()
    try:
        facts_of: dict[str, dict[str, Any]] = client.run(worker_facts, str(scene))
    except Exception as error:
        raise PalmfieldError(
            f"the workers cannot run palmfield: {reason_of(error, 300)}; install the same palmfield there, with extra "
            "[sweep]"
        ) from None
    for address, facts in facts_of.items():
        if facts["mark"] != own:
            raise PalmfieldError(
                f"worker {address} has another version of palmfield, numpy, scipy or warp; install the same"
            )
        if not facts["sees"]:
            raise PalmfieldError(f"worker {address} cannot read {scene}; put the scene where all workers can read it")
    threads = client.nthreads()
    on_host: Counter[str] = Counter()
    for address in facts_of:
        on_host[facts_of[address]["host"]] += threads[address]
    return [
        Slot(address, max(1, facts["cores"] // on_host[facts["host"]]))
        for address, facts in facts_of.items()
        for _ in range(threads[address])
    ]


def worker_facts(scene: str) -> dict[str, Any]:
    """Return the digest of the code on a worker, whether it can read the scene, its host and number of cores."""
    import platform

    return {"mark": cache.code_mark(), "sees": Path(scene).is_file(), "host": platform.node(), "cores": cores()}


def visible_gpus() -> list[str]:
    """Return the GPUs of this machine that this process may use, as in CUDA_VISIBLE_DEVICES."""
    import warp

    from palmfield import device  # noqa: F401  initialises Warp without its message that no GPU exists

    count = warp.get_cuda_device_count()
    named = [name.strip() for name in os.environ.get("CUDA_VISIBLE_DEVICES", "").split(",") if name.strip()]
    return named[:count] if named else [str(number) for number in range(count)]


def gpu_memory_bytes() -> int:
    """Return the free memory of the usable GPU with the least free memory; 0 without a GPU."""
    import warp

    return min((device.free_memory for device in warp.get_cuda_devices()), default=0)


def _wait(client: Any, count: int, what: str, timeout_s: float) -> None:
    try:
        client.wait_for_workers(count, timeout=timeout_s)
    except TimeoutError:
        raise PalmfieldError(f"{what}: no reply within {timeout_s:g} s; check that the workers run") from None
