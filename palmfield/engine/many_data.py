"""Several mjData of one mjModel. Loops over them run in C; they hold the GIL only while a callback needs Python."""

import ctypes
from collections.abc import Callable, Sequence
from typing import Any, Literal

import numpy as np
import warp as wp

from palmfield.device import recorded, whole_numbers
from palmfield.mujoco_host.mujoco_view import DataView
from palmfield.mujoco_host.structs import library, mirror
from palmfield.threads import cores, share
from palmfield.types import Float
from warp_kernels import mujoco_calls as kernels

Field = Literal[
    "xpos", "xmat", "site_xpos", "site_xmat", "mocap_pos", "mocap_quat", "ctrl", "qpos", "qvel", "sensordata", "time"
]
"""Fields of mjData in float64. The address of each field stays the same during the life of the mjData."""
WORLDS_PER_THREAD = 16
"""Smallest number of mjData for which one more thread is used."""


class ManyData:
    """Several mjData with the same mjModel.

    views: views of the mjData, one each
    calls_back: whether MuJoCo calls Python in a step; if so, threads must wait for the GIL
    """

    def __init__(self, views: Sequence[DataView], calls_back: bool):
        self.views = tuple(views)
        self._model = views[0].model.address
        self._threads = 1 if calls_back else min(cores(), -(-len(views) // WORLDS_PER_THREAD))
        self._data: Any = wp.array([view.address for view in views], dtype=wp.uint64, device="cpu")
        self._times: Float = np.zeros((len(views), 1))
        self._calls: dict[str, list[Callable[[], object]]] = {}
        self._addresses: dict[str, Any] = {}
        self._gathering: dict[str, Callable[[], object]] = {}
        self._putting: dict[tuple[Field, bytes], tuple[Float, Callable[[], object]]] = {}
        self._pushing: dict[bytes, tuple[Float, Sequence[Callable[[], object]]]] = {}

    def call(self, name: str) -> None:
        """Call a MuJoCo function of a model and its data, for each mjData."""
        calls = self._calls.get(name)
        if calls is None:
            parts = [self._data[own] for own in self._blocks()]
            inputs = _function(name), wp.uint64(self._model)
            calls = [recorded(kernels.call_each, len(part), [*inputs, part], "cpu") for part in parts]
            self._calls[name] = calls
        self._share(calls)

    def gather(self, field: Field, offsets: Sequence[int], result: Float) -> None:
        """Read a field at offsets (n,) of each mjData into a float64 array of shape (w, n).

        Pass the same array in all calls for one field.
        """
        if field not in self._gathering:
            target: Any = wp.array(ptr=result.ctypes.data, dtype=wp.float64, shape=result.shape, strides=result.strides)
            inputs = [self._of(field), whole_numbers(offsets), target]
            self._gathering[field] = recorded(kernels.take, result.shape, inputs, "cpu")
        self._gathering[field]()

    def times(self) -> Float:
        """Return the MuJoCo time of each mjData [s], shape (w,). The next call overwrites this array."""
        self.gather("time", [0], self._times)
        return self._times[:, 0]

    def put(self, field: Field, offsets: Sequence[int], values: Float) -> None:
        """Write numbers at offsets into a field.

        Shape (n,) writes the same numbers to all mjData; shape (w, n) one row to each.
        """
        whole = np.asarray(offsets, np.int32)
        key = field, whole.tobytes()
        if key not in self._putting:
            source: Any = wp.zeros((len(self.views), len(whole)), dtype=wp.float64, device="cpu")
            inputs = [self._of(field), whole_numbers(whole), source]
            self._putting[key] = source.numpy(), recorded(kernels.put, source.shape, inputs, "cpu")
        host, call = self._putting[key]
        host[:] = values
        call()

    def push(self, bodies: Sequence[int], forces: Float, torques: Float) -> None:
        """Add forces [N] and torques about body origins [N m] to the passive forces; world axes, shape (w, n, 3)."""
        if self.views[0].model.raw.nv == 0:
            return
        whole = np.asarray(bodies, np.int32)
        key = whole.tobytes()
        if key not in self._pushing:
            count = len(self.views)
            buffer: Any = wp.zeros((count, len(whole), 6), dtype=wp.float64, device="cpu")
            fixed = _function("mj_applyFT"), wp.uint64(self._model)
            calls = []
            for own in self._blocks():
                arrays = [self._data[own], self._of("xpos")[own], self._of("qfrc_passive")[own]]
                inputs = [*fixed, *arrays, whole_numbers(whole), buffer[own].flatten()]
                calls.append(recorded(kernels.push_bodies, own.stop - own.start, inputs, "cpu"))
            self._pushing[key] = buffer.numpy(), calls
        host, shared = self._pushing[key]
        host[..., :3], host[..., 3:] = forces, torques
        self._share(shared)

    def _blocks(self) -> list[slice]:
        """Return the range of mjData for each thread."""
        count = len(self.views)
        size = -(-count // self._threads)
        return [slice(start, min(start + size, count)) for start in range(0, count, size)]

    def _share(self, calls: Sequence[Callable[[], object]]) -> None:
        if len(calls) == 1:
            calls[0]()
        else:
            share([(call,) for call in calls], self._threads)

    def _of(self, field: str) -> Any:
        """Return the addresses of a field in all mjData."""
        if field not in self._addresses:
            if field == "time":
                pointers = [ctypes.addressof(view.raw) + mirror("mjData").time.offset for view in self.views]
            else:
                pointers = [ctypes.cast(getattr(view.raw, field), ctypes.c_void_p).value or 0 for view in self.views]
            self._addresses[field] = wp.array(pointers, dtype=wp.uint64, device="cpu")
        return self._addresses[field]


def _function(name: str) -> Any:
    """Return the address of a MuJoCo function."""
    return wp.uint64(ctypes.cast(getattr(library(), name), ctypes.c_void_p).value or 0)
