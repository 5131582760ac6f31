"""Error estimates of finished runs, and the band from an uncertain p0."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy import sparse

import palmfield
from palmfield.estimate.array_inputs import p0_band, p0_known
from palmfield.estimate.cost import FINER_BELOW
from palmfield.estimate.numerical_error import SteppedRun, error_estimate
from palmfield.estimate.numerics.load_course import LoadCourse
from palmfield.estimate.numerics.loudest_sound import LoudestSound
from palmfield.estimate.numerics.mesh_error import meshes_to_compare
from palmfield.estimate.numerics.point_response import Response, points_of_spot
from palmfield.session.loudest_moment import place_under_focus
from palmfield.simulation.emission import array_drives
from palmfield.simulation.radiation import Radiation
from palmfield.simulation.small_models import known_load
from palmfield.skin.fem.solver import harmonic, static
from palmfield.skin.fem.wedge_stepper import WedgeStepper
from palmfield.skin.reduction.reduced_stepper import ReducedStepper
from palmfield.skin.stepper import SurfaceLoads
from palmfield.stimulus.schedule import frames_at

STEADY = {"modulation": "none", "am_quantity": None, "am_frequency_Hz": None, "am_depth": None}
SCENES = Path(__file__).parents[2] / "mjcf" / "scenes"
SOURCES = ("mesh", "step", "reduction", "edge")


def estimate(scene, loudest, skin=0, left_small_model=False, end_s=math.inf):
    model = scene.runtime.model
    return error_estimate(model, skin, loudest, Radiation(model), SteppedRun(left_small_model, end_s=end_s))


def unit(scene, **changes):
    """ARP at the skin's quadrature points for the focus of the first stimulus [Pa]."""
    model = scene.runtime.model
    drive = array_drives(model, model.arrays)[0].unit_drive(model.stimuli[0].reference_foci).amplitudes
    return Radiation(model).on(scene.runtime.work.reference, 0, "quadrature", drive).arp.astype(float)


def test_halving_p0_quarters_the_displacement(small_scene):
    peaks = []
    for p0 in (2.0, 1.0):
        scene = palmfield.load(small_scene(array={"p0_Pa_m": p0}))
        layer = scene.runtime.model.skins[0].layer
        settled = static(layer.system, layer.quadrature.operator @ unit(scene))
        peaks.append(np.abs(layer.surface_operator @ settled).max())
    assert peaks[0] / peaks[1] == pytest.approx(4, rel=1e-4)


@pytest.mark.nightly
def test_the_mesh_error_is_about_the_distance_to_a_fine_mesh(small_scene, moment):
    """The estimate against the answer on elements of half the size, both static and at 200 Hz."""
    scene = palmfield.load(small_scene())
    scene.step(3)
    loudest = moment(scene)
    errors = estimate(scene, loudest)
    model = scene.runtime.model
    point = np.zeros(3)
    answers = []
    for layer in (model.skins[0].layer, model.skins[0].layer.resized(0.5)):
        points, normals = layer.quadrature.points, layer.quadrature.normals
        body = loudest.posed.bodies[0]
        arp = Radiation(model).at(
            loudest.posed, 0, "probe", body.frame.points(points), body.frame.vectors(normals), loudest.drive
        )
        force, read = layer.quadrature.operator @ arp.arp.astype(float), layer.probe(point).operator
        answers.append([(read @ static(layer.system, force))[0], (read @ harmonic(layer.system, force, 200.0))[0]])
    true = np.max(np.abs(np.array(answers[0]) - answers[1]) / np.abs(answers[1]))
    assert 0.3 * true < errors["mesh_error_relative"] < 3.0 * true


@pytest.mark.nightly
def test_a_disc_of_few_rings_is_held_against_a_mesh_that_differs(small_scene, moment):
    """Elements of 0.8 times the size make the same rings of a disc of 13 mm, which told a fortieth of the error."""
    disc = {"radius_m": 0.0129, "thickness_m": 0.00313, "side": "roller", "base": "free_slip", "accuracy": 0.12}
    scene = palmfield.load(small_scene(skin=disc | {"material": "finger_pad"}))
    scene.step(3)
    loudest = moment(scene)
    layer, model, point = scene.runtime.model.skins[0].layer, scene.runtime.model, np.zeros(3)
    answers = []
    for each in (layer, layer.resized(0.35)):
        points, normals = each.quadrature.points, each.quadrature.normals
        body = loudest.posed.bodies[0]
        places, outward = body.frame.points(points), body.frame.vectors(normals)
        arp = Radiation(model).at(loudest.posed, 0, "probe", places, outward, loudest.drive).arp.astype(float)
        answers.append((each.probe(point).operator @ static(each.system, each.quadrature.operator @ arp))[0])
    true = abs(answers[0] - answers[1]) / abs(answers[1])
    assert true > 0.01
    assert estimate(scene, loudest)["mesh_error_relative"] > true


def test_errors_add_up_by_squares_and_a_disc_has_no_cut_edge(small_scene, moment):
    scene = palmfield.load(small_scene())
    scene.step(3)
    errors = estimate(scene, moment(scene))
    parts = [errors[f"{source}_error_relative"] for source in SOURCES]
    assert errors["displacement_error_relative"] == pytest.approx(np.hypot.reduce(parts))
    assert errors["edge_error_relative"] == 0.0 and errors["reduction_error_relative"] == 0.0
    assert errors["step_error_relative"] > 0.0


@pytest.mark.nightly
def test_a_small_model_has_an_error_of_its_own_and_none_of_the_step(small_scene, moment):
    scene = palmfield.load(small_scene(), keys={"skin.solver": "reduced"})
    scene.step(3)
    small = scene.runtime.model.begin[0].value
    assert isinstance(small, ReducedStepper)
    errors = estimate(scene, moment(scene))
    assert errors["reduction_error_relative"] >= small.error > 0.0
    step_s = scene.runtime.model.step_s
    assert errors["step_error_relative"] == pytest.approx(1.0 - np.sinc(200.0 * step_s) ** 2)
    left = estimate(scene, moment(scene), left_small_model=True)
    whole = palmfield.load(small_scene(), keys={"skin.solver": "wedges"})
    assert left["step_error_relative"] == pytest.approx(estimate(whole, moment(scene))["step_error_relative"])


@pytest.mark.nightly
def test_a_skin_beside_another_is_estimated_as_if_alone(small_scene, add_skin, moment):
    """Exchanging one layer leaves the other skin, and the answer, as they were."""
    alone = palmfield.load(small_scene())
    alone.step(3)
    expected = estimate(alone, moment(alone))
    both = palmfield.load(add_skin(small_scene(), "0.1 0 0.12"))
    both.step(3)
    for key, value in estimate(both, moment(both)).items():
        assert value == pytest.approx(expected[key], rel=1e-4), key
    other = estimate(both, moment(both), skin=1)
    assert all(np.isfinite(value) for value in other.values())


@pytest.mark.parametrize(("rows", "accuracy"), [(2, 0.05), pytest.param(3, 0.02, marks=pytest.mark.nightly)])
def test_the_other_mesh_is_coarser_where_a_finer_one_costs_too_much(small_scene, moment, rows, accuracy):
    """With as many rows of elements; another number of rows shows their error."""
    scene = palmfield.load(small_scene(skin={"element_m": 0.0018, "accuracy": accuracy}))
    scene.step(3)
    loudest, model = moment(scene), scene.runtime.model
    own = model.skins[0].layer
    assert len(own.sizes.depth_fractions) - 1 == rows and own.dofs > FINER_BELOW
    stated = estimate(scene, loudest)["mesh_error_relative"]
    sound, answers = LoudestSound(model, 0, loudest, Radiation(model)), []
    for layer in (own, own.resized(0.7, rows + 1)):
        force, read = layer.quadrature.operator @ sound.on(layer), layer.probe(np.zeros(3)).operator
        answers.append([(read @ static(layer.system, force))[0], (read @ harmonic(layer.system, force, 200.0))[0]])
    true = np.max(np.abs(np.array(answers[0]) - answers[1]) / np.abs(answers[1]))
    assert true < stated < 6.0 * true


def test_force_on_a_mesh_of_large_faces(small_scene):
    """A box of twelve faces feels the force that the fine skin on its lit face adds up to."""
    path = small_scene(
        stimulus=STEADY,
        skin={"shape": "mesh", "mesh": "box.obj", "mesh_unit": "mm", "patch_site": "centre", "patch_radius_m": 0.028,
              "radius_m": None, "thickness_m": None, "element_m": 0.004},
    )  # fmt: skip
    box = trimesh.creation.box((60, 60, 30))
    box.apply_translation((0, 0, -15))
    box.export(path.with_name("box.obj"))
    scene = palmfield.load(path)
    model, posed = scene.runtime.model, scene.runtime.work.reference
    drive = array_drives(model, model.arrays)[0].unit_drive(model.stimuli[0].reference_foci).amplitudes
    on_patch = float(unit(scene) @ model.skins[0].layer.quadrature.weights)
    radiation = Radiation(model)
    force, _ = radiation.force(posed, 0, radiation.on(posed, 0, "samples", drive).arp)
    # The array looks up and the box down; side lobes beyond the patch add a little.
    assert 1.0 < force.sum(axis=0)[2] / on_patch < 1.08


def test_the_band_is_that_of_the_arrays_that_a_stimulus_drives(small_scene, add_array):
    """Each stimulus with an array of its own: the one with a range has its range, whatever the other."""
    keys = (
        '<config key="p0_Pa_m" value="4"/><config key="p0_low_Pa_m" value="2"/><config key="p0_high_Pa_m" value="8"/>'
    )
    path = add_array(small_scene(stimulus=STEADY), keys)
    text = path.read_text()
    begin = text.index('<instance name="stimulus">')
    end = text.index("</instance>", begin) + len("</instance>")
    twin = text[begin:end].replace('name="stimulus"', 'name="other"')
    twin = twin.replace("</instance>", '<config key="arrays" value="second"/></instance>')
    path.write_text(text[:end] + twin + text[end:])
    model = palmfield.load(path).runtime.model
    other = next(i for i, stimulus in enumerate(model.stimuli) if stimulus.spec.name == "other")
    assert [p0.value for p0 in p0_known(model, other)] == [4.0]
    assert p0_band(model, other) == pytest.approx((0.25, 4.0))
    assert [p0.value for p0 in p0_known(model, 1 - other)] == [1.27]
    assert p0_band(model, 1 - other) == pytest.approx(((0.7 / 1.27) ** 2, (2.6 / 1.27) ** 2))


def test_a_silent_moment_never_gets_here(small_scene, moment):
    scene = palmfield.load(small_scene())
    scene.step(3)
    quiet = replace(moment(scene), drive=np.zeros(256, complex))
    with pytest.raises(palmfield.SceneError, match="that are not 0"):
        estimate(scene, quiet)


def test_a_sudden_start_counts_what_the_substeps_make_of_it(small_scene, moment) -> None:
    """Steps of a quarter of a period, against a sixteenth of them, on one mesh from rest."""
    keys = {"accuracy": 0.3, "radius_m": 0.015, "element_m": 0.006, "step_s": 1e-3, "solver": "wedges"}
    sudden = small_scene(stimulus=STEADY, array={"response": "off"}, skin=keys)
    scene = palmfield.load(sudden)
    scene.step(3)
    layer = scene.runtime.model.skins[0].layer
    force, read = layer.quadrature.operator @ unit(scene), layer.probe(np.zeros(3)).operator
    courses = []
    for step_s in (layer.step_s, layer.step_s / 16.0):
        count = round(0.05 / step_s)
        stepper = WedgeStepper(layer.system, sparse.csr_matrix(force[:, None]), step_s)
        state, held = np.zeros((1, stepper.state_size)), np.ones((1, count, 1))
        loads = SurfaceLoads(np.ones((1, 1, 1)), held, held)
        seen = stepper.step(state, loads, 0.0, count * step_s, stepper.reader(read))
        courses.append(seen[0, :, 0, 0])
    fine = courses[1][15::16]
    true = np.linalg.norm(courses[0] - fine) / np.linalg.norm(fine)
    assert true > 0.02
    stated = estimate(scene, moment(scene), end_s=0.05)["step_error_relative"]
    assert 0.8 * true < stated < 1.5 * true


def on_phantom(scene: str, **skin):
    """A disc over the array of a shipped scene, and its force on the unknowns of any of its meshes."""
    keys = {f"skin.{key}" if "." not in key else key: value for key, value in skin.items()}
    simulation = palmfield.load(SCENES / f"{scene}.xml", keys=keys)

    def force(layer):
        model, posed = simulation.runtime.model, simulation.runtime.work.reference
        drive, frame = array_drives(model, model.arrays)[0], posed.bodies[0].frame
        amplitudes = drive.unit_drive(model.stimuli[0].reference_foci).amplitudes
        places, outward = frame.points(layer.quadrature.points), frame.vectors(layer.quadrature.normals)
        arp = Radiation(model).at(posed, 0, "probe", places, outward, amplitudes).arp
        return layer.quadrature.operator @ arp.astype(float)

    return simulation, force


def test_a_skin_that_rings_is_stated_to_ring(moment) -> None:
    """Gelatin between rollers swings on after its start: rest and 67 Hz are right to 3 %, the motion is not."""
    scene, force = on_phantom(
        "phantom_am200", radius_m=0.01279, thickness_m=0.00947, side="roller", material="gelatin_2", accuracy=0.1031,
        **{"stimulus.am_frequency_Hz": 67.5, "stimulus.am_quantity": "arp", "stimulus.am_depth": 0.536},
    )  # fmt: skip
    own = scene.runtime.model.skins[0].layer
    config, courses = scene.runtime.model.stimuli[0].config, []
    for layer, step_s in ((own, 5e-5), (own.resized(0.45), 5e-5)):
        stepper = WedgeStepper(layer.system, sparse.csr_matrix(force(layer)[:, None]), step_s)
        level = frames_at(config, step_s * np.arange(481))[1]
        loads = SurfaceLoads(np.ones((1, 1, 1)), level[None, :-1, None], level[None, 1:, None])
        reader = stepper.reader(layer.probe(np.zeros(3)).operator)
        seen = stepper.step(np.zeros((1, stepper.state_size)), loads, 0.0, 480 * step_s, reader)
        courses.append(seen[0, :, :, 0])
    true, of_velocity = np.linalg.norm(courses[0] - courses[1], axis=0) / np.linalg.norm(courses[1], axis=0)
    scene.step(24)
    errors = estimate(scene, moment(scene), end_s=0.024)
    assert true > 0.08 and of_velocity > 1.3 * true
    assert true < errors["mesh_error_relative"] < 4.0 * true
    assert of_velocity < errors["mesh_velocity_error_relative"] < 4.0 * of_velocity
    parts = [errors[f"{source}_velocity_error_relative"] for source in SOURCES]
    assert errors["velocity_error_relative"] == pytest.approx(np.hypot.reduce(parts))


@pytest.mark.parametrize("response", ["off", "on"])
def test_the_load_of_a_moving_focus_is_the_sound_of_its_places(small_scene, moment, response) -> None:
    """Against the emission of the scene at moments between the places."""
    path = {"path": "circle", "path_diameter_m": 0.012, "path_rate_Hz": 60.0} | STEADY
    scene = palmfield.load(small_scene(stimulus=path, array={"response": response}))
    scene.step(5)
    model, loudest = scene.runtime.model, moment(scene)
    load, layer = LoadCourse(model, 0, loudest, 0.03), model.skins[0].layer
    course = load.at(1e-4)
    arp = course.factors @ LoudestSound(model, 0, loudest, Radiation(model), load.drives).along(layer)
    times = np.array([83, 171, 262])
    drives = known_load.steady_drives(model, 0, loudest.posed, 1e-4, 0, 300)[times]
    expected = Radiation(model).many(loudest.posed, 0, drives).astype(float)
    mine = arp[times] * np.linalg.norm(expected) / np.linalg.norm(arp[times])
    off = np.linalg.norm(mine - expected, axis=1) / np.linalg.norm(expected, axis=1)
    assert course.path and off.max() < (0.02 if response == "off" else 0.12)
    fixed = LoadCourse(model, 0, loudest, 0.03, moves=False)
    assert fixed.drives is None and fixed.at(1e-4).factors.shape == (301, 1)


@pytest.mark.nightly
def test_errors_that_cancel_under_the_focus_are_seen_about_it(moment) -> None:
    """On this palm two meshes agree in the middle of the spot; 2.5 mm away they differ by 1 to 2 %."""
    keys = {
        "array.response": "off", "skin.material": "finger_pad", "stimulus.frame": "palm_centre",
        "stimulus.focus_m": (-0.0022027, 0.0026763, 0.0), "stimulus.arp_peak_Pa": 4.219,
        "stimulus.am_frequency_Hz": 226.0, "stimulus.am_quantity": "arp",
    }  # fmt: skip
    scene = palmfield.load(SCENES / "palm_am200.xml", keys=keys)
    scene.step(8)
    model, loudest = scene.runtime.model, moment(scene)
    layer, sound = model.skins[0].layer, LoudestSound(model, 0, loudest, Radiation(model))
    points = points_of_spot(layer, place_under_focus(model, 0, loudest))
    answers = []
    for each in (layer, layer.resized(1.0 / 1.7, 4)):
        still = static(each.system, each.quadrature.operator @ sound.on(each))
        answers.append(each.probe(points).operator @ still)
    true = np.linalg.norm(answers[0] - answers[1]) / np.linalg.norm(answers[1])
    middle = abs(answers[0][0] / answers[1][0] - 1.0)
    assert true > 2.0 * middle
    assert true < estimate(scene, loudest)["mesh_error_relative"] < 4.0 * true


@pytest.mark.nightly
def test_a_disc_that_is_right_by_chance_is_held_against_two_meshes(moment) -> None:
    """Elements of 0.64 times the size are farther from the truth than this disc's, of 0.41 half as far."""
    scene, force = on_phantom(
        "phantom_am200", radius_m=0.02965, thickness_m=0.003114, side="roller", material="finger_pad",
        accuracy=0.0883, **{"stimulus.am_frequency_Hz": 55.5},
    )  # fmt: skip
    own = scene.runtime.model.skins[0].layer
    coarse, middle, fine = (
        (layer.probe(np.zeros(3)).operator @ static(layer.system, force(layer)))[0]
        for layer in (own, own.resized(0.5), own.resized(0.35))
    )
    settled = fine + (fine - middle) / ((0.5 / 0.35) ** 2 - 1.0)
    scene.step(3)
    assert abs(coarse - settled) > 0.025 * abs(settled)
    assert estimate(scene, moment(scene))["mesh_error_relative"] > abs(coarse - settled) / abs(settled)


def test_a_disc_that_nothing_holds_sideways_has_an_estimate(small_scene, moment) -> None:
    """Free sides on a base that slips: it has no rest, and an error over time and at the main frequency."""
    scene = palmfield.load(small_scene(skin={"side": "free", "base": "free_slip"}))
    scene.step(3)
    errors = estimate(scene, moment(scene), end_s=0.02)
    assert not scene.runtime.model.skins[0].layer.system.supported
    assert 0.0 < errors["displacement_error_relative"] < 0.5


def box_scene(small_scene, **skin):
    """A patch on the lit face of a box, on springs."""
    path = small_scene(
        stimulus=STEADY,
        skin={"shape": "mesh", "mesh": "box.obj", "mesh_unit": "mm", "patch_site": "centre", "patch_radius_m": 0.02,
              "radius_m": None, "thickness_m": None, "element_m": 0.005} | skin,
    )  # fmt: skip
    box = trimesh.creation.box((60, 60, 30))
    box.apply_translation((0, 0, -15))
    box.export(path.with_name("box.obj"))
    return path


@pytest.mark.nightly
def test_a_cut_edge_counts_at_rest_as_well(small_scene, moment):
    """Half of what a free side changes, at rest or at the main frequency, of whole solutions on the coarser mesh."""
    keys = {"base": "springs", "base_normal_Pa_m": 3e5, "base_tangential_Pa_m": 3e4, "side": "fixed"}
    scene = palmfield.load(box_scene(small_scene, **keys))
    scene.step(3)
    found = estimate(scene, moment(scene))["edge_error_relative"]
    own = scene.runtime.model.skins[0].layer
    layer, frequency = meshes_to_compare(own, finer=False).other, own.demand.main_frequency_Hz
    load = LoudestSound(scene.runtime.model, 0, moment(scene), Radiation(scene.runtime.model)).on(layer)
    still, swung = [], []
    for one in (layer, layer.altered(side="free")):
        force, read = one.quadrature.operator @ load, one.probe(np.zeros(3)).operator
        still.append((read @ static(one.system, force))[0])
        swung.append((read @ harmonic(one.system, force, frequency))[0])
    changes = [0.5 * abs(other - own) / abs(own) for own, other in (still, swung)]
    assert changes[0] > 1.2 * changes[1]
    assert found == pytest.approx(changes[0], rel=0.02)


def test_a_layer_that_only_its_cut_edge_holds_is_known_to_nothing(small_scene, moment):
    scene = palmfield.load(box_scene(small_scene, base="free", side="fixed"))
    scene.step(3)
    assert estimate(scene, moment(scene))["edge_error_relative"] == 1.0


def test_matrices_of_other_meshes_are_freed_and_those_of_the_scene_kept(small_scene, moment) -> None:
    scene = palmfield.load(small_scene())
    scene.step(3)
    own = scene.runtime.model.skins[0].layer
    sound = LoudestSound(scene.runtime.model, 0, moment(scene), Radiation(scene.runtime.model))
    assert own.system.matrices.made
    for layer, kept in ((own, True), (own.resized(1.5), False)):
        response = Response(layer, sound.on(layer), np.zeros(3))
        response.solve()
        assert response.harmonic != 0.0 and layer.system.matrices.made == kept
