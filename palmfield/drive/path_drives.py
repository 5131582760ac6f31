"""Emission of the transducers on a device, for one stimulus with a moving focus.

The computation is a list of kernel launches for a CUDA graph. Its input is a few numbers for each moment; its output,
the drives, is the input of the sound field. `palmfield.drive.transducer_response` computes the same with NumPy.
"""

from typing import Any, NamedTuple

import numpy as np
import warp as wp
from numpy.typing import NDArray

from palmfield.acoustics.directivities import form_of
from palmfield.acoustics.directivity import EXACT
from palmfield.acoustics.point_sound import Transducers
from palmfield.device import SharedArray, filled, launch, whole_numbers
from palmfield.drive.array_drive import ArrayDrive
from palmfield.drive.transducer_response import PoleStepper
from palmfield.stimulus.schedule import Moments
from palmfield.threads import Calls
from palmfield.types import Complex, Float, Int
from warp_kernels import path_drives as kernels


class PathMemory(NamedTuple):
    """Input and output arrays of the kernels for a step of w worlds on a device.

    counts: numbers of foci and groups, int32, shape (w, 2); group: group of each transducer, int32, shape (w, n)
    foci: [m], vec3d, shape (w, f); targets: target levels, float64, shape (w, f + 1)
    aims: targets at the focus, vec2d, shape (w,), see `PathDrives.aim`
    ring: weights of the pole for each moment, vec2d, shape (m, 5); pushes: row of `force` for each moment, -1 for none,
        int32, shape (m,); begun, end: emission, vec2d, shape (w, n)
    totals: pressure at the foci at full drive and number of transducers that face them, vec3d, shape (w, f)
    load, force, now: tables of drives, vec2, see `palmfield.acoustics.point_sound.DriveTable`
    """

    counts: Any
    group: Any
    foci: Any
    targets: Any
    aims: Any
    ring: Any
    pushes: Any
    begun: Any
    end: Any
    totals: Any
    load: Any
    force: Any
    now: Any

    @staticmethod
    def inputs(moments: int, foci: int, transducers: int, worlds: int = 1) -> dict[str, tuple[tuple[int, ...], Any]]:
        """Return the shapes and types of the input, for a `SharedBlock`; moments, foci: their largest numbers."""
        return {
            "path_counts": ((worlds, 2), wp.int32),
            "path_group": ((worlds, transducers), wp.int32),
            "path_foci": ((worlds, foci), wp.vec3d),
            "path_targets": ((worlds, foci + 1), wp.float64),
            "path_aims": ((worlds,), wp.vec2d),
            "path_ring": ((moments, 5), wp.vec2d),
            "path_pushes": ((moments,), wp.int32),
            "path_begun": ((worlds, transducers), wp.vec2d),
        }

    @staticmethod
    def results(foci: int, transducers: int, worlds: int = 1) -> dict[str, tuple[tuple[int, ...], Any]]:
        """Return the shapes and types of the output."""
        return {"path_end": ((worlds, transducers), wp.vec2d), "path_totals": ((worlds, foci), wp.vec3d)}


class PathDrives:
    """Transducers on a device, all driven by one stimulus.

    drive: drive with the present places of the arrays; transducers: transducers of the sound field
    pole: response of all transducers, None without ring-up; rings: whether there is ring-up
    aim: result of `aim_of`
    """

    def __init__(self, drive: ArrayDrive, transducers: Transducers, pole: PoleStepper | None):
        device = self._device = transducers.device
        self.count, self._pole, self.rings = drive.count, pole, pole is not None
        self._places, self._facing = (SharedArray(drive.count, wp.vec3d, device) for _ in range(2))
        parts = drive.array.parts
        gains = [part.p0_Pa_m * (np.ones(len(part)) if part.gain is None else part.gain) for part in parts]
        shapes = [form_of(part).polynomial(drive.wavenumber * part.piston_radius_m, EXACT) for part in parts]
        owners = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
        self.aim = aim_of(drive)
        self._focusing = filled(
            kernels.Focusing(),
            places=self._places.array,
            facing=self._facing.array,
            gains=_pairs(np.concatenate(gains), device),
            parts=whole_numbers(owners, device),
            shapes=wp.array(shapes, dtype=wp.float64, device=device),
            wavenumber=drive.wavenumber,
            absorption_Np_m=drive.absorption_Np_m,
        )
        order = np.argsort(transducers.order)
        self._order = whole_numbers(order, device)
        self._scales = _pairs(transducers.scale[order], device)
        self._stored: dict[tuple[object, ...], Complex] = {}
        self.move(drive)

    def move(self, drive: ArrayDrive) -> None:
        """Set new places of the same transducers."""
        self._places.put(drive.places.T)
        self._facing.put(drive.normals.T)

    def calls(self, memory: PathMemory) -> Calls:
        """Return kernel launches that compute the emission: tables load, force and now of `memory`, end, and totals."""
        (worlds, foci), device = memory.foci.shape, self._device
        whole, parts = (worlds, foci, self.count), (worlds, foci, kernels.LANES)
        waves, strengths = (wp.zeros(whole, dtype=wp.vec2d, device=device) for _ in range(2))
        levels: Any = wp.zeros((worlds, foci + 1), dtype=wp.float64, device=device)
        focusing, counts = self._focusing, memory.counts
        sums: Any = wp.zeros(parts, dtype=wp.vec3d, device=device)
        inputs = [
            counts,
            memory.group,
            int(self.rings),
            waves,
            levels,
            memory.ring,
            memory.pushes,
            self._scales,
            self._order,
            memory.begun,
        ]
        inputs += [memory.load, memory.force, memory.now, memory.end]
        levelling = [counts, memory.aims, sums, memory.targets, levels, memory.totals]
        return [
            launch(kernels.focus_waves, whole, [focusing, counts, memory.foci, waves, strengths], device),
            launch(kernels.focus_sums, parts, [counts, waves, strengths, sums], device),
            launch(kernels.focus_levels, levels.shape, levelling, device),
            launch(kernels.ring_along, (worlds, self.count), inputs, device),
        ]

    def pushed(self, weights: Float) -> Float:
        """Return the weights of the rows of `PathMemory.force` in the mean ARP; weights: of the moments, shape (m,)."""
        return weights[weights > 0.0] if self.rings else np.ones(1)

    def ring(self, moments: Moments) -> Complex:
        """Return the weights of the pole for each moment, shape (m, 5), see `warp_kernels.path_drives.ring_along`."""
        pole = self._pole
        if pole is None:
            return np.zeros((1, 5), np.complex128)
        key = moments.linear, moments.held_s, moments.step_s
        stored = self._stored.get(key)
        if stored is None:
            rows = []
            for linear, held_s in zip(moments.linear, moments.held_s, strict=True):
                along = pole.weights(moments.step_s) if linear else (1.0, 0.0, 0.0)
                decay, first, last = pole.weights(0.5 * held_s) if held_s > 0.0 else (1.0, 0.0, 0.0)
                rows.append([*along, decay, first + last])
            if len(self._stored) >= KEPT:
                self._stored.clear()
            stored = self._stored[key] = np.array(rows, np.complex128)
        return stored


def foci_made(totals: Float, levels: Float, quiet: Any, target: Any) -> NDArray[np.bool_]:
    """Return for each world whether the transducers can produce all active foci, shape (w,).

    totals: as in PathMemory, as numbers, shape (w, f, 3); the last focus is that at the beginning of the step
    levels: levels of the pressure at the other foci, (w, f - 1); quiet: whether the last focus is silent, (w,)
    target: first result of `aim_of`, (w,)"""
    real, imaginary, facing = totals.transpose(2, 0, 1)
    good = (facing > 0.0) & (real * real + imaginary * imaginary >= np.asarray(target)[:, None])
    good[:, :-1] |= levels == 0.0
    good[:, -1] |= quiet
    return np.asarray(np.logical_and.reduce(good, axis=1))


def push_rows(weights: Float) -> Int:
    """Return the row of each moment among the moments with weights that are not 0, shape (m,); -1 for other moments."""
    counted = weights > 0.0
    return np.where(counted, np.add.accumulate(counted, dtype=np.int32) - 1, -1).astype(np.int32)


def aim_of(drive: ArrayDrive) -> tuple[float, float]:
    """Return target ARP at the focus times rho c^2 [Pa^2] (0 if the amplitude is given), and the drive amplitude."""
    return 0.0 if drive.arp_peak_Pa is None else drive.arp_peak_Pa * drive.array.impedance, drive.amplitude


KEPT = 64
"""Number of cached weights, for different sequences of the moments of a step."""


def _pairs(values: Any, device: str) -> Any:
    """Return complex numbers as a vec2d array."""
    pairs = np.ascontiguousarray(values, np.complex128).view(np.float64).reshape(-1, 2)
    return wp.array(pairs, dtype=wp.vec2d, device=device)
