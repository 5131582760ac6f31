"""Record the last periods of a running simulation: motion and ARP of the skins at all substeps, and levels."""

from collections import deque
from dataclasses import replace
from math import ceil
from typing import Any

import numpy as np

from palmfield.estimate.sensation_levels import felt_levels
from palmfield.outputs.schema import Arrays, group
from palmfield.outputs.verdict import shown_level
from palmfield.perception import OBSERVERS
from palmfield.perception.force_threshold import FORCE_OBSERVER
from palmfield.session.recorded_run import recorder_of
from palmfield.session.recorder import Recorder
from palmfield.session.simulation import Simulation
from palmfield.stimulus.schedule import main_frequencies
from palmfield.studies.view.messages import Level, Replay, SkinReplay
from palmfield.types import Float

PERIODS = 2
"""Number of periods of the lowest main frequency. Fewer periods do not determine a level."""
SHORTEST_s, LONGEST_s = 4e-3, 0.25
MOST_PICTURES = 24
"""Largest number of states in a replay."""


class Blocks:
    """A sink of a recorder that keeps the last blocks, one per MuJoCo step, and forwards all blocks."""

    def __init__(self, steps: int, on: Any = None) -> None:
        """steps: number of blocks to keep; on: sink to which blocks are forwarded"""
        self.kept: deque[Arrays] = deque(maxlen=steps)
        self._on = on

    def append(self, block: Arrays) -> None:
        self.kept.append(block)
        if self._on is not None:
            self._on.append(block)


class Periods:
    """Records a simulation for as many steps as a level needs, and then stops, because recording takes time."""

    def __init__(self, sim: Simulation) -> None:
        """Begin to record."""
        self._sim = sim
        self._blocks = Blocks(steps_watched(sim))
        self._recorder = recorder_of(sim, self._blocks)
        self._recorder.start()
        # The state before the first step is not part of the replay
        self._blocks.kept.clear()

    def step(self) -> Replay | None:
        """Record a step. After enough steps, return the replay and stop recording."""
        self._recorder.step()
        if len(self._blocks.kept) < (self._blocks.kept.maxlen or 0):
            return None
        self.stop()
        return replay(self._sim, list(self._blocks.kept), self._recorder)

    def stop(self) -> None:
        """Stop recording."""
        self._recorder.stop()


def period_s(sim: Simulation) -> float | None:
    """Return the period of the lowest main frequency of the sound [s]; None if the sound is not periodic."""
    model = sim.runtime.model
    frequencies = main_frequencies(model.configs[model.sounding])
    return 1.0 / frequencies[0] if frequencies else None


def steps_watched(sim: Simulation) -> int:
    """Return the number of MuJoCo steps that a replay contains."""
    period, step_s = period_s(sim), sim.runtime.spec.timestep_s
    # One more sample, because a record of two periods includes its first and last sample
    length_s = SHORTEST_s if period is None else PERIODS * period + sim.runtime.model.step_s
    return max(1, ceil(min(max(length_s, SHORTEST_s), LONGEST_s) / step_s - 1e-6))


def replay(sim: Simulation, blocks: list[Arrays], recorder: Recorder) -> Replay:
    """Return the replay of consecutive blocks. recorder: recorder that wrote them"""
    model = sim.runtime.model
    times: Float = np.concatenate([block["/"]["time"] for block in blocks])
    period = period_s(sim)
    shown_s = times[-1] - times[0] if period is None else min(period, times[-1] - times[0])
    first = int(np.searchsorted(times, times[-1] - shown_s + 1e-9))
    chosen = np.arange(first, len(times), ceil((len(times) - first) / MOST_PICTURES))
    skins = []
    for number, part in enumerate(model.skins):
        own = [block[group("skin", part.spec.name)] for block in blocks]
        # Single precision, because there are thousands of points at hundreds of times
        normals = part.nodes[1].astype(np.float32)
        normal = np.einsum("tsi,si->ts", np.concatenate([one["displacement"] for one in own]), normals)
        arp = np.concatenate([one["arp"] for one in own])
        levels = _levels(sim, number, recorder, times, normal, arp.max(axis=1))
        skins.append(SkinReplay(normal[chosen], arp[chosen], normal.std(axis=0), levels))
    begun = recorder.begun_s
    what = f"{1e3 * shown_s:.4g} ms" + ("" if period is None or period > shown_s else " (one period)")
    return Replay(begun + times[chosen], shown_s, f"{what} until {begun + times[-1]:.3f} s", tuple(skins))


def _levels(
    sim: Simulation, skin: int, recorder: Recorder, times: Float, normal: np.ndarray, arp_peaks: np.ndarray
) -> tuple[Level, ...]:
    """Return, for each observer, the level of the motion of a skin, or why there is none."""
    runtime = sim.runtime
    model, loudest = runtime.model, recorder.loudest[skin]
    if loudest is not None and arp_peaks.max() > 0.0:
        # A recording may contain an earlier moment with a higher ARP
        unit = runtime.work.radiation.on(loudest.posed, skin, "nodes", loudest.drive).arp
        loudest = replace(loudest, factor=float(arp_peaks.max() / unit.max())) if unit.max() > 0.0 else loudest
    numbers = felt_levels(
        model, skin, loudest if arp_peaks.max() > 0.0 else None, runtime.work.radiation, runtime.work.reference,
        times, normal, arp_peaks, begun_s=recorder.begun_s,
    )  # fmt: skip
    period = period_s(sim)
    nothing = "the sound does not repeat" if period is None else f"it takes {PERIODS} periods of {period:.3g} s"
    levels = []
    for name in (FORCE_OBSERVER.name, *OBSERVERS):
        level, lines = shown_level(numbers, name)
        why = str(numbers.get(f"level_{name}_why", f"refused: {nothing}"))
        levels.append(Level(name, level, why if level is None else f"{lines}; {why}", lines))
    return tuple(levels)
