"""Key force_accuracy: the error that it states covers what far denser samples find, and what reads samples follows."""

import numpy as np
import pytest
from trimesh.remesh import subdivide

import palmfield
from palmfield.acoustics.surface_arp import SurfaceArp
from palmfield.data import folder
from palmfield.hand.force_samples import sample_mesh
from palmfield.hand.triangles import face_samples
from palmfield.planning.modelled import modelled
from palmfield.simulation.emission import array_drives

SCENES = folder("mjcf") / "scenes"
ACCURACIES = 0.0015, 0.004, 0.006, 0.012
FOCI = 8


def posed(scene: str, accuracy: float = 0.006, device: str = "cpu") -> palmfield.Simulation:
    keys: dict[str, object] = {"skin.force_accuracy": accuracy}
    sim = palmfield.Simulation(SCENES / f"{scene}.xml", device=device, accuracy=0.5, keys=keys)
    sim.start_at(0.3 * sim.duration_s)
    return sim


@pytest.fixture(scope="module", params=["approach_withdraw", "palm_am200"])
def errors(request):
    """Of the force and the torque on a hand, by accuracy, root mean square over foci on its lit side."""
    sims = {accuracy: posed(request.param, accuracy) for accuracy in ACCURACIES}
    scene = sims[0.006].runtime.posed
    body, model = scene.bodies[0], sims[0.006].runtime.model
    faces = face_samples(*subdivide(*subdivide(body.vertices_in_array, body.faces)))
    evaluator = SurfaceArp(scene.arrays.field, len(faces.areas), model.skins[0].spec.arp_law)
    looking = np.flatnonzero(faces.normals[:, 2] < -0.6)
    arm = np.sqrt(((faces.centroids - body.frame.position) ** 2).sum(axis=1).mean())
    found: dict[float, list[tuple[float, float]]] = {accuracy: [] for accuracy in ACCURACIES}
    for place in np.random.default_rng(5).choice(looking, FOCI):
        drive = array_drives(model, scene.arrays)[0].unit_drive(faces.centroids[place]).amplitudes
        arp = evaluator.evaluate(faces.centroids, faces.normals, drive).arp.astype(np.float64)
        push = -(arp * faces.areas)[:, None] * faces.normals
        force, torque = push.sum(axis=0), np.cross(faces.centroids - body.frame.position, push).sum(axis=0)
        for accuracy, sim in sims.items():
            here = sim.runtime.posed
            radiation = sim.runtime.work.radiation
            pushed = radiation.force(here, 0, radiation.on(here, 0, "samples", drive).arp)
            parts, about = pushed @ here.array_frame.rotation
            own = (about + np.cross(here.bodies[0].origins - body.frame.position, parts)).sum(axis=0)
            off, turned = np.linalg.norm(parts.sum(axis=0) - force), np.linalg.norm(own - torque)
            size = np.linalg.norm(force)
            found[accuracy].append((off / size, turned / (size * arm)))
    yield {accuracy: np.sqrt(np.square(values).mean(axis=0)) for accuracy, values in found.items()}


@pytest.mark.slow
@pytest.mark.parametrize("accuracy", ACCURACIES)
def test_the_error_of_force_and_torque_is_below_what_is_stated(errors, accuracy):
    assert errors[accuracy].max() < accuracy
    # And it is no far cry from it
    assert errors[accuracy][0] > 0.15 * accuracy


def test_fewer_are_taken_for_less():
    counts = [len(posed("approach_withdraw", accuracy).runtime.posed.bodies[0].samples[2]) for accuracy in ACCURACIES]
    assert counts[:2] == [4 * 11448, 11448]
    assert counts[2] < counts[1] / 3.6 and counts[3] < counts[1] / 7.0


@pytest.mark.parametrize("accuracy", ACCURACIES)
def test_samples_have_the_area_of_the_surface_and_lie_on_it(accuracy):
    hand = posed("palm_am200").runtime.model.bodies[0].surface
    made = sample_mesh(hand.vertices, hand.faces, accuracy)
    places, whole = face_samples(made.points, made.corners), face_samples(hand.vertices, hand.faces)
    assert places.areas.sum() == pytest.approx(whole.areas.sum(), rel=0.006)
    # What the sound pushes on from all sides alike stays where it is
    assert np.linalg.norm(places.areas @ places.normals) < 1e-12
    assert np.bincount(made.faces, made.areas) == pytest.approx(whole.areas, rel=1e-9)
    # The volume by the divergence theorem
    volume = [(one.areas * (one.centroids * one.normals).sum(axis=1)).sum() for one in (places, whole)]
    assert volume[0] == pytest.approx(volume[1], rel=0.01)


def test_samples_go_with_the_body():
    """In a hand whose fingers move they follow the skin: the same samples, and about the same area."""
    coarse, every = posed("follow_fingertip", 0.012), posed("follow_fingertip")
    for sim in (coarse, every):
        sim.start_at(0.0)
    first = coarse.runtime.posed.bodies[0]
    rest = face_samples(first.model.sample_mesh.points, first.model.sample_mesh.corners)
    areas = first.samples[2]
    assert len(areas) == len(rest.areas) and not np.allclose(areas, rest.areas, rtol=0.01)
    assert areas.sum() == pytest.approx(every.runtime.posed.bodies[0].samples[2].sum(), rel=0.01)


def test_where_each_face_is_a_sample_it_follows_the_skin_itself():
    body = posed("approach_withdraw", 0.004).runtime.model.bodies[0]
    assert body.sampled is body.hand and body.sample_mesh.corners is body.hand.surface.faces


def test_a_recording_has_the_pressure_on_all_faces():
    """Values at the faces are interpolated between samples; together they push as the samples do."""
    sim = posed("palm_am200")
    model, scene = sim.runtime.model, sim.runtime.posed
    body = scene.bodies[0]
    pressure = 1.0 + body.samples[0][:, 2] / 0.2
    arp = model.skins[0].sample_faces @ pressure
    faces = face_samples(body.vertices_in_array, body.faces)
    pushes = -(arp * faces.areas) @ faces.normals, -(pressure * body.samples[2]) @ body.samples[1]
    assert pushes[0] == pytest.approx(pushes[1], rel=1e-9, abs=1e-9)


def test_the_plan_says_how_many_and_to_what():
    model = posed("palm_am200", 0.012).runtime.model
    sound = modelled(model, 0.1, "")[0]
    count = model.bodies[0].sample_count
    assert count == pytest.approx(len(model.bodies[0].sample_mesh.corners), rel=0.02)
    assert f"about {count} surface samples for the force, error 1.2 % (rms over foci)" in str(sound)
