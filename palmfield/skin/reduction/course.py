"""Loads with a given time course: harmonics that start and end suddenly or exponentially."""

from dataclasses import dataclass

import numpy as np
import scipy  # loads its submodules at first use

from palmfield.types import Complex, Float

Fade = tuple[tuple[float, float], ...]
"""Start or end of a load: the sum of share e^{-rate t} over pairs (rate [1/s], share). ((0, 1),) is sudden."""


@dataclass(frozen=True)
class Course:
    """Loads F mix w with w' = S w, for each of e initial values w_0.

    shapes F [N], shape (n, m); mix: shape (m, k); rates S [1/s], shape (k, k); starts w_0, shape (k, e)
    """

    shapes: Float
    mix: Float
    rates: Float
    starts: Float


def periodic(shapes: Complex, frequencies_Hz: Float, events: list[tuple[float, Fade]]) -> Course:
    """Return the course of a load, the sum over k of Re(F_k e^{-i w_k t}), that fades in or out at each event.

    shapes: F_k [N], shape (n, k); frequencies_Hz: >= 0, shape (k,)
    events: time t [s] and fade of each event
    """
    omega = 2.0 * np.pi * np.asarray(frequencies_Hz)
    turns = scipy.linalg.block_diag(*(np.array([[0.0, w], [-w, 0.0]]) for w in omega))
    both = np.stack([shapes.real, -shapes.imag], axis=2).reshape(len(shapes), -1)
    unit = np.eye(len(turns))
    rates = sorted({rate for _, fade in events for rate, _ in fade})
    starts = [
        np.concatenate([dict(fade).get(rate, 0.0) * harmonics(frequencies_Hz, np.array([time]))[0] for rate in rates])
        for time, fade in events
    ]
    return Course(
        both,
        np.hstack([unit] * len(rates)),
        scipy.linalg.block_diag(*(turns - rate * unit for rate in rates)),
        np.array(starts).T,
    )


def harmonics(frequencies_Hz: Float, times: Float) -> Float:
    """Return (cos w_k t, -sin w_k t) for each k, shape (t, 2 k): factors of the shapes of `periodic`."""
    angle = 2.0 * np.pi * np.outer(times, frequencies_Hz)
    return np.stack([np.cos(angle), -np.sin(angle)], axis=2).reshape(len(angle), -1)


def level(fade: Fade, times: Float) -> Float:
    """Return the factor of the load at times [s] after the event, shape (t,)."""
    return np.sum([share * np.exp(-rate * times) for rate, share in fade], axis=0)
