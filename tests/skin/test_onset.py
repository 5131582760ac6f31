"""The error that substeps make of a load's onset, against the substeps themselves."""

import numpy as np
import pytest

from palmfield.skin import Sheet, Slab, Spot, preset
from palmfield.skin.fem.body import build
from palmfield.skin.fem.load import PressureHistory
from palmfield.skin.fem.probe import SurfaceProbe
from palmfield.skin.fem.wedge_stepper import WedgeStepper
from palmfield.skin.reduction.onset import WINDOW_S, onset_error
from palmfield.skin.solvers.wedges import first_sizes
from palmfield.skin.stepper import SurfaceLoads


@pytest.mark.parametrize(
    ("material", "step_s", "ramp_s"), [("palm", 5e-4, 0.0), ("ecoflex_00-10", 1e-3, 0.0), ("palm", 1e-3, 4e-3)]
)
def test_onset_error_is_that_of_the_substeps(material: str, step_s: float, ramp_s: float) -> None:
    body = Slab((Sheet(preset(material), 0.01),), shape="disc", side="fixed", radius_m=0.03)
    load = Spot(0.0103, [0.0], [1.0], law="held")
    system = build(body, first_sizes(body, load, np.zeros((1, 3)), 0.3))
    history = PressureHistory(load, system.mesh, system)
    probe = SurfaceProbe(system.mesh, np.zeros((1, 3)), system).vectors
    moved = []
    for step in (step_s, step_s / 16.0):
        stepper = WedgeStepper(system, history.operator, step)
        reader, state = stepper.reader(probe), np.zeros((1, stepper.state_size))
        clock = step * np.arange(round(WINDOW_S / step) + 1)
        level = 0.5 - 0.5 * np.cos(np.pi * np.clip(clock / ramp_s, 0.0, 1.0)) if ramp_s > 0.0 else np.ones(len(clock))
        loads = history.loads(clock)
        scaled = SurfaceLoads(
            loads.pressure_Pa, loads.first * level[None, :-1, None], loads.last * level[None, 1:, None]
        )
        seen = stepper.step(state, scaled, clock[0], clock[-1], reader)
        assert seen is not None
        moved.append(seen[0][:, 0, 2])
    coarse, fine = moved[0], moved[1][15::16]
    true = np.linalg.norm(coarse - fine) / np.linalg.norm(fine)
    force, read = history.operator @ history.loads(np.array([0.0, step_s])).pressure_Pa[0, 0], probe.toarray()[2]
    found = onset_error(system, np.asarray(force), read, step_s, ramp_s)
    print(material, step_s, ramp_s, true, found)
    assert true <= found <= 2.5 * true
