"""Levels of many stimuli at the same moments, for worlds that are stepped together."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmfield.config import StimulusConfig
from palmfield.stimulus.schedule import TICK_S, Envelope, arp_factors, envelope_of
from palmfield.types import Float


def goes_smoothly(config: StimulusConfig) -> bool:
    """Whether a stimulus is a focus in one place whose level jumps nowhere but at its beginning and end."""
    return config.path == "point" and config.control_rate_Hz == 0.0 and config.burst_window == "none"


class Levels:
    """The levels of n stimuli; those of one kind are computed in one go. Paths, ticks and bursts are left out."""

    def __init__(self, configs: Sequence[StimulusConfig]):
        envelopes = [envelope_of(config) for config in configs]
        kinds = [(len(one.ends), one.ramp_s is None, one.am_of) for one in envelopes]
        self._groups: list[tuple[NDArray[np.intp], Envelope]] = []
        for kind in dict.fromkeys(kinds):
            rows = np.array([i for i, other in enumerate(kinds) if other == kind])
            self._groups.append((rows, _stacked([envelopes[i] for i in rows])))
        most = max(len(one.ends) for one in envelopes)
        self._edges: Float = np.full((len(envelopes), 1 + most), -np.inf)
        for row, one in zip(self._edges, envelopes, strict=True):
            row[: 1 + len(one.ends)] = one.start_s, *one.ends

    def at(self, times: Float) -> Float:
        """ARP relative to the loudest moment, 0..1, at times [s], shape (m,): shape (n, m)."""
        if len(self._groups) == 1:
            return arp_factors(self._groups[0][1], times)
        result = np.empty((len(self._edges), len(times)))
        for rows, envelope in self._groups:
            result[rows] = arp_factors(envelope, times)
        return result

    def jump(self, start_s: float, end_s: float) -> NDArray[np.bool_]:
        """Which of the stimuli begin or end after start_s, and by end_s [s], shape (n,)."""
        within = (self._edges > start_s + TICK_S) & (self._edges <= end_s + TICK_S)
        return np.logical_or.reduce(within, axis=1)


def _stacked(envelopes: Sequence[Envelope]) -> Envelope:
    """Envelopes of one kind as one, in columns."""
    first = envelopes[0]

    def column(values: Sequence[Any]) -> Float:
        return np.array(values, dtype=np.float64)[:, None]

    return Envelope(
        start_s=column([one.start_s for one in envelopes]),
        ends=tuple(column([one.ends[i] for one in envelopes]) for i in range(len(first.ends))),
        ramp_s=None if first.ramp_s is None else column([one.ramp_s for one in envelopes]),
        am_of=first.am_of,
        am_depth=column([one.am_depth for one in envelopes]),
        am_frequency_Hz=column([one.am_frequency_Hz for one in envelopes]),
        burst=None,
    )
