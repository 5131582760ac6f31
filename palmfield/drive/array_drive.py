"""Drive of an array for a focus: phases that focus the sound, and the level."""

import math
from collections.abc import Sequence
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from palmfield.acoustics.air import absorption_Np_m, sound_speed
from palmfield.acoustics.focus import focus
from palmfield.acoustics.phased_array import PhasedArray, only
from palmfield.acoustics.reference import directivity
from palmfield.drive.board import Board, play
from palmfield.errors import DeviceError, SceneError, naming
from palmfield.locked import next_serial
from palmfield.stimulus.focal_points import FocalPoints
from palmfield.threads import python_threads, share
from palmfield.types import Array, Complex, Float, Int

Bool = NDArray[np.bool_]

FOCI = 64
"""Number of foci whose drives one thread computes together."""
KEPT = 32
"""Number of cached unit drives; they are reused for paths that rest at few points."""


class UnitDrive:
    """Commanded drive of the transducers for a focus at the loudest moment.

    amplitudes: complex, relative to full drive, shape (N,); level: target amplitude of each transducer, 0..1
    conjugate: conjugate of the amplitudes; power: sum of |amplitude|^2; peak: largest |amplitude|
    serial: its unique number
    """

    def __init__(self, amplitudes: Complex, level: float):
        self.amplitudes, self.level, self.serial = amplitudes, level, next_serial()
        amplitudes.flags.writeable = False  # cached data of a unit drive are valid as long as it is the same object
        self.conjugate: Complex = amplitudes.conj()
        self.power = float((self.conjugate @ amplitudes).real)
        self.peak = float(np.maximum.reduce(np.abs(amplitudes)))


class ArrayDrive:
    """Drives the transducers of one stimulus, with the arrays in one relative pose.

    array: the arrays of the scene as one source; board: board that plays the drive
    chosen: numbers of the transducers that this stimulus drives, ascending, shape (k,)
    arp_peak_Pa: ARP at the focus at the loudest moment, if the stimulus sets it
    drive_amplitude: drive amplitude of each transducer, if the stimulus sets it (1 if it sets neither)
    about, about_focus: first words of error messages on the drive, and on its foci
    Amplitudes are those of all N transducers, 0 for transducers that are not chosen."""

    def __init__(
        self,
        array: PhasedArray,
        chosen: Int,
        arp_peak_Pa: float | None,
        drive_amplitude: float | None,
        board: Board,
        about: tuple[str, ...] = (),
        about_focus: tuple[str, ...] = (),
    ):
        self.about, self.about_focus = about, about_focus or about
        self.compensate = board.compensate and board.takes == "amplitudes"
        self.rounds_levels = board.line is not None and board.amplitude == "pulse_width"
        self.array, self.chosen, self.board, self.arp_peak_Pa = array, chosen, board, arp_peak_Pa
        whole = array.array
        self.count = len(whole)
        self.everything = len(chosen) == self.count
        self.amplitude = 1.0 if drive_amplitude is None else drive_amplitude
        self.sound_speed = sound_speed(array.air)
        self.wavenumber = 2.0 * math.pi * whole.frequency_Hz / self.sound_speed
        self.places: Float = np.ascontiguousarray(whole.positions[chosen].T)
        self.normals: Float = np.ascontiguousarray(whole.normals[chosen].T)
        self._stored: dict[bytes, UnitDrive] = {}
        self._unchecked = True
        self._last: tuple[FocalPoints, bytes, UnitDrive] | None = None
        # Cache for fixed points, of palmfield.drive.transducer_response
        self.delays: tuple[FocalPoints, tuple[Float, Int | None]] | None = None

    def unit_drive(self, point: Float, loudness: Float | None = None) -> UnitDrive:
        """Return the drive for a focus at `point` (frame of the first array [m], shape (3,)) at the loudest moment.

        Several points, shape (m, 3), become simultaneous foci (`palmfield.drive.foci`): equally loud, or with relative
        pressures `loudness`, 0 to 1, shape (m,). A transducer behind which a point lies is silent. The last KEPT drives
        are cached.
        Raises SceneError for a focus that no transducer can make or a level that they cannot reach, DeviceError for a
        drive that the board cannot play.
        """
        key = point.tobytes() if loudness is None else point.tobytes() + loudness.tobytes()
        unit = self._stored.get(key)
        if unit is None:
            unit = self._made(point, loudness)
            if len(self._stored) >= KEPT:
                del self._stored[next(iter(self._stored))]
            self._stored[key] = unit
        return unit

    def unit_drive_at(self, focal_points: FocalPoints, point: Float) -> UnitDrive:
        """Return `unit_drive` for one point of the stimulus, shape (3,), at its present place."""
        last, key = self._last, point.tobytes()
        if last is None or last[0] is not focal_points or last[1] != key:
            uneven = focal_points.table is not None or focal_points.arp
            loudness = focal_points.loudness(point) if uneven else None
            self._last = last = focal_points, key, self.unit_drive(focal_points.at(point), loudness)
        return last[2]

    def level_at(self, focal_points: FocalPoints, point: Float) -> float:
        """Return `unit_drive_at(...).level` for a board whose frames contain a focus, before the board rounds it."""
        loudness = focal_points.loudness(point)
        place = focal_points.at(point)
        if loudness is not None or place.ndim > 1:
            return self._target(place, loudness)[2]
        # The board computes the phases
        if not np.logical_or.reduce(self._rays(*place)[1] > 0.0):
            self._refuse(place)
        return self.amplitude if self.arp_peak_Pa is None else float(self._levels(place[None])[0])

    def _target(self, point: Float, loudness: Float | None) -> tuple[Float, Complex, float]:
        """Return the active focus or foci, the matched amplitudes of the transducers for them, and the level."""
        if loudness is not None:
            # Silent foci are omitted; a single remaining focus is computed as one focus
            point, loudness = point[loudness > 0.0], loudness[loudness > 0.0]
            point = point if len(point) > 1 else point[0]
        if point.ndim == 1:
            distances, heights = self._rays(*point)
            facing = heights > 0.0
            if not np.logical_or.reduce(facing):
                self._refuse(point)
            phases = self._waves(distances) * facing
        elif self.board.takes == "focus":
            raise DeviceError(
                f"the stimulus has {len(point)} foci at once, but board '{self.board.name}' plays one: set another "
                "board",
                *self.about,
            )
        else:
            phases = self._several(point, loudness)
        level = self.amplitude
        if self.arp_peak_Pa is not None:
            level = self._level_of_several(point, phases) if point.ndim == 2 else float(self._levels(point[None])[0])
        return point, phases, level

    def _made(self, point: Float, loudness: Float | None) -> UnitDrive:
        point, phases, level = self._target(point, loudness)
        if self.board.takes == "focus":
            played = self.board.decode(self.board.encode_focus(point, level))[-1]
        else:
            sent = level * phases if self.correction is None else level * phases * self.correction
            played = play(self.board, self._over_all(sent))
        if level > 0.0 and not np.logical_or.reduce(played):
            raise DeviceError(
                f"the amplitude at the loudest moment is {level:.3g}, which board '{self.board.name}' rounds to 0 "
                "(silence): set a larger drive_amplitude (or arp_peak_Pa), or another board",
                *self.about,
            )
        return UnitDrive(played, level)

    @cached_property
    def correction(self) -> Complex | None:
        """Return the gain correction of the chosen transducers, shape (n,): 0 for dead ones. None if not needed."""
        gain = self.array.array.gain
        if not self.compensate or gain is None:
            return None
        own = gain[self.chosen]
        return np.where(own == 0.0, 0.0, np.exp(-1j * np.angle(own)))

    def unit_drives(
        self, points: Float, focal_points: FocalPoints, group: Int | None = None, audible: Bool | None = None
    ) -> Complex:
        """Return amplitudes of `unit_drive` for many points of the stimulus, shape (k, N).

        points: for each row one point of the stimulus, shape (k, 3), or several, shape (k, d, 3), from which
            `group`, shape (N,), selects one for each transducer
        focal_points: places of these points
        audible: whether each point will sound, shape (k, d): only these must be within the range of the array
        Raises the errors of unit_drive.
        """
        points = points.reshape(len(points), -1, 3)
        if len(focal_points.offsets) or self.board.line is not None or self.correction is not None:
            return self._one_by_one(points, focal_points, group, audible)
        if len(points) > FOCI:  # in parts, shared by threads
            parts = [slice(first, first + FOCI) for first in range(0, len(points), FOCI)]
            drives = np.empty((len(points), self.count), np.complex128)

            def some(own: slice) -> None:
                loud = None if audible is None else audible[own]
                drives[own] = self.unit_drives(points[own], focal_points, group, loud)

            share([(partial(some, own),) for own in parts], python_threads())
            return drives
        foci = focal_points.along(points.reshape(-1, 3)).reshape(points.shape)
        mine = group if group is None or self.everything else group[self.chosen]
        x, y, z = (foci if mine is None else foci[:, mine]).transpose(2, 0, 1)
        distances, heights = self._rays(x, y, z)
        facing = heights > 0.0
        sounds = np.logical_or.reduce(facing, axis=1)
        if not np.logical_and.reduce(sounds):
            needed = ~sounds if audible is None else ~sounds & np.logical_or.reduce(audible, axis=1)
            if np.logical_or.reduce(needed):
                row = int(needed.argmax())
                self._refuse(foci[row, 0 if audible is None else int(audible[row].argmax())])
        drives = self._waves(distances)
        if self.arp_peak_Pa is None:
            drives *= facing if self.amplitude == 1.0 else self.amplitude * facing
        else:
            levels = self._levels_at(foci, audible)
            drives *= facing * (levels if mine is None else levels[:, mine])
        return self._over_all(drives)

    def played_levels(self, levels: Float, full: float) -> Float:
        """Return levels of a drive as the board plays them, same shape; full: amplitude of the drive at level 1, 0..1.

        Use it only for a board that rounds levels in each frame. For several foci, whose transducers have different
        amplitudes, levels are unchanged.
        """
        if full == 0.0:
            return levels
        return self.board.rounded(levels * full) / self.board.rounded(np.array(full))

    def focusing(self, foci: Float, some: Int) -> Complex:
        """Return drives exp(-i k d) of some of the chosen transducers for each of several foci [m], (k, 3): (k, n)."""
        offsets = foci[:, None, :] - self.places.T[some]
        return np.asarray(np.exp(-1j * self.wavenumber * np.sqrt(np.einsum("ijk,ijk->ij", offsets, offsets))))

    def flight_times(self, focus: Float) -> Float:
        """Return the flight time from each chosen transducer to a point [s], shape (n,)."""
        return np.asarray(self._rays(*focus)[0] / self.sound_speed)

    # -- one focus ---------------------------------------------------------------------------------------------------

    def _rays(self, x: Float, y: Float, z: Float) -> tuple[Float, Float]:
        """Return the distance [m] from each transducer to a point, and the height of the point over its face [m].

        x, y, z: coordinates of the points [m], numbers, or shapes that broadcast to (k, n) with the transducers
        """
        dx, dy, dz = x - self.places[0], y - self.places[1], z - self.places[2]
        distances = dx * dx
        distances += dy * dy
        distances += dz * dz
        dx *= self.normals[0]
        dy *= self.normals[1]
        dz *= self.normals[2]
        dx += dy
        dx += dz
        return np.sqrt(distances, out=distances), dx

    def _waves(self, distances: Float) -> Complex:
        """Return exp(-i k d) for distances d [m], same shape."""
        turns: Float = -self.wavenumber * distances
        waves = np.empty(turns.shape, np.complex128)
        np.cos(turns, out=waves.real)
        np.sin(turns, out=waves.imag)
        return waves

    def _over_all(self, drives: Complex) -> Complex:
        """Return drives of all transducers for drives of the chosen ones, shape (n,) or (k, n)."""
        if self.everything:
            return drives
        full = np.zeros((*drives.shape[:-1], self.count), np.complex128)
        full[..., self.chosen] = drives
        return full

    def _refuse(self, point: Float) -> None:
        """Raise SceneError for a focus that no transducer faces."""
        with naming(*self.about_focus):
            focus(only(self.array.array, self.chosen), self.array.air, point)

    # -- its level ---------------------------------------------------------------------------------------------------

    def _levels_at(self, foci: Float, audible: Bool | None) -> Float:
        """Return `_levels` for foci of shape (k, d, 3), shape (k, d); the level of silent foci is 0."""
        if audible is None:
            return self._levels(foci.reshape(-1, 3)).reshape(foci.shape[:2])
        levels = np.zeros(foci.shape[:2])
        levels[audible] = self._levels(foci[audible])
        return levels

    def _levels(self, foci: Float) -> Float:
        """Return the level at which single foci [m], shape (q, 3), have the target ARP, shape (q,).

        At its focus the sound of all transducers that face it is in phase, except for their gains.
        """
        distances, heights = self._rays(*foci.T[:, :, None])
        cosines = heights / np.maximum(distances, 1e-9)
        strength = np.exp(-self.absorption_Np_m * distances) * (cosines > 0.0) / np.maximum(distances, 1e-9)
        pressure = np.zeros(len(foci), np.complex128)
        for part, own, gain in self._parts:
            shape = directivity(part, self.wavenumber, cosines[:, own])
            pressure += part.p0_Pa_m * ((strength[:, own] * shape) @ gain)
        return self._reached(np.abs(pressure) ** 2 / self.array.impedance, foci)

    @cached_property
    def absorption_Np_m(self) -> float:
        """Amplitude absorption of the sound in air [Np/m]."""
        return absorption_Np_m(self.array.air, self.array.array.frequency_Hz)

    @cached_property
    def _parts(self) -> list[tuple[Array, slice, Float | Complex]]:
        """Return for each array its chosen transducers, their indices among all chosen transducers, and their gains."""
        result = []
        start = 0
        for part in self.array.parts:
            low, high = np.searchsorted(self.chosen, [start, start + len(part)]).tolist()
            if low < high:
                gain = np.ones(len(part)) if part.gain is None else part.gain
                gain = np.abs(gain) if self.compensate else gain
                result.append((part, slice(low, high), gain[self.chosen[low:high] - start]))
            start += len(part)
        return result

    def _reached(self, full_Pa: Float, foci: Float) -> Float:
        """Return levels for the target ARP, from the ARP at full drive [Pa], (q,); foci: (q, 3) or (q, m, 3)."""
        target = self.arp_peak_Pa
        assert target is not None
        if not np.logical_and.reduce(full_Pa >= target):
            worst = int(full_Pa.argmin())
            if full_Pa[worst] == 0.0:
                raise SceneError(
                    f"arp_peak_Pa {target:g} cannot be reached at {in_mm(foci[worst])}, because all transducers "
                    "that reach this point are dead: list fewer dead transducers",
                    *self.about,
                )
            raise SceneError(
                f"arp_peak_Pa {target:g} exceeds the output of the array at {in_mm(foci[worst])}: "
                f"{shown_below(full_Pa[worst], target)} Pa at full drive with p0_Pa_m {self.array.array.p0_Pa_m:g}; "
                "set a lower value, or move the focus",
                *self.about,
            )
        return np.sqrt(target / full_Pa)

    # -- several foci, and boards ------------------------------------------------------------------------------------

    def _several(self, foci: Float, loudness: Float | None) -> Complex:
        """Return drives of the chosen transducers, (n,), for several foci [m], shape (m, 3); loudness: shape (m,)."""
        from palmfield.drive.foci import together  # imported here, because most stimuli have one focus

        transfer, facing = self._towards(foci)
        if self._unchecked or np.add.reduce(facing) <= len(foci):
            self._check_several(foci, facing)
            self._unchecked = False
        phases = np.zeros(len(self.chosen), np.complex128)
        phases[facing] = together(transfer, loudness)
        return phases

    def leading_of(self, foci: Float, loudness: Float) -> Complex:
        """Return the start phases of simultaneous foci [m], shape (m, 3) (`leading_vector`); loudness: shape (m,)."""
        from palmfield.drive.foci import leading_vector

        return leading_vector(self._towards(foci)[0], loudness)

    def _towards(self, foci: Float) -> tuple[Complex, Bool]:
        """Return the transfer matrix (m, f) from the transducers that face all foci, and which these are, (n,)."""
        distances, heights = self._rays(*foci.T[:, :, None])
        facing = np.logical_and.reduce(heights > 0.0, axis=0)
        return self._transfer(distances, heights)[:, facing], facing

    def _check_several(self, foci: Float, facing: Bool) -> None:
        """Raise SceneError for foci that no transducer faces together, for too many foci, and for equal foci."""
        from palmfield.drive.foci import solve_foci

        array = only(self.array.array, self.chosen)
        with naming(*self.about_focus):
            solve_foci(foci, only(array, facing) if np.any(facing) else array, self.array.air, iterations=0)

    def _transfer(self, distances: Float, heights: Float) -> Complex:
        """Return the pressure at points [Pa] of each chosen transducer alone at full drive; all of shape (m, n)."""
        far = np.maximum(distances, 1e-9)
        cosines = heights / far
        waves = self._waves(distances).conj()
        waves *= np.exp(-self.absorption_Np_m * distances) / far
        for part, own, gain in self._parts:
            strength = directivity(part, self.wavenumber, cosines[:, own]) * (part.p0_Pa_m * gain)
            waves[:, own] = waves[:, own] * strength
        return waves

    def _level_of_several(self, foci: Float, phases: Complex) -> float:
        sent = phases if self.correction is None else phases * self.correction
        pressure = self.array.pressure64(foci, self._over_all(sent))
        full = float((np.abs(pressure) ** 2).max()) / self.array.impedance
        return float(self._reached(np.array([full]), foci[None])[0])

    def _one_by_one(self, points: Float, focal_points: FocalPoints, group: Int | None, audible: Bool | None) -> Complex:
        """Return `unit_drives`, computed point by point; equal points are computed once."""
        rows, columns = points.shape[:2]
        drives = np.zeros((rows, self.count), np.complex128)
        columns_of = [slice(None)] if group is None else [(group == j).nonzero()[0] for j in range(columns)]
        stored: dict[bytes, Complex] = {}
        uneven = focal_points.table is not None or focal_points.arp
        for i in range(rows):
            for j, emitting in enumerate(columns_of):
                if audible is not None and not audible[i, j]:
                    continue
                key = points[i, j].tobytes()
                unit = stored.get(key)
                if unit is None:
                    loudness = focal_points.loudness(points[i, j]) if uneven else None
                    unit = stored[key] = self.unit_drive(focal_points.at(points[i, j]), loudness).amplitudes
                drives[i, emitting] = unit[emitting]
        return drives


def in_mm(point: Sequence[float] | Float) -> str:
    """Return one position or several as text, e.g. (0.0, 12.5, 200.0) mm."""
    if np.ndim(point) == 2:
        return " and ".join(in_mm(one) for one in np.asarray(point))
    return "(" + ", ".join(f"{1e3 * float(x):.1f}" for x in point) + ") mm"


def shown_below(value: float, limit: float) -> str:
    """Return a number below a limit with three digits, or as many as distinguish the two, as text."""
    texts = (f"{value:.{digits}g}" for digits in range(3, 18))
    return next((text for text in texts if float(text) < limit), f"{value!r}")
