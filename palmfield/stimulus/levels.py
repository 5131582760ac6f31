"""Levels of many stimuli at the same times, for worlds that are stepped together."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmfield.config import StimulusConfig
from palmfield.stimulus.modulation import Modulation
from palmfield.stimulus.schedule import TICK_S, Envelope, arp_factors, envelope_of, level_jumps
from palmfield.types import Float


def goes_smoothly(config: StimulusConfig) -> bool:
    """Return whether a stimulus is a fixed focus whose level jumps only at its beginning and end."""
    still = config.path == "point" and config.control_rate_Hz == 0.0
    return still and config.burst_window == "none" and not level_jumps(config)


class Levels:
    """Levels of n stimuli; stimuli of one kind are computed together. Paths, ticks and bursts are not supported."""

    def __init__(self, configs: Sequence[StimulusConfig]):
        envelopes = [envelope_of(config) for config in configs]
        kinds = [(len(one.ends), one.ramp_s is None, _kind(one.am)) for one in envelopes]
        self._groups: list[tuple[NDArray[np.intp], Envelope]] = []
        for kind in dict.fromkeys(kinds):
            rows = np.array([i for i, other in enumerate(kinds) if other == kind])
            self._groups.append((rows, _stacked([envelopes[i] for i in rows])))
        most = max(len(one.ends) for one in envelopes)
        self._edges: Float = np.full((len(envelopes), 1 + most), -np.inf)
        for row, one in zip(self._edges, envelopes, strict=True):
            row[: 1 + len(one.ends)] = one.start_s, *one.ends

    def at(self, times: Float) -> Float:
        """Return the ARP relative to the loudest moment, 0..1, shape (n, m), at times [s], shape (m,)."""
        if len(self._groups) == 1:
            return arp_factors(self._groups[0][1], times)
        result = np.empty((len(self._edges), len(times)))
        for rows, envelope in self._groups:
            result[rows] = arp_factors(envelope, times)
        return result

    def jump(self, start_s: float, end_s: float) -> NDArray[np.bool_]:
        """Return True for stimuli that begin or end in start_s < t <= end_s [s], shape (n,)."""
        within = (self._edges > start_s + TICK_S) & (self._edges <= end_s + TICK_S)
        return np.logical_or.reduce(within, axis=1)


def _kind(am: Modulation | None) -> tuple[object, ...]:
    """Return a key that is equal for modulations that differ only in numbers."""
    return () if am is None else (am.quantity, am.waveform.name, am.waveform.table)


def _stacked(envelopes: Sequence[Envelope]) -> Envelope:
    """Return envelopes of one kind as one envelope in columns."""
    modulations = [one.am for one in envelopes if one.am is not None]
    am = None
    if modulations:
        numbers = ("frequency_Hz", "highest", "duty", "burst_length_s", "burst_period_s", "burst_phase")
        waveform = _in_columns([one.waveform for one in modulations], *numbers)
        am = _in_columns(modulations, "depth", "peak_duty", "exponent")._replace(waveform=waveform)
    times = ("start_s",) if envelopes[0].ramp_s is None else ("start_s", "ramp_s")
    ends = tuple(_column(moments) for moments in zip(*(one.ends for one in envelopes), strict=True))
    return _in_columns(envelopes, *times)._replace(ends=ends, am=am, burst=None)


def _in_columns(many: Sequence[Any], *names: str) -> Any:
    """Return the first of many named tuples, with the numbers of all in columns."""
    return many[0]._replace(**{name: _column([getattr(one, name) for one in many]) for name in names})


def _column(values: Sequence[Any]) -> Float:
    return np.array(values, dtype=np.float64)[:, None]
