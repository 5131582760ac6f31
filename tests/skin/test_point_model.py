"""A point's small model against the whole layer: substeps, courses of time, rest."""

import numpy as np
import pytest

from palmfield import SceneError
from palmfield.skin import Sheet, Slab, Spot, preset
from palmfield.skin.fem.body import build
from palmfield.skin.fem.probe import SurfaceProbe
from palmfield.skin.fem.solver import static
from palmfield.skin.fem.traction import PressureHistory
from palmfield.skin.fem.wedge_stepper import WedgeStepper
from palmfield.skin.reduction.point_model import TOLERANCE, WINDOW_S, point_model
from palmfield.skin.solvers.wedges import first_sizes
from palmfield.skin.stepper import SurfaceLoads

HIGHEST_Hz = 200.0


def disc(material: str, base: str = "bonded", side: str = "fixed"):
    """System, a held spot's pressures, force and the middle's readings of a disc."""
    body = Slab((Sheet(preset(material), 0.01),), shape="disc", base=base, side=side, radius_m=0.03)
    load = Spot(0.0103, [0.0], [1.0], law="held")
    system = build(body, first_sizes(body, load, np.zeros((1, 3)), 0.3))
    history = PressureHistory(load, system.mesh, system)
    probe = SurfaceProbe(system.mesh, np.zeros((1, 3)), system).vectors
    pressure = history.loads(np.array([0.0, 1e-3])).pressure_Pa[0, 0]
    return system, history, np.asarray(history.operator @ pressure), probe


@pytest.mark.parametrize(
    ("material", "step_s", "ramp_s"), [("palm", 5e-4, 0.0), ("ecoflex_00-10", 1e-3, 0.0), ("palm", 1e-3, 4e-3)]
)
def test_substeps_of_a_small_model_are_those_of_the_whole_layer(material: str, step_s: float, ramp_s: float) -> None:
    system, history, force, probe = disc(material)
    small = point_model(system, force, probe.toarray()[2], HIGHEST_Hz)
    moved, levels = [], []
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
        levels.append((clock, level))
    substeps = small.stepped(levels[0][1], step_s)[1:]
    exact = small.moved(levels[1][1], levels[1][0])
    assert np.linalg.norm(substeps - moved[0]) <= 2.0 * TOLERANCE * np.linalg.norm(moved[0])
    assert np.linalg.norm(exact[1:] - moved[1]) <= 2.0 * TOLERANCE * np.linalg.norm(moved[1])
    # So that their difference is the error of the substeps
    true = np.linalg.norm(moved[0] - moved[1][15::16]) / np.linalg.norm(moved[1][15::16])
    found = np.linalg.norm(substeps - exact[16::16]) / np.linalg.norm(exact[16::16])
    assert true > 2.0 * TOLERANCE and found == pytest.approx(true, rel=0.2)


def test_it_rests_where_the_layer_rests_and_not_where_nothing_holds_it() -> None:
    system, _, force, probe = disc("palm")
    read = probe.toarray()[2]
    assert point_model(system, force, read, HIGHEST_Hz).static() == pytest.approx(
        read @ static(system, force), rel=1e-4
    )
    system, _, force, probe = disc("palm", base="free", side="free")
    with pytest.raises(SceneError, match="a static solution needs a support"):
        point_model(system, force, probe.toarray()[2], HIGHEST_Hz).static()
