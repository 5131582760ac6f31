"""Points for the force that arrays see: against all transducers one by one, and forces against double precision."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palmfield.acoustics.phased_array import ArrayInstance, PhasedArray
from palmfield.config import ArrayConfig
from palmfield.data import folder
from palmfield.session.simulation import load
from palmfield.simulation.emission import array_drives
from palmfield.simulation.radiation import Radiation
from palmfield.simulation.skin_sound import PADDED_TO, visible
from palmfield.transforms import Placement

HERE = Placement((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0))
TILTED = Placement((0.25, 0.0, 0.1), (0.0, 0.0, -1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0))
SCENES = folder("mjcf") / "scenes"


def arrays(count: int) -> PhasedArray:
    """One array, or another beside it that is tilted."""
    places = (HERE, TILTED)[:count]
    return PhasedArray([ArrayInstance(ArrayConfig(layout="uhev1"), place) for place in places], places, "cpu")


@pytest.fixture(scope="module", params=["approach_withdraw", "palm_am200"])
def hand(request):
    """A hand with bones over the array, and one in one piece."""
    sim = load(SCENES / f"{request.param}.xml", device="cpu", keys={"skin.accuracy": 0.5})
    return sim.runtime, sim.runtime.posed


@pytest.mark.parametrize("count", [1, 2])
@settings(deadline=None)
@given(seed=st.integers(0, 10_000))
def test_nothing_that_a_transducer_sees_is_left_out(count, seed):
    random = np.random.default_rng(seed)
    array = arrays(count)
    points = random.uniform((-0.2, -0.2, -0.1), (0.2, 0.2, 0.4), (200, 3))
    normals = random.normal(size=(200, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    ways = array.array.positions[None] - points[:, None]
    in_front = (np.einsum("ntj,nj->nt", ways, normals) > 0.0).any(axis=1)
    found = visible(points, normals, array)
    assert found[in_front].all()
    # Boxes have corners where a round array has no transducer
    assert np.count_nonzero(found & ~in_front) <= 10


def test_the_force_is_that_of_what_is_seen_in_double_precision(hand, arp64):
    runtime, posed = hand
    model = runtime.model
    [drive] = array_drives(model, posed.arrays)
    place = posed.focal_points(model.stimuli[0], 0)
    emitted = drive.unit_drive(place.at(np.array([0.0, 0.0, 0.2]))).amplitudes
    radiation = runtime.work.radiation
    pushed = radiation.force(posed, 0, radiation.on(posed, 0, "samples", emitted).arp)[0]
    force = (pushed @ posed.array_frame.rotation).sum(axis=0)
    array, air = posed.arrays.array, posed.arrays.air
    points, normals, areas = posed.bodies[0].samples
    arp = arp64(points, normals, array, emitted, air)
    ways = array.positions[None] - points[:, None]
    in_front = (np.einsum("ntj,nj->nt", ways, normals) > 0.0).any(axis=1)
    expected = -(arp * areas * in_front) @ normals
    assert np.linalg.norm(force - expected) < 2e-5 * np.linalg.norm(expected)
    from_behind = -(arp * areas * ~in_front) @ normals
    assert np.linalg.norm(from_behind) < 1e-6 * np.linalg.norm(expected)


def test_they_are_filled_up_by_points_without_area(hand):
    runtime, posed = hand
    points, normals, areas, numbers = Radiation(runtime.model).samples(posed, 0)
    everything = posed.bodies[0].samples[2]
    assert len(points) == len(normals) == len(areas) == len(numbers) < 0.7 * len(everything)
    assert len(points) % PADDED_TO == 0
    assert np.count_nonzero(areas) == np.count_nonzero(visible(*posed.bodies[0].samples[:2], posed.arrays))
    assert np.all(np.diff(np.flatnonzero(areas)) == 1) and np.all(np.diff(numbers) >= 0)
    assert np.array_equal(points, posed.bodies[0].samples[0][numbers])


def test_sound_that_goes_round_a_body_presses_everywhere(hand):
    # Boundary elements on a whole hand take minutes, and what is asked here comes before them
    runtime, posed = hand
    config = runtime.model.skins[0].spec.config.model_copy(update={"body_sound": "scattering"})
    around = SimpleNamespace(skins=[SimpleNamespace(spec=SimpleNamespace(config=config))])
    areas = Radiation(around).samples(posed, 0)[2]
    assert np.array_equal(areas, posed.bodies[0].samples[2]) and areas.all()
