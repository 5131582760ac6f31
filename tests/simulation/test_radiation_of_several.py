"""Several stimuli at once: fields computed once for each and added up, against the drive of each moment by itself."""

import numpy as np
import pytest

import palmfield
from palmfield.data import folder
from palmfield.drive.transducer_response import rows
from palmfield.simulation.radiation import Radiation

pytestmark = pytest.mark.usefixtures("kept_operators")

SCENES = folder("mjcf") / "scenes"


@pytest.fixture(scope="module")
def hands():
    """Two hands that both feel a stimulus of their own; what sounds over the next step."""
    sim = palmfield.Simulation(SCENES / "two_hands_both_feel.xml", device="cpu", accuracy=0.5)
    sim.run(0.003)
    runtime = sim.runtime
    posed, emitted = runtime.posed, runtime.amplitudes
    _, course = runtime.work.emission.over(posed, emitted, sim.data.time, runtime.model.substeps)
    yield runtime, posed, course
    del sim  # MuJoCo's data hold the state


@pytest.mark.parametrize("role", ["quadrature", "samples"])
@pytest.mark.parametrize("skin", [0, 1])
def test_sums_are_what_each_moments_drive_gives(hands, skin, role):
    runtime, posed, course = hands
    assert len(course.units) == 2 < len(course.levels)
    sums = Radiation(runtime.model).sums(posed, skin, course.units, course.levels, role)
    moment_by_moment = Radiation(runtime.model).many(posed, skin, rows(course), role)
    np.testing.assert_allclose(sums, moment_by_moment, atol=3e-6 * moment_by_moment.max())
    assert np.ptp(moment_by_moment, axis=0).max() > 1.0


def test_the_mean_force_is_that_of_each_moments_drive(hands):
    runtime, posed, _ = hands
    emission, emitted = runtime.work.emission, runtime.amplitudes
    mean = emission.mean_drives(posed, emitted, runtime.view.raw.time)
    assert len(mean.units) == 2  # as many as there are stimuli
    moments, course = emission.over(posed, emitted, runtime.view.raw.time, runtime.model.substeps)
    weights = 0.5 * (moments.first + moments.last).sum(axis=0) / runtime.model.substeps
    turn = posed.array_frame.rotation
    for body, (force, _) in enumerate(runtime.body_forces()):
        radiation = Radiation(runtime.model)
        arp = weights @ radiation.many(posed, body, rows(course), "samples")
        _, normals, areas, _ = radiation.samples(posed, body)
        whole = -(arp * areas) @ normals @ turn.T
        np.testing.assert_allclose(force.sum(axis=0), whole, atol=1e-5 * np.linalg.norm(whole))


@pytest.mark.nightly
def test_the_mean_force_is_that_over_all_moments():
    """Of a modulation as fast as the moments at which the load is known: some of them alone would be off by a third."""
    keys: dict[str, object] = {f"{side}_focus.am_frequency_Hz": 1000.0 for side in ("right", "left")}
    keys |= {f"{side}_focus.am_quantity": "amplitude" for side in ("right", "left")}
    keys |= {f"{side}_palm.step_s": 1e-4 for side in ("right", "left")}
    sim = palmfield.Simulation(SCENES / "two_hands_both_feel.xml", device="cpu", accuracy=0.5, keys=keys)
    sim.run(0.004)
    runtime, work = sim.runtime, sim.runtime.work
    posed, emitted, now = runtime.posed, runtime.amplitudes, sim.data.time
    moments, course = work.emission.over(posed, emitted, now, runtime.model.substeps)
    weights = 0.5 * (moments.first + moments.last).sum(axis=0) / runtime.model.substeps
    [(force, _), _] = runtime.body_forces()
    radiation = Radiation(runtime.model)
    arp = weights @ radiation.many(posed, 0, rows(course), "samples")
    _, normals, areas, _ = radiation.samples(posed, 0)
    whole = -(arp * areas) @ normals @ posed.array_frame.rotation.T
    assert np.linalg.norm(whole) > 2e-4
    np.testing.assert_allclose(force.sum(axis=0), whole, atol=1e-5 * np.linalg.norm(whole))
