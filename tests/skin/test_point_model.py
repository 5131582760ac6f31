"""A point's small model against the whole layer: rest, harmonic motion, substeps, courses of time."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse

from palmfield import SceneError, cache
from palmfield.skin import Sheet, Slab, Spot, Springs, preset
from palmfield.skin.fem.assembly import assemble
from palmfield.skin.fem.body import build
from palmfield.skin.fem.probe import SurfaceProbe
from palmfield.skin.fem.solver import harmonic, harmonic_discrete, static
from palmfield.skin.fem.traction import PressureHistory
from palmfield.skin.fem.wedge_stepper import WedgeStepper
from palmfield.skin.materials.material import Material
from palmfield.skin.reduction import reducer as module
from palmfield.skin.reduction.reducer import TOLERANCE, WINDOW_S, Course, point_model
from palmfield.skin.solvers.wedges import first_sizes
from palmfield.skin.stepper import SurfaceLoads

MAIN_Hz, HIGHEST_Hz = 100.0, 200.0
STEP_s = 2.5e-4


def disc(*materials: str | Material, base: str = "bonded", side: str = "fixed"):
    """System, a held spot's pressures, force and the middle's readings of a disc of equally thick sheets."""
    sheets = [preset(each) if isinstance(each, str) else each for each in materials]
    body = Slab(
        tuple(Sheet(each, 0.01 / len(sheets)) for each in sheets), shape="disc", base=base, side=side, radius_m=0.03
    )
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
    (small,) = point_model(system, force, probe.toarray()[2], MAIN_Hz, HIGHEST_Hz)
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
    substeps = small.stepped(Course(levels[0][0], levels[0][1][:, None]))[0, 1:, 0]
    exact = small.moved(Course(levels[1][0], levels[1][1][:, None]))[0, :, 0]
    assert np.linalg.norm(substeps - moved[0]) <= 2.0 * TOLERANCE * np.linalg.norm(moved[0])
    assert np.linalg.norm(exact[1:] - moved[1]) <= 2.0 * TOLERANCE * np.linalg.norm(moved[1])
    # So that their difference is the error of the substeps
    true = np.linalg.norm(moved[0] - moved[1][15::16]) / np.linalg.norm(moved[1][15::16])
    found = np.linalg.norm(substeps - exact[16::16]) / np.linalg.norm(exact[16::16])
    assert true > 2.0 * TOLERANCE and found == pytest.approx(true, rel=0.2)


def test_it_rests_where_the_layer_rests_and_not_where_nothing_holds_it() -> None:
    system, _, force, probe = disc("palm")
    read = probe.toarray()[2]
    (small,) = point_model(system, force, read, MAIN_Hz, HIGHEST_Hz)
    assert small.static() == pytest.approx(read @ static(system, force), rel=1e-4)
    system, _, force, probe = disc("palm", base="free", side="free")
    with pytest.raises(SceneError, match="a static solution needs a support"):
        point_model(system, force, probe.toarray()[2], MAIN_Hz, HIGHEST_Hz)[0].static()


def whole(system, force, read, f_Hz):
    """The response of the whole layer: at rest, harmonic, and by substeps."""
    fields = static(system, force), harmonic(system, force, f_Hz), harmonic_discrete(system, force, f_Hz, STEP_s)
    return np.array([read @ field for field in fields])


def in_model(small, f_Hz):
    return np.concatenate([small.static(), small.harmonic(f_Hz), small.discrete(f_Hz, STEP_s)])


@pytest.mark.parametrize(("base", "side"), [("bonded", "fixed"), ("bonded", "absorbing"), ("free_slip", "roller")])
@pytest.mark.parametrize("f_Hz", [30.0, 100.0, 200.0, 400.0])  # the last is above HIGHEST_Hz
def test_it_swings_as_the_whole_layer(base: str, side: str, f_Hz: float) -> None:
    system, _, force, probe = disc("palm", base=base, side=side)
    read = probe.toarray()[2]
    (small,) = point_model(system, force, read, f_Hz, HIGHEST_Hz)
    expected = whole(system, force, read, f_Hz)
    assert abs(expected[2] - expected[1]) > 1e-4 * abs(expected[1])
    np.testing.assert_allclose(in_model(small, f_Hz), expected, rtol=0.5 * TOLERANCE)


def test_several_points_and_a_path_move_as_in_the_whole_layer() -> None:
    """Displacement and velocity of five points under one force, and of the first one under forces of a path."""
    system, _, force, _ = disc("palm")
    points = 3e-3 * np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.5, 0.0]])
    read = SurfaceProbe(system.mesh, points, system).operator.toarray()
    places = [[3e-3 * k, 2e-3 * k, 0.0] for k in (-2, 1, 3)]
    path = np.column_stack(
        [
            np.asarray(history.operator @ history.loads(np.array([0.0, 1e-3])).pressure_Pa[0, 0])
            for place in places
            for history in [PressureHistory(Spot(0.0103, [0.0], [1.0], [place[:2]], "held"), system.mesh, system)]
        ]
    )
    (small,) = point_model(system, force, read, MAIN_Hz, HIGHEST_Hz, path=path)
    np.testing.assert_allclose(small.harmonic(MAIN_Hz), read @ harmonic(system, force, MAIN_Hz), rtol=TOLERANCE)
    expected = [read[0] @ harmonic(system, column, MAIN_Hz) for column in path.T]
    np.testing.assert_allclose(small.of_path(MAIN_Hz), expected, rtol=TOLERANCE)
    # From rest, with the focus at each place in turn
    times = STEP_s * np.arange(121)
    factors = np.maximum(1.0 - np.abs(times[:, None] / 0.01 - np.arange(3)), 0.0)
    factors *= 0.5 - 0.5 * np.cos(np.pi * np.minimum(times[:, None] / 0.004, 1.0))
    stepper = WedgeStepper(system, sparse.csr_matrix(path), STEP_s)
    loads = SurfaceLoads(np.eye(3)[None], factors[None, :-1], factors[None, 1:])
    reader = stepper.reader(sparse.csr_matrix(read[:1]))
    seen = stepper.step(np.zeros((1, stepper.state_size)), loads, 0.0, times[-1], reader)
    assert seen is not None
    moved = small.stepped(Course(times, factors, path=True))[:, 1:, 0]
    off = np.linalg.norm(moved - seen[0, :, :, 0].T, axis=1) / np.linalg.norm(seen[0, :, :, 0], axis=0)
    # The vectors are chosen for displacements; velocities have more of the fast waves
    assert off[0] < 2.0 * TOLERANCE and off[1] < 0.05


def scaled(material: Material, factor: float) -> Material:
    branches = tuple(replace(one, shear_Pa=factor * one.shear_Pa) for one in material.branches)
    return replace(material, shear_relaxed_Pa=factor * material.shear_relaxed_Pa, branches=branches)


@pytest.mark.parametrize("factors", [(0.6, 0.6), (1.7, 1.7), (0.6, 1.7), (1.7, 0.6)])
def test_other_materials_on_the_same_mesh_swing_as_they_do_alone(factors: tuple[float, float]) -> None:
    """Two sheets whose moduli change together, and one against the other."""
    sheets = preset("palm"), preset("finger_pad")
    changed = [scaled(sheet, factor) for sheet, factor in zip(sheets, factors, strict=True)]
    (system, _, force, probe), (other, _, same, _) = disc(*sheets), disc(*changed)
    np.testing.assert_array_equal(same, force)
    read = probe.toarray()[2]
    _, small = point_model(system, force, read, MAIN_Hz, HIGHEST_Hz, [other])
    expected = whole(other, force, read, MAIN_Hz)
    assert abs(expected[1]) != pytest.approx(abs(whole(system, force, read, MAIN_Hz)[1]), rel=0.1)
    np.testing.assert_allclose(in_model(small, MAIN_Hz), expected, rtol=0.01)


def test_matrices_of_another_material_are_multiples_only_if_nothing_else_differs() -> None:
    palm = preset("palm")
    other = replace(scaled(palm, 0.6), density_kg_m3=1.1 * palm.density_kg_m3, bulk_Pa=0.9 * palm.bulk_Pa)
    system, changed = (disc(material)[0] for material in (palm, other))
    factors = system.scaled_by(changed)
    assert factors == pytest.approx([1.1, 1.0, 0.9, 0.6])
    for factor, name in zip(factors, ("mass", "damping", "elastic"), strict=False):
        difference = factor * getattr(system, name) - getattr(changed, name)
        assert abs(difference).sum() <= 1e-13 * abs(getattr(changed, name)).sum()
    (part,), (expected,) = system.parts, changed.parts
    assert abs(factors[3] * part.stiffness - expected.stiffness).sum() <= 1e-13 * abs(expected.stiffness).sum()
    relaxing = replace(palm, bulk_relaxes=True)
    for one, another in (
        (system, disc(palm, palm)[0]),
        (system, disc(palm, other)[0]),
        (system, disc(other, side="free")[0]),
        (system, disc(relaxing)[0]),
        (disc(relaxing)[0], disc(replace(relaxing, shear_relaxed_Pa=2.0 * palm.shear_relaxed_Pa))[0]),
        *((disc(palm, **held)[0], disc(other, **held)[0]) for held in ({"base": Springs(1e6, 1e6)},)),
    ):
        assert one.scaled_by(another) is None


def test_a_sponge_is_more_than_a_material() -> None:
    palm = preset("palm")
    mesh = disc(palm)[0].mesh
    sponge = np.ones(len(mesh.surface_triangles6))
    one, another = (assemble(mesh, each, sponge_1_s=sponge) for each in (palm, scaled(palm, 0.6)))
    assert one.scaled_by(another) is None


def test_the_same_load_at_another_level_needs_no_factor(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("PALMFIELD_CACHE", str(tmp_path))
    system, _, force, probe = disc("palm")
    read = probe.toarray()[2]
    (first,) = point_model(system, force, read, MAIN_Hz, HIGHEST_Hz)
    monkeypatch.setattr(module, "Krylov", lambda *_: pytest.fail("solved again"))
    (again,) = point_model(system, 3.7 * force, read, MAIN_Hz, HIGHEST_Hz)
    np.testing.assert_allclose(in_model(again, MAIN_Hz), 3.7 * in_model(first, MAIN_Hz), rtol=1e-9)
    assert {entry.kind for entry in cache.entries()} == {"point-model"}
    for changed in ({"read": 2.0 * read}, {"main_Hz": HIGHEST_Hz}, {"highest_Hz": 2.0 * HIGHEST_Hz}):
        given = {"system": system, "force": force, "read": read, "main_Hz": MAIN_Hz, "highest_Hz": HIGHEST_Hz}
        with pytest.raises(pytest.fail.Exception, match="solved again"):
            point_model(**given | changed)
