"""What a sweep watches of running worlds: motion of all vertices, highest ARP, forces and sensors of each."""

from functools import partial

import numpy as np
from numpy.typing import NDArray

from palmfield.session.loudest_moment import LoudestMoment
from palmfield.session.recorder import Emitted, emitted_at, emitted_at_ends
from palmfield.session.simulation import Simulation
from palmfield.simulation.posed_scene import PosedScene
from palmfield.simulation.sensors import CHANNELS
from palmfield.simulation.state import at_rest
from palmfield.simulation.step import StepTrace
from palmfield.simulation.step_together import TogetherTrace
from palmfield.types import Float, Float32

NORMAL = list(CHANNELS).index("normal_displacement_m")


class Watched:
    """Watches the worlds of a simulation, or the one that it is, from its start on.

    simulation: at rest, or as it stands; steps: of MuJoCo's that follow
    times: ends of the substeps, from the run's start [s], shape (t,)
    motion: by skin, normal displacement [m] and velocity [m/s] in each world, shape (w, t, 2, S)
    arp: highest ARP at these times [Pa], shape (w, skins, t); peak_arp: of all times, shape (w, skins)
    loudest: its moments by world and skin, None in silence
    forces: mean force of the sound on each skin's body in each step [N], world axes, shape (steps, w, skins, 3)
    sensors: normal displacement at all skins' sensors at the beginning of each step [m], shape (steps, w, sensors)
    """

    def __init__(self, simulation: Simulation, steps: int) -> None:
        self.simulation = simulation
        self.runtimes = simulation.runtimes
        if simulation.worlds is not None:
            simulation.together.observer = self._together
        model, world = self.runtimes[0].model, self.runtimes[0].view
        self._bodies = [skin.body for skin in model.skins]
        names = [sensor.name for skin in self.runtimes[0].binding.skins for sensor in world.sensors(skin.instance)]
        self._places = [int(simulation.model.sensor(name).adr[0]) + NORMAL for name in names]
        count, records = len(self.runtimes), 1 + steps * model.substeps
        self.times: Float = np.zeros(records)
        shapes = [(count, records, 2, skin.layer.mesh.surface_nodes) for skin in model.skins]
        self.motion: list[Float32] = [np.zeros(shape, np.float32) for shape in shapes]
        self.arp: Float = np.zeros((count, len(model.skins), records))
        self.peak_arp: Float = np.zeros((count, len(model.skins)))
        self.loudest: list[list[LoudestMoment | None]] = [[None] * len(model.skins) for _ in self.runtimes]
        self.forces: Float = np.zeros((steps, count, len(model.skins), 3))
        self.sensors: Float = np.zeros((steps, count, len(names)))
        # The highest ARP of a world's unit drive on a skin, with the pose for which it holds
        self._units: dict[tuple[int, int], tuple[PosedScene, float]] = {}
        self._steps, self.begun_s = 0, simulation.time
        operators = tuple(skin.layer.surface_operator for skin in model.skins)
        for number, runtime in enumerate(self.runtimes):
            runtime.work.observe = operators
            self._begin(number)
            runtime.work.observer = partial(self._alone, number)

    def step(self) -> None:
        """One step of MuJoCo's has ended."""
        forces = np.reshape(self.simulation.forces, (len(self.runtimes), -1, 3))
        self.forces[self._steps] = forces[:, self._bodies]
        self.sensors[self._steps] = np.reshape(self.simulation.sensors, (len(self.runtimes), -1))[:, self._places]
        self._steps += 1

    def _begin(self, world: int) -> None:
        """Motion and sound before the first step."""
        runtime = self.runtimes[world]
        for skin, (stepper, numbers) in enumerate(runtime.skin_states()):
            if at_rest(runtime.state, skin):
                continue
            reader = runtime.work.reader(skin, stepper)
            assert reader is not None
            self.motion[skin][world, 0] = stepper.read(numbers, reader)[0]
        posed, course = runtime.now()
        self._hear(world, posed, emitted_at(course, np.array([0])), np.array([self.begun_s]), slice(0, 1))

    def _rows(self, count: int) -> slice:
        """Of the arrays over time: the substeps of the present step."""
        return slice(1 + self._steps * count, 1 + (self._steps + 1) * count)

    def _alone(self, world: int, trace: StepTrace) -> None:
        """Take the step of one world."""
        rows = self._rows(len(trace.times))
        self.times[rows] = trace.times - self.begun_s
        for motion, seen in zip(self.motion, trace.motion, strict=True):
            assert seen is not None
            motion[world, rows] = seen
        runtime = self.runtimes[world]
        emitted = emitted_at_ends(runtime.work.emission, trace, runtime.model.step_s)
        self._hear(world, trace.posed, emitted, trace.times, rows)

    def _together(self, trace: TogetherTrace) -> None:
        """Take the step of the worlds that have joined."""
        rows = self._rows(len(trace.times))
        self.times[rows] = trace.times - self.begun_s
        last = trace.factors.argmax(axis=1)
        factors = trace.factors[np.arange(len(last)), last]
        for skin, motion in enumerate(self.motion):
            for worlds, seen in trace.motion[skin]:
                # World by world, as whole rows: NumPy takes an index array number by number
                for world, own in zip(worlds.tolist(), seen, strict=True):
                    motion[world, rows] = own
            units = np.array([self._unit(world, skin) for world in trace.worlds.tolist()])
            self.arp[trace.worlds, skin, rows] = trace.factors * units[:, None]
            arp = factors * units
            louder = np.flatnonzero(arp > self.peak_arp[trace.worlds, skin])
            self.peak_arp[trace.worlds[louder], skin] = arp[louder]
            for row in louder.tolist():
                world = int(trace.worlds[row])
                self._note(world, skin, trace.times[last[row]], factors[row])

    def _unit(self, world: int, skin: int) -> float:
        """The highest ARP of a joined world's unit drive on a skin [Pa]."""
        together = self.simulation.together  # type: ignore[union-attr]
        posed, known = together.posed(world), self._units.get((world, skin))
        if known is not None and known[0] is posed:
            return known[1]
        arp = self.runtimes[world].work.radiation.on(posed, skin, "nodes", together.unit(world).copy()).arp
        self._units[world, skin] = posed, float(arp.max())
        return self._units[world, skin][1]

    def _note(self, world: int, skin: int, time_s: float, factor: float) -> None:
        together = self.simulation.together  # type: ignore[union-attr]
        moment = LoudestMoment(float(time_s), together.posed(world), together.unit(world).copy(), float(factor))
        self.loudest[world][skin] = moment

    def _hear(self, world: int, posed: PosedScene, emitted: Emitted, times: Float, rows: slice) -> None:
        """Take what sounds in one world at some times [s]. rows: their places along time"""
        radiation, one = self.runtimes[world].work.radiation, emitted.drives.ndim == 1
        for skin in range(len(self.motion)):
            peaks: NDArray[np.floating]
            if one:
                peaks = emitted.factors * radiation.on(posed, skin, "nodes", emitted.drives).arp.max()
            else:
                peaks = radiation.many(posed, skin, emitted.drives, "nodes").max(axis=1)
            self.arp[world, skin, rows] = peaks
            first = int(peaks.argmax())
            if peaks[first] > self.peak_arp[world, skin]:
                self.peak_arp[world, skin] = peaks[first]
                drive = emitted.drives if one else emitted.drives[first].copy()
                factor = float(emitted.factors[first])
                self.loudest[world][skin] = LoudestMoment(float(times[first]), posed, drive, factor)
