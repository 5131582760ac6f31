"""Motion of the skin of a hand under the sound of a trial. The scene is stepped with the output of the board."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from palmfield.drive.board import Emitted
from palmfield.drive.transducer_response import EmittedCourse, of_drives
from palmfield.interrupts import interrupts_delayed
from palmfield.session.duration import step_count
from palmfield.session.simulation import Simulation
from palmfield.simulation.emission import Emission, MeanDrives, of_moments
from palmfield.simulation.model import HapticModel
from palmfield.simulation.posed_scene import PosedScene
from palmfield.stimulus.schedule import Moments, substep_moments
from palmfield.types import Complex, Float


class PlayedEmission(Emission):
    """Output of a board, which replaces the drive of the stimuli of a scene."""

    def __init__(self, model: HapticModel, emitted: Sequence[Emitted]) -> None:
        """emitted: drives with rising start times; silence before the first."""
        super().__init__(model)
        self.holds = False
        self._times: Float = np.array([one.time_s for one in emitted])
        nothing = np.zeros(len(model.arrays), np.complex128)
        self._rows: Complex = np.array([nothing, *(one.amplitudes for one in emitted)])

    def sounding(self, times: Float) -> Complex:
        """Return the drives at some times [s], shape (k, N)."""
        return self._rows[np.searchsorted(self._times, times + 1e-9, "right")]

    def begin(self, posed: PosedScene, time_s: float) -> None:
        return

    def over(self, posed: PosedScene, emitted: Complex, t0: float, count: int) -> tuple[Moments, EmittedCourse]:
        moments = substep_moments((), t0, self.model.step_s, count, hold=True)
        rows = self.sounding(moments.times)
        return moments, of_drives(rows, rows[-1])

    def path_step(self, posed: PosedScene, t0: float, count: int) -> None:
        return None

    def now(self, posed: PosedScene, emitted: Complex, time_s: float) -> EmittedCourse:
        rows = self.sounding(np.array([time_s]))
        return of_drives(rows, rows[0])

    def commanded(self, posed: PosedScene, times: Float) -> Complex:
        return self.sounding(times)

    def mean_drives(self, posed: PosedScene, emitted: Complex, t0: float) -> MeanDrives:
        moments, course = self.over(posed, emitted, t0, self.model.substeps)
        return of_moments(course, np.add.reduce(moments.first, axis=0) / self.model.substeps)


class SkinResponse(NamedTuple):
    """Motion of a skin over a trial, at the ends of MuJoCo's steps.

    times: times [s], shape (k,)
    arp: largest ARP [Pa], shape (k,)
    motion: displacement [m] and velocity [m/s] along the outward normal at the requested places, (p, 2, k)
    """

    times: Float
    arp: Float
    motion: Float

    @property
    def push(self) -> Float:
        """Displacement into the skin at the first place [m], shape (k,)."""
        return -self.motion[0, 0]


def skin_response(
    scene: str | Path,
    emitted: Sequence[Emitted],
    duration_s: float,
    *,
    board: str | None,
    keys: Mapping[str, object],
    places: Float,
) -> SkinResponse:
    """Step a scene with the output of a board, and observe its first skin.

    places: positions in the array frame at the beginning [m], shape (p, 3); the nearest nodes are recorded
    Ctrl-C ends the steps early with the results so far. Raises the errors of `palmfield.Simulation`.
    """
    sim = Simulation(scene, device="cpu", board=board, keys=keys)
    name = sim.skins[0]
    if not sim.runtime.model.skins[0].choice.solver.any_pose:
        # A reduced model is valid only for the sound of the scene; modal models are valid for any
        sim = Simulation(scene, device="cpu", board=board, keys={**keys, f"{name}.solver": "modal"})
    sim.steps.play({0: PlayedEmission(sim.runtime.model, emitted)})
    part = sim.skin(name)
    there = sim.runtime.posed.skins[0].nodes[0]
    nodes = np.linalg.norm(there[None] - places[:, None], axis=2).argmin(axis=1)
    normals = part.rest_normal[nodes]
    times, arps, rows = [], [], []
    for lazy in sim.runtime.model.begin:
        _ = lazy.value
    try:
        with interrupts_delayed() as check:
            for _ in range(step_count(duration_s, sim.model.opt.timestep)):
                sim.step()
                both = part.displacement[nodes], part.velocity[nodes]
                times.append(sim.time)
                arps.append(float(part.arp.max()))
                rows.append([np.einsum("pi,pi->p", one, normals) for one in both])
                check()
    except KeyboardInterrupt:
        pass
    motion = np.array(rows).reshape(-1, 2, len(nodes)).transpose(2, 1, 0)
    return SkinResponse(np.array(times), np.array(arps), motion)
