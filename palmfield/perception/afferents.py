"""Spikes of single afferents of the skin (SA1, RA1, PC) from the motion of the tissue at their endings.

Signal (strain or displacement along the normal at the ending) -> linear filter -> positive half -> leaky integrator
with a threshold and an inhibition after each spike. The form is that of Dong et al. (J. Neurophysiol. 109 (2013) 1350)
and Saal et al. (PNAS 114 (2017) E5693), with fewer constants. Their constants are not used: here they are fitted to
TUNING, published thresholds of single units (`scripts/verification/fit_afferents.py`). A signal is divided by that
under a probe of PROBE_M on an incompressible half space: the input of a filter is the displacement of that probe with
the same effect.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
import scipy  # loads its parts at first use
from numpy.typing import ArrayLike

from palmfield.errors import OutputError
from palmfield.types import Complex, Float, Int

PROBE_M = 1e-3
"""Radius of the probe that TUNING is assumed for [m]; the source does not state it. Other radii shift all levels."""
LONGEST_STEP_S = 1.25e-4
"""Longest time step of filters and integrators [s]; longer steps of a record are divided."""
AFTER = 8.0
"""Inhibition by each spike, over the threshold. It and `after_s` set the range of amplitudes with one spike a cycle."""
BLOCK = 256
"""Number of afferents computed together, which bounds the memory of long runs."""
Quantity = Literal["strain", "displacement"]


@dataclass(frozen=True)
class Afferent:
    """One class of afferents.

    depth_m: depth of the endings below the surface [m]. quantity: motion along the normal that drives it.
    zeros_Hz, poles_Hz: zeros and poles of the filter over 2 pi [Hz], of its Laplace transform; poles have negative real
    parts. gain_per_m: factor of the filter. tau_s: time constant of the integrator [s].
    after_s: time constant with which the inhibition by a spike ends [s]; thresholds do not depend on it.
    tuning: frequencies [Hz] and peak displacements of the probe at which the unit begins to fire [m], both (n,)
    """

    name: str
    depth_m: float
    quantity: Quantity
    zeros_Hz: tuple[complex, ...]
    poles_Hz: tuple[complex, ...]
    gain_per_m: float
    tau_s: float
    after_s: float
    tuning: tuple[tuple[float, ...], tuple[float, ...]]


def _pair(f_Hz: float, damping: float) -> tuple[complex, complex]:
    """Return the poles over 2 pi of a resonance."""
    imaginary = f_Hz * math.sqrt(1.0 - damping**2)
    return complex(-damping * f_Hz, imaginary), complex(-damping * f_Hz, -imaginary)


TUNING: dict[str, tuple[tuple[float, ...], tuple[float, ...]]] = {
    "sa1": ((2, 5, 10, 20, 30, 50), (26.7e-6, 21.1e-6, 24.9e-6, 32e-6, 37.5e-6, 41.8e-6)),
    "ra1": ((2, 5, 10, 20, 30, 50, 80), (26e-6, 11.1e-6, 5.6e-6, 1.82e-6, 1.12e-6, 1.29e-6, 1.58e-6)),
    "pc": (
        (10, 20, 30, 50, 80, 100, 150, 200, 250, 300, 350, 400, 500),
        (33e-6, 3.9e-6, 1.25e-6, 0.298e-6, 0.113e-6, 0.077e-6, 0.048e-6, 0.042e-6, 0.046e-6, 0.070e-6, 0.111e-6,
         0.130e-6, 0.290e-6),
    ),
}  # fmt: skip
"""Thresholds of single units: frequency [Hz], peak displacement [m]. Digitised in the public data of a model of single
units. PC at 400 and 500 Hz: the human threshold of Bolanowski et al. (1988) relative to that at 250 Hz."""
AFFERENTS: dict[str, Afferent] = {
    "sa1": Afferent("sa1", 7e-4, "strain", (-146.0,), (-1460.0,), 4.314e5, 8.82e-3, 5e-3, TUNING["sa1"]),
    "ra1": Afferent("ra1", 7e-4, "strain", (0.0, -8.11), (-25.55, -25.55), 1.358e6, 3.74e-3, 8e-3, TUNING["ra1"]),
    "pc": Afferent(
        "pc", 2e-3, "displacement", (0.0, 0.0, 0.0), (-101.0, -101.0, -101.0, *_pair(220.3, 0.3965)), 6.695e13, 8.15e-4,
        2.5e-3, TUNING["pc"],
    ),
}  # fmt: skip
"""Classes by name. Depths: SA1 and RA1 0.7 mm, PC 2 mm. RA1 and SA1 read strain and PC displacement, because thresholds
of the former do not depend on the area of a contact and those of the latter fall with it (Bolanowski et al. 1988)."""


def probe_strain(depth_m: ArrayLike, radius_m: float = PROBE_M, distance_m: ArrayLike = 0.0) -> Float:
    """Return the compression along the normal under a flat round probe, over the displacement of the probe [1/m].

    depth_m, distance_m: depth below the surface, above 0, and distance from the axis of the probe [m], of equal shape
    Source: Boussinesq's solution for an incompressible half space, u = (phi - z phi') / (4 pi G), with the potential
    phi of a charged disc (I. N. Sneddon, Proc. Camb. Phil. Soc. 42 (1946) 29).
    """
    z, place, q = _under_probe(depth_m, radius_m, distance_m)
    compression: Float = -(2.0 / np.pi) * z * np.imag(place / q**3)
    return compression


def probe_displacement(depth_m: ArrayLike, radius_m: float = PROBE_M, distance_m: ArrayLike = 0.0) -> Float:
    """Return the normal displacement under a flat round probe, relative to the probe; arguments of `probe_strain`."""
    z, place, q = _under_probe(depth_m, radius_m, distance_m)
    moved: Float = (2.0 / np.pi) * np.imag(np.log(place + q) - z / q)
    return moved


def _under_probe(depth_m: ArrayLike, radius_m: float, distance_m: ArrayLike) -> tuple[Float, Complex, Complex]:
    """Return the depth, and the complex depth and distance from which phi = Im log(place + q)."""
    z, r = np.broadcast_arrays(np.asarray(depth_m, dtype=float), np.asarray(distance_m, dtype=float))
    place = z + 1j * radius_m
    return z, place, np.sqrt(r**2 + place**2)


def under_probe(afferent: Afferent, radius_m: float, distance_m: ArrayLike) -> Float:
    """Return the motion that drives a class, `probe_strain` or `probe_displacement` at its depth."""
    of_probe = probe_strain if afferent.quantity == "strain" else probe_displacement
    return of_probe(afferent.depth_m, radius_m, distance_m)


@cache
def largest_under_probe(afferent: Afferent, radius_m: float = PROBE_M) -> float:
    """Return the largest compression [1/m] or displacement at the depth of a class under a probe, over that of the
    probe: a receptive field is probed where it is most sensitive."""
    return float(under_probe(afferent, radius_m, np.linspace(0.0, 2.0 * radius_m, 401)).max())


def potentials(afferent: Afferent, motion: ArrayLike, step_s: float) -> tuple[Float, float]:
    """Return the level of the integrator without threshold, over the threshold, shape (k, n), and its time step [s].

    It is proportional to the motion: a unit whose level stays below 1 does not fire.
    motion: motion at n endings over `largest_under_probe` [m], shape (t, n), from rest; linear between samples
    step_s: time between samples [s]; the result divides it into equal steps of at most LONGEST_STEP_S
    Raises OutputError for another shape, a value that is not finite, and a step that is not above 0.
    """
    driven, step = _driven(afferent, motion, step_s)
    return _integrated(driven, step, afferent.tau_s), step


def spikes(afferent: Afferent, motion: ArrayLike, step_s: float) -> tuple[Float, Int]:
    """Return the times of all spikes from the first sample [s], rising, and the ending of each, both (m,).

    motion, step_s: as for `potentials`, with the same errors
    """
    motion = _checked(motion, step_s)
    moments: list[Float] = []
    numbers: list[Int] = []
    for first in range(0, motion.shape[1], BLOCK):
        driven, step = _driven(afferent, motion[:, first : first + BLOCK], step_s)
        loud = np.flatnonzero(_integrated(driven, step, afferent.tau_s).max(axis=0, initial=0.0) >= 1.0)
        begun = np.zeros((2, len(loud)))
        for number, fired in _fired(afferent, driven[:, loud], step, *begun):
            moments.append(np.full(len(fired), number * step))
            numbers.append((first + loud[fired]).astype(np.int32))
    if not moments:
        return np.zeros(0), np.zeros(0, np.int32)
    time, ending = np.concatenate(moments), np.concatenate(numbers)
    order = np.lexsort((ending, time))
    return time[order], ending[order]


class AfferentSteps:
    """Steps units of one class in time, with a state of the caller: a run in parts has the spikes of `spikes`.

    size: numbers of the state of a unit; all are 0 for a skin at rest
    """

    def __init__(self, afferent: Afferent, step_s: float):
        """step_s: time between samples of the motion [s]"""
        self._afferent, self._parts, self._step = afferent, *_parts_of(step_s)
        self._sections = _filter(afferent, self._step)
        self.size = 2 * len(self._sections) + 4

    def counts(self, state: Float, motion: Float) -> Int:
        """Return the number of spikes of n units, (n,), and advance their state, (size, n), in place.

        motion: at the next samples over `largest_under_probe` [m], shape (t, n)
        """
        motion = np.concatenate([state[-1:], motion])
        filtered, state[:-4] = self._filtered(state[:-4], _between(motion, self._parts)[1:])
        driven = np.concatenate([state[-4:-3], np.maximum(filtered, 0.0)])
        result = np.zeros(motion.shape[1], np.int32)
        for _, fired in _fired(self._afferent, driven, self._step, state[-3], state[-2]):
            result[fired] += 1
        state[-4], state[-1] = driven[-1], motion[-1]
        return result

    def _filtered(self, state: Float, motion: Float) -> tuple[Float, Float]:
        """Return the filtered motion, (t, n), and the state of the filter after it, as `state`."""
        delays = state.reshape(len(self._sections), 2, -1)
        filtered, delays = scipy.signal.sosfilt(self._sections, motion, axis=0, zi=delays)
        return filtered, delays.reshape(state.shape)


def _driven(afferent: Afferent, motion: ArrayLike, step_s: float) -> tuple[Float, float]:
    """Return the positive half of the filtered motion, (k, n), and its time step [s]."""
    motion = _checked(motion, step_s)
    parts, step = _parts_of(step_s)
    motion, sections = _between(motion, parts), _filter(afferent, step)
    # A skin that is moved at the start has been so for long
    settled = scipy.signal.sosfilt_zi(sections)[:, :, None] * motion[:1]
    filtered, _ = scipy.signal.sosfilt(sections, motion, axis=0, zi=settled)
    return np.maximum(filtered, 0.0), step


def _parts_of(step_s: float) -> tuple[int, float]:
    """Return the number of steps of a filter between samples, and its time step [s]."""
    parts = math.ceil(step_s / LONGEST_STEP_S - 1e-9)
    return parts, step_s / parts


def _between(motion: Float, parts: int) -> Float:
    """Return samples with linear interpolation, `parts` steps from each sample to the next, (k, n)."""
    if parts == 1 or len(motion) < 2:
        return motion
    shares = (np.arange(parts) / parts)[:, None]
    between = motion[:-1, None] + shares * np.diff(motion, axis=0)[:, None]
    return np.concatenate([between.reshape(-1, motion.shape[1]), motion[-1:]])


def _filter(afferent: Afferent, step: float) -> Float:
    """Return the filter of a class as sections of second order."""
    analogue = [2.0 * np.pi * np.array(one) for one in (afferent.zeros_Hz, afferent.poles_Hz)]
    sections: Float = scipy.signal.zpk2sos(*scipy.signal.bilinear_zpk(*analogue, afferent.gain_per_m, 1.0 / step))
    return sections


def _checked(motion: ArrayLike, step_s: float) -> Float:
    motion = np.asarray(motion, dtype=np.float64)
    if motion.ndim != 2 or not np.isfinite(motion).all():
        raise OutputError(f"the motion of the endings has shape {motion.shape}; give finite numbers of shape (t, n)")
    if not step_s > 0.0:
        raise OutputError(f"step_s is {step_s:g}; allowed: above 0")
    return motion


def _integrated(driven: Float, step: float, tau_s: float) -> Float:
    """Return V of tau V' = I - V from 0, for an input that is linear in each step, (k, n)."""
    left, begin, end = _step_of(step, tau_s)
    level = scipy.signal.lfilter([end, begin], [1.0, -left], driven, axis=0)
    result: Float = level
    return result


def _step_of(step: float, tau_s: float) -> tuple[float, float, float]:
    """Return the share of V left after a step, and the weights of the input at its beginning and end."""
    left = math.exp(-step / tau_s)
    end = 1.0 - (1.0 - left) * tau_s / step
    return left, 1.0 - left - end, end


def _fired(afferent: Afferent, driven: Float, step: float, level: Float, after: Float) -> Iterator[tuple[int, Int]]:
    """Yield each step in which units fire, and these units. level, after: integrator and inhibition, (n,), in place."""
    left, begin, end = _step_of(step, afferent.tau_s)
    fades = math.exp(-step / afferent.after_s)
    for number in range(1, len(driven)):
        level[:] = left * level + begin * (driven[number - 1] - after) + end * (driven[number] - fades * after)
        after *= fades
        fired = np.flatnonzero(level >= 1.0)
        if len(fired):
            level[fired] = 0.0
            after[fired] += AFTER
            yield number, fired.astype(np.int32)
