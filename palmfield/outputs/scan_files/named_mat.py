"""Read scans from MATLAB files of other laboratories by names of variables and order of axes.

Each variable is read only when it is needed. So the settings and places can be read without the velocity. SciPy reads
files up to version 7, h5py version 7.3, which is HDF5.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import ClassVar, Literal

import h5py
import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.io import loadmat, whosmat

from palmfield.errors import MeasurementError
from palmfield.files import regular
from palmfield.instruments.scan import UNITS, Scan
from palmfield.instruments.settings import Settings
from palmfield.types import Float, Int

AXES = (("place", "time"), ("place", "time", "repetition"), ("x", "y", "time"), ("x", "y", "time", "repetition"))
"""Axes of the velocity, in any order."""
BASELINE = 0.01
"""Fraction of a reference record, at its beginning, that precedes the stimulus."""


class MatVariables(Settings):
    """Names of the variables in a MATLAB file, their units, and values that the file does not contain."""

    instrument: ClassVar[str] = "variables"
    velocity: str = Field(default="y", description="variable of the velocity")
    axes: str = Field(default="place time repetition", description="its axes: place, or x and y; time; repetition")
    places: str = Field(default="", description="positions, n by 2 or n by 3; FILE.mat:NAME if in another file")
    x: str = Field(default="", description="positions along x if there is no variable of places")
    y: str = Field(default="", description="positions along y if there is no variable of places")
    reference: str = Field(default="", description="reference signal, with the axes of the velocity or fewer")
    rate: str = Field(default="", description="variable of the sampling rate [Hz], or of the times [s]")
    rate_Hz: float | None = Field(default=None, gt=0.0, description="sampling rate if no variable has it")
    onset_s: float | None = Field(default=None, description="start of the stimulus in the record, instead of reference")
    places_unit: Literal["m", "mm", "um"] = Field(default="m", description="unit of the positions")
    velocity_unit: Literal["m/s", "mm/s", "um/s"] = Field(default="m/s", description="unit of the velocity")


def listed(file: Path) -> dict[str, tuple[tuple[int, ...], str]]:
    """Return the shape and type of each variable by name, read from the headers only."""
    try:
        return {name: (tuple(shape), kind) for name, shape, kind in whosmat(regular(file))}
    except NotImplementedError:
        with h5py.File(file) as opened:
            # MATLAB stores columns first, so its arrays are transposed in HDF5
            arrays = {name: item for name, item in opened.items() if isinstance(item, h5py.Dataset)}
            return {name: (item.shape[::-1], item.dtype.name) for name, item in arrays.items()}
    except Exception as error:
        # SciPy raises various errors for damaged files, from ValueError to errors of zlib
        raise MeasurementError(f"{file}: cannot be read: {error}; give a MATLAB file") from None


def read_variable(file: Path, name: str) -> NDArray:
    """Return one numeric variable of a file; no other variable is read."""
    try:
        try:
            values = loadmat(regular(file), variable_names=[name])[name]
        except NotImplementedError:
            with h5py.File(file) as opened:
                values = np.asarray(opened[name]).T
    except Exception as error:
        raise MeasurementError(f"{file}: variable '{name}' cannot be read: {error}; copy the file again") from None
    if values.dtype.kind not in "fiu" or values.size == 0:
        raise MeasurementError(f"{file}: variable {name} has values that are not real numbers; {_found(listed(file))}")
    return np.asarray(values)


@dataclass(frozen=True)
class NamedMat:
    """A scan in a MATLAB file; each property reads only its own variables, and only once.

    Raises MeasurementError for missing variables, wrong shapes, and positions that are not finite. The error lists the
    variables of the file.
    """

    file: Path
    variables: MatVariables

    @cached_property
    def places_m(self) -> Float:
        """Positions [m], shape (n, 3); z is 0 if the file has no z."""
        named = self.variables
        if named.places:
            own, _, other = named.places.rpartition(":")
            table = self._read("places", other, self.file.parent / own if own else self.file)
            table = table.T if table.ndim == 2 and table.shape[1] not in (2, 3) else table
            if table.ndim != 2 or table.shape[1] not in (2, 3):
                raise MeasurementError(f"{self.file}: places have shape {table.shape}; give n by 2 or 3")
        else:
            x, y = (self._read(key, getattr(named, key)).ravel() for key in ("x", "y"))
            if "x" in self._axes:
                x, y = (part.ravel() for part in np.meshgrid(x, y, indexing="ij"))
            if len(x) != len(y):
                raise MeasurementError(f"{self.file}: {len(x)} positions along x and {len(y)} along y; give pairs")
            table = np.column_stack([x, y])
        bad = np.flatnonzero(~np.isfinite(table).all(axis=1))
        if len(bad):
            raise MeasurementError(
                f"{self.file}: place {bad[0]} (of {len(bad)} such) is ({', '.join(f'{v:g}' for v in table[bad[0]])}); "
                "give finite positions, or remove the place from all variables"
            )
        scaled = UNITS["displacement"][named.places_unit] * np.asarray(table, dtype=float)
        return np.pad(scaled, ((0, 0), (0, 3 - scaled.shape[1])))

    @cached_property
    def rate_Hz(self) -> float:
        """Sampling rate [Hz]."""
        if not self.variables.rate:
            if self.variables.rate_Hz is None:
                raise MeasurementError(f"{self.file}: no sampling rate; set rate or rate_Hz; {_found(self.listing)}")
            return self.variables.rate_Hz
        values = self._read("rate", self.variables.rate).astype(float).ravel()
        rate = float(values[0]) if len(values) == 1 else (len(values) - 1) / float(values[-1] - values[0])
        if not (math.isfinite(rate) and rate > 0.0):
            raise MeasurementError(f"{self.file}: rate gives {rate:g} Hz; give a rate or rising times")
        return rate

    @cached_property
    def listing(self) -> dict[str, tuple[tuple[int, ...], str]]:
        return listed(self.file)

    def check_shape(self) -> None:
        """Compare the shape of the velocity, from its header, with places and axes.

        Also check that the other variables exist.
        """
        for key in ("rate", "reference"):
            if name := getattr(self.variables, key):
                self._header(key, name)
        shape, _ = self._header("velocity", self.variables.velocity)
        sizes = dict(zip(self._axes, (*shape, *[1] * (len(self._axes) - len(shape))), strict=False))
        count = math.prod(sizes[name] for name in ("place", "x", "y") if name in sizes)
        if len(shape) > len(self._axes) or count != len(self.places_m):
            raise MeasurementError(
                f"{self.file}: velocity '{self.variables.velocity}' is {_by(shape)} with axes {' '.join(self._axes)}, "
                f"and there are {len(self.places_m)} places: correct axes or places; {_found(self.listing)}"
            )

    def records(self) -> tuple[Float, Float]:
        """Read velocity and reference.

        Return times from the start of the stimulus [s], and velocities [m/s], shape (r, t, n).

        Each record is shifted in time by the start of its reference signal. Without a reference, onset_s is the start
        of all.
        """
        self.check_shape()
        named = self.variables
        unit = UNITS["velocity"][named.velocity_unit]
        values = unit * self._ordered(self._read("velocity", named.velocity)).astype(float)
        bad = np.argwhere(~np.isfinite(values))
        if len(bad):
            raise MeasurementError(
                f"{self.file}: velocity of place {bad[0][2]} is not finite; remove it from all variables"
            )
        starts = self._starts(values.shape)
        before, after = int(starts.min()), values.shape[1] - int(starts.max())
        span = np.arange(-before, after)
        rows = starts[:, None, :] + span[None, :, None]
        return span / self.rate_Hz, np.take_along_axis(values, rows, axis=1)

    def scan(self) -> Scan:
        """Return the mean of the repetitions as a scan."""
        times_s, values = self.records()
        return Scan("velocity", times_s, self.places_m, values.mean(axis=0), name=self.file.name)

    @property
    def _axes(self) -> tuple[str, ...]:
        axes = tuple(self.variables.axes.split())
        if sorted(axes) not in [sorted(one) for one in AXES]:
            allowed = "; ".join(" ".join(one) for one in AXES)
            raise MeasurementError(f"{self.file}: axes is '{self.variables.axes}'; allowed, in any order: {allowed}")
        return axes

    def _ordered(self, values: NDArray) -> NDArray:
        """Return values with the axes of the velocity as (repetition, time, place)."""
        values = values.reshape(*values.shape, *[1] * (len(self._axes) - values.ndim))
        order = [self._axes.index(name) for name in ("repetition", "time", "place", "x", "y") if name in self._axes]
        values = values.transpose(order)
        values = values if "repetition" in self._axes else values[None]
        return values.reshape(*values.shape[:2], -1)

    def _starts(self, shape: tuple[int, ...]) -> Int:
        """Return the sample at which the stimulus starts, shape (r, n)."""
        if self.variables.onset_s is not None or not self.variables.reference:
            first = round((self.variables.onset_s or 0.0) * self.rate_Hz)
            if not 0 <= first < shape[1]:
                raise MeasurementError(f"{self.file}: onset_s is {self.variables.onset_s:g}; the record has "
                                       f"{shape[1] / self.rate_Hz:g} s")  # fmt: skip
            return np.full((shape[0], shape[2]), first, dtype=np.int32)
        signal = self._read("reference", self.variables.reference).astype(float)
        signal = signal.reshape(1, -1, 1) if signal.size == shape[1] else self._ordered(signal)
        if signal.shape[1] != shape[1] or signal.shape[2] not in (1, shape[2]) or signal.shape[0] not in (1, shape[0]):
            raise MeasurementError(f"{self.file}: reference '{self.variables.reference}' does not have the axes of the "
                                   f"velocity, or only its times; {_found(self.listing)}")  # fmt: skip
        quiet = max(8, round(BASELINE * shape[1]))
        size = np.abs(signal - signal[:, :quiet].mean(axis=1, keepdims=True))
        above = size >= 0.5 * size.max(axis=1, keepdims=True)
        first = above.argmax(axis=1)
        if first.min() < quiet:
            worst = np.argwhere(first < quiet)[0]
            raise MeasurementError(f"{self.file}: the reference of place {worst[1]} has no quiet beginning of {quiet} "
                                   "samples: give onset_s")  # fmt: skip
        return np.broadcast_to(first, (shape[0], shape[2])).astype(np.int32)

    def _header(self, key: str, name: str, listing: dict | None = None) -> tuple[tuple[int, ...], str]:
        listing = self.listing if listing is None else listing
        if name not in listing:
            given = f"variable '{name}' is missing" if name else "has no name"
            raise MeasurementError(f"{self.file}: {key}: {given}; set {key} in [variables]; {_found(listing)}")
        return listing[name]

    def _read(self, key: str, name: str, file: Path | None = None) -> NDArray:
        file = file or self.file
        listing = self.listing if file == self.file else listed(file)
        if self._header(key, name, listing)[1] in ("struct", "cell", "object"):
            # Reading a field would read the others too, and possibly the velocity
            raise MeasurementError(
                f"{file}: '{name}' is a {listing[name][1]}; save its fields as variables (save -struct)"
            )
        return read_variable(file, name)


def _by(shape: tuple[int, ...]) -> str:
    return " by ".join(map(str, shape))


def _found(listing: dict[str, tuple[tuple[int, ...], str]]) -> str:
    return "found: " + (
        ", ".join(f"{name} ({_by(shape)} {kind})" for name, (shape, kind) in listing.items()) or "no variables"
    )
