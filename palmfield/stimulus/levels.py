"""Levels of many stimuli at the same moments, for worlds that are stepped together."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmfield.config import StimulusConfig
from palmfield.stimulus.modulation import Modulation
from palmfield.stimulus.schedule import TICK_S, Envelope, arp_factors, envelope_of, level_jumps
from palmfield.types import Float


def goes_smoothly(config: StimulusConfig) -> bool:
    """Whether a stimulus is a fixed focus whose level jumps only at its beginning and end."""
    still = config.path == "point" and config.control_rate_Hz == 0.0
    return still and config.burst_window == "none" and not level_jumps(config)


class Levels:
    """The levels of n stimuli; those of one kind are computed together. Paths, ticks and bursts are not supported."""

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
        """ARP relative to the loudest moment, 0..1, at times [s], shape (m,): shape (n, m)."""
        if len(self._groups) == 1:
            return arp_factors(self._groups[0][1], times)
        result = np.empty((len(self._edges), len(times)))
        for rows, envelope in self._groups:
            result[rows] = arp_factors(envelope, times)
        return result

    def jump(self, start_s: float, end_s: float) -> NDArray[np.bool_]:
        """Return which of the stimuli begin or end after start_s, and by end_s [s], shape (n,)."""
        within = (self._edges > start_s + TICK_S) & (self._edges <= end_s + TICK_S)
        return np.logical_or.reduce(within, axis=1)


def _kind(am: Modulation | None) -> tuple[object, ...]:
    """Return a key that is equal for modulations that differ only in numbers."""
    return () if am is None else (am.quantity, am.waveform.name, am.waveform.table)


def _stacked(envelopes: Sequence[Envelope]) -> Envelope:
    """Envelopes of one kind as one, in columns."""
    first = envelopes[0]
    return Envelope(
        start_s=_column([one.start_s for one in envelopes]),
        ends=tuple(_column([one.ends[i] for one in envelopes]) for i in range(len(first.ends))),
        ramp_s=None if first.ramp_s is None else _column([one.ramp_s for one in envelopes]),
        am=None if first.am is None else _modulations([one.am for one in envelopes if one.am is not None]),
        burst=None,
    )


def _modulations(modulations: Sequence[Modulation]) -> Modulation:
    """Modulations of one kind as one, in columns."""
    forms = [one.waveform for one in modulations]
    waveform = forms[0]._replace(
        frequency_Hz=_column([form.frequency_Hz for form in forms]),
        highest=_column([form.highest for form in forms]),
        duty=_column([form.duty for form in forms]),
        burst_length_s=_column([form.burst_length_s for form in forms]),
        burst_period_s=_column([form.burst_period_s for form in forms]),
        burst_phase=_column([form.burst_phase for form in forms]),
    )
    return modulations[0]._replace(
        waveform=waveform,
        depth=_column([one.depth for one in modulations]),
        peak_duty=_column([one.peak_duty for one in modulations]),
        exponent=_column([one.exponent for one in modulations]),
    )


def _column(values: Sequence[Any]) -> Float:
    return np.array(values, dtype=np.float64)[:, None]
