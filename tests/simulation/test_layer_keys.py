"""Sheets, base and sides of a scene's skin layer, and its cut-off in the plan."""

from collections import Counter
from typing import Any

import numpy as np
import pytest
import trimesh

from palmfield import cache
from palmfield.config import SkinConfig, parse
from palmfield.errors import SceneError
from palmfield.estimate.estimated_run import run
from palmfield.planning.scene_plan import plan
from palmfield.session.simulation import load
from palmfield.simulation.emission import array_drives
from palmfield.simulation.posed_scene import reference_scene
from palmfield.simulation.radiation import Radiation
from palmfield.skin.fem.solver import static
from palmfield.skin.from_config import layer_cutoff
from palmfield.skin.materials.catalogue import preset
from palmfield.skin.materials.dispersion import cutoff
from palmfield.skin.materials.material import Sheet, elastic
from palmfield.skin.mesh.wedges import element_rows


def push(path):
    """Largest static push of the surface under the scene's sound [m]."""
    model = load(path).runtime.model
    drive = array_drives(model, model.arrays)[0].unit_drive(model.stimuli[0].reference_foci).amplitudes
    arp = Radiation(model).on(reference_scene(model), 0, "quadrature", drive).arp
    layer = model.skins[0].layer
    force = layer.quadrature.operator @ arp.astype(np.float64)
    return np.abs(layer.surface_operator @ static(layer.system, force)).max()


def damping(path):
    return load(path).runtime.model.skins[0].layer.system.damping


def test_sheets_of_one_material_are_the_layer_of_it(small_scene):
    both = {"material": None, "materials": "ecoflex_00-10 ecoflex_00-10", "shares": "0.4 0.6", "element_m": 0.003}
    one = push(small_scene(skin={"element_m": 0.003}))
    assert push(small_scene(skin=both)) == pytest.approx(one, rel=0.01)


def test_a_stiff_sheet_on_a_soft_one_moves_less(small_scene):
    soft, stiff = "ecoflex_00-10", "gelatin_2"
    pushes = {}
    for order in ((soft, soft), (stiff, soft), (soft, stiff), (stiff, stiff)):
        keys = {"material": None, "materials": " ".join(order), "shares": "0.3 0.7"}
        pushes[order] = push(small_scene(skin=keys))
    least, most = sorted((pushes[soft, soft], pushes[stiff, stiff]))
    assert least < pushes[stiff, soft] < most and least < pushes[soft, stiff] < most


@pytest.mark.parametrize("shares", [(0.5, 0.5), (0.1, 0.9), (0.34, 0.33, 0.33), (1.0,)])
def test_no_row_crosses_two_sheets(shares):
    materials = [elastic(f"m{k}", 1e3, 1e4) for k in range(len(shares))]
    sheets = tuple(Sheet(m, s) for m, s in zip(materials, shares, strict=True))
    edges, rows = element_rows(sheets, np.array([0.0, 0.11, 0.28, 0.56, 1.0]))
    assert len(rows) == len(edges) - 1 >= len(shares) and np.all(np.diff(edges) > 0) and edges[-1] == 1.0
    for sheet, end in zip(sheets, np.cumsum(shares), strict=True):
        inside = [k for k, row in enumerate(rows) if row is sheet.material]
        assert edges[inside[-1] + 1] == pytest.approx(end) and edges[inside[0]] == pytest.approx(
            end - sheet.thickness_m
        )


def test_springs_go_from_free_to_bonded(small_scene):
    def on(stiffness, **more):
        keys = {"base": "springs", "base_normal_Pa_m": stiffness, "base_tangential_Pa_m": stiffness, "side": "fixed"}
        return push(small_scene(skin=keys | more))

    bonded, free = push(small_scene(skin={"side": "fixed"})), push(small_scene(skin={"base": "free", "side": "fixed"}))
    assert on(1e12) == pytest.approx(bonded, rel=1e-4)
    assert on(1e-3) == pytest.approx(free, rel=1e-4)
    assert bonded < on(3e6) < free


def test_tissue_without_end_moves_more_than_bone(small_scene):
    """Ecoflex on bone, on more Ecoflex, and on muscle, which is softer."""
    shape = {"side": "fixed", "element_m": 0.004, "radius_m": 0.03}
    bonded, deep, muscle = (push(small_scene(skin=shape | {"base": base})) for base in ("bonded", "deep", "muscle"))
    assert bonded < deep < muscle


@pytest.mark.parametrize("base", ["deep", "muscle"])
def test_a_scene_on_tissue_without_end_runs_and_says_so(small_scene, base):
    path = small_scene(skin={"base": base, "element_m": 0.004, "solver": "auto"})
    planned = plan(load(path))
    [row] = [row for row in planned.modelled if row.what == "skin layer"]
    assert f"base {base} ({'muscle' if base == 'muscle' else 'ecoflex_00-10'} without end)" in row.why
    assert "waves below the cut-off" not in [row.what for row in planned.besides]
    model = load(path).runtime.model
    layer = model.skins[0].layer
    assert layer.dofs >= layer.system.ndof > layer.dofs - 3 * len(layer.mesh.side) * 3
    summary = run(load(path), progress=False).summary
    assert summary["skins"][0]["peak_displacement_m"] > 0


def test_other_meshes_refuse_tissue_without_end(small_scene):
    with pytest.raises(SceneError, match="only wedges, reduced and lateral_waves support a Foundation"):
        plan(load(small_scene(skin={"base": "deep", "solver": "particles"})))


def test_dashpots_below_and_at_the_sides_take_energy(small_scene):
    springs = {"base": "springs", "base_normal_Pa_m": 1e6, "base_tangential_Pa_m": 1e6}
    quiet = damping(small_scene(skin=springs))
    loss = damping(small_scene(skin=springs | {"base_normal_Pa_s_m": 500}))
    sides = damping(small_scene(skin={"side": "absorbing"}))
    assert quiet.nnz == 0 or abs(quiet).max() == 0.0
    for matrix in (loss, sides):
        assert np.linalg.eigvalsh(matrix.toarray())[-1] > 0.0


@pytest.mark.parametrize("solver", ["wedges", "reduced"])
def test_a_layered_scene_runs(small_scene, tmp_path, solver):
    keys = {
        "material": None, "materials": "finger_pad ecoflex_00-10", "shares": "0.3 0.7", "side": "absorbing",
        "base": "springs", "base_normal_Pa_m": 1e7, "base_tangential_Pa_m": 1e6, "solver": solver,
    }  # fmt: skip
    result = run(load(small_scene(skin=keys)), tmp_path / "out", progress=False)
    [skin] = result.summary["skins"]
    assert skin["peak_displacement_m"] > 0 and skin["solver"].startswith(solver)


@pytest.mark.parametrize(
    ("keys", "reason"),
    [
        ({"materials": "palm finger_pad", "shares": "1"}, "give one share for each"),
        ({"materials": "palm finger_pad", "shares": "0.5 0.6"}, "add up to 1.1"),
        ({"materials": "palm", "shares": "1", "material": "palm"}, "remove one"),
        ({"materials": "palm", "shares": "1", "bulk_Pa": "1e6"}, "remove one"),
        ({"shares": "-1"}, "decimals > 0"),
        ({"base": "springs", "base_normal_Pa_m": "1"}, "base_tangential_Pa_m"),
        ({"base_normal_Pa_m": "1"}, "applies to base 'springs'"),
        ({"base": "free", "side": "free"}, "without support"),
        ({"base": "free_slip", "foundation_normal_Pa_m": "1", "foundation_tangential_Pa_m": "1"}, "remove one"),
        ({"base": "deep", "foundation_normal_Pa_m": "1", "foundation_tangential_Pa_m": "1"}, "remove one"),
        ({"base": "muscle", "base_normal_Pa_m": "1"}, "applies to base 'springs'"),
        ({"solver": "quick"}, "auto | wedges | reduced"),
        ({"materials": "palm nose", "shares": "0.5 0.5"}, "nose"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(small_scene, keys, reason):
    with pytest.raises(SceneError) as caught:
        if "nose" in keys.get("materials", ""):
            load(small_scene(skin=keys | {"material": None}))
        parse(SkinConfig, keys | {"patch_site": "x"}, "plugin 'palmfield.skin'")
    assert reason in str(caught.value) and "\n" not in str(caught.value)


def test_cut_off_of_one_sheet_and_of_matched_ones():
    palm = preset("palm")
    assert layer_cutoff((Sheet(palm, 1.0),), 0.01) == pytest.approx(cutoff(palm, 0.01), rel=1e-6)
    assert layer_cutoff((Sheet(palm, 0.3), Sheet(palm, 0.7)), 0.01) == pytest.approx(cutoff(palm, 0.01), rel=1e-6)
    # Equal impedance rho c: nothing is reflected in between, and the quarter wave counts the way in time.
    slow, fast = elastic("slow", 1000.0, 4e3), elastic("fast", 500.0, 8e3)
    assert layer_cutoff((Sheet(slow, 0.5), Sheet(fast, 0.5)), 0.02) == pytest.approx(0.25 / (0.01 / 2 + 0.01 / 4))


@pytest.mark.parametrize(
    ("skin", "promised"),
    [({}, False), ({"base": "free_slip"}, True), ({"thickness_m": 0.02}, True), ({"thickness_m": 0.004}, False)],
)
def test_plan_promises_no_waves_below_the_cut_off(small_scene, skin, promised):
    stimulus = {"am_frequency_Hz": 100}
    scene = load(small_scene(skin=skin, stimulus=stimulus))
    planned = plan(scene)
    said = [text for text in planned.warnings if "carries no waves" in text]
    assert bool(said) == (not promised)
    rows = [row for row in planned.besides if row.what == "waves below the cut-off"]
    assert bool(rows) == ("base" not in skin)
    if rows:
        depth = skin.get("thickness_m", 0.008)
        assert f"c_s/4h = {cutoff(preset('ecoflex_00-10'), depth):.0f} Hz" in rows[0].size


BOX = {"shape": "mesh", "mesh": "box.obj", "mesh_unit": "mm", "patch_site": "centre", "patch_radius_m": 0.03,
       "radius_m": None, "thickness_m": None, "element_m": 0.004}  # fmt: skip


@pytest.mark.parametrize("skin", [{"radius_m": 0.04, "element_m": 0.004}, BOX], ids=["disc", "patch"])
def test_elements_are_fine_where_the_focus_is(small_scene, skin) -> None:
    """A focus 17 mm beside the middle of a layer: edges there are as given, and wider on the other side."""
    path = small_scene(stimulus={"focus_m": "0.015 0.008 0.12"}, skin={**skin, "focus_region_m": 0})
    box = trimesh.creation.box((90, 90, 30))
    box.apply_translation((0, 0, -15))
    box.export(path.with_name("box.obj"))
    model = load(path).runtime.model
    layer, body = model.skins[0].layer, model.skins[0].spec.body.transform
    focus = body.inverse_points(model.stimuli[0].first_focus)
    corners = layer.patch.vertices[layer.patch.faces]
    middles = corners.mean(axis=1)
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean(axis=1)
    near = edges[np.linalg.norm((middles - focus)[:, :2], axis=1) < layer.demand.spot_fwhm_m]
    opposite = edges[np.linalg.norm((middles + focus)[:, :2], axis=1) < layer.demand.spot_fwhm_m]
    assert near.mean() == pytest.approx(layer.sizes.edge_fine_m, rel=0.15)
    assert opposite.mean() > 1.3 * near.mean()


@pytest.mark.parametrize("skin", [{"radius_m": 0.08, "element_m": None}, {**BOX, "patch_radius_m": 0.04}])
def test_foci_of_a_region_frequencies_of_a_band_and_levels_share_a_mesh(small_scene, skin) -> None:
    """Within 20 mm of the middle; outside, foci near each other share one too, with fine elements around them."""
    at = {"focus_m": "0 0 0.12", "am_frequency_Hz": 180.0}
    path = small_scene(stimulus=at, skin=skin)
    box = trimesh.creation.box((180, 180, 30))
    box.apply_translation((0, 0, -15))
    box.export(path.with_name("box.obj"))

    def mesh(**changed: Any) -> Any:
        keys = {f"stimulus.{key}": value for key, value in changed.items()}
        return load(path, keys=keys).runtime.model.skins[0].layer.patch.vertices

    middle = mesh()
    for other in ({"focus_m": (0.012, -0.009, 0.12)}, {"am_frequency_Hz": 160.0}, {"arp_peak_Pa": 5.0}):
        assert np.array_equal(mesh(**other), middle)
    aside = mesh(focus_m=(0.034, 0.003, 0.12))
    assert aside.shape != middle.shape
    assert np.array_equal(mesh(focus_m=(0.036, -0.005, 0.12)), aside)


def test_levels_and_frequencies_of_a_band_share_the_reduced_model_and_its_estimate(
    small_scene, tmp_path, monkeypatch
) -> None:
    """A level adds no entry for either to the cache, a frequency only the estimate from the same models."""
    monkeypatch.setenv("PALMFIELD_CACHE", str(tmp_path / "cache"))
    path = small_scene(stimulus={"am_frequency_Hz": 180.0}, skin={"solver": "reduced"})
    seen: Counter[str] = Counter()

    def added(**changed: Any) -> Counter[str]:
        keys = {f"stimulus.{key}": value for key, value in changed.items()}
        run(load(path, keys=keys), plots=[], duration_s=0.02)
        now = Counter(entry.kind for entry in cache.entries() if "model" in entry.kind or "estimate" in entry.kind)
        new = now - seen
        seen.update(new)
        return new

    assert {"small-model", "point-model", "error-estimate"} <= set(added())
    assert not added(drive_amplitude=0.3)
    assert added(am_frequency_Hz=160.0) == {"error-estimate": 1}
    assert "small-model" in added(am_frequency_Hz=300.0)
