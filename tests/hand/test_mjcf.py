import mujoco
import numpy as np
import pytest
from mjcf_files import assert_same_file
from preset_mjcf import hand_mjcf

from palmfield.data import folder
from palmfield.hand.preset import DIGITS, load_preset
from palmfield.hand.surface import hand_surface

NAME = "open_men_p50"
FILE = folder("mjcf") / "hands" / f"{NAME}.xml"


def gap_to_geoms(model, data, points):
    """Distance from points to the nearest geom surface (ellipsoids to first order) [m], shape (n,)."""
    best = np.full(len(points), np.inf)
    for g in range(model.ngeom):
        local = (points - data.geom_xpos[g]) @ data.geom_xmat[g].reshape(3, 3)
        size = model.geom_size[g]
        if model.geom_type[g] == mujoco.mjtGeom.mjGEOM_CAPSULE:
            along = np.clip(local[:, 2], -size[1], size[1])
            distance = np.linalg.norm(local - np.outer(along, [0, 0, 1]), axis=1) - size[0]
        else:
            k0, k1 = np.linalg.norm(local / size, axis=1), np.linalg.norm(local / size**2, axis=1)
            distance = k0 * (k0 - 1) / k1
        best = np.minimum(best, distance)
    return best


@pytest.fixture(scope="module")
def hand():
    model = mujoco.MjModel.from_xml_path(str(FILE))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def test_committed_file_is_what_the_generator_writes():
    assert_same_file(FILE.read_text(encoding="utf-8"), hand_mjcf(load_preset(NAME)))


def test_opens_alone_and_included(hand, tmp_path):
    model, data = hand
    assert data.body("hand").xpos == pytest.approx([0, 0, 0.2])
    scene = tmp_path / "scene.xml"
    scene.write_text(
        f'<mujoco><include file="{FILE}"/><worldbody><geom type="plane" size="1 1 1"/></worldbody></mujoco>'
    )
    assert mujoco.MjModel.from_xml_path(str(scene)).nbody == model.nbody


def test_mass_is_that_of_a_hand(hand):
    model, _ = hand
    mass = float(model.body("hand").mass[0])
    assert 0.3 < mass < 0.6
    surface = hand_surface(load_preset(NAME)).surface
    a, b, c = (surface.vertices[surface.faces[:, i]] for i in range(3))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6
    assert mass == pytest.approx(1100 * volume, rel=0.15)


def test_geoms_follow_the_skin(hand):
    model, data = hand
    gap = gap_to_geoms(model, data, hand_surface(load_preset(NAME)).surface.vertices + np.array([0, 0, 0.2]))
    assert np.abs(gap).mean() < 1.5e-3
    assert np.percentile(np.abs(gap), 95) < 4e-3


def test_sites_are_at_the_landmarks(hand):
    _, data = hand
    marks = hand_surface(load_preset(NAME)).landmarks
    for name in ("palm_centre", "thenar", *(f"{digit}_pad" for digit in DIGITS), *(f"{digit}_tip" for digit in DIGITS)):
        assert data.site(name).xpos == pytest.approx(marks[name] + [0, 0, 0.2], abs=2e-6)


def test_servo_holds_the_hand_and_does_not_ring(hand):
    model, _ = hand
    data = mujoco.MjData(model)
    body = model.body("hand").id
    path = []
    for _ in range(600):
        data.xfrc_applied[body, 2] = 0.05
        mujoco.mj_step(model, data)
        path.append(data.joint("hand_z").qpos[0])
    assert path[-1] == pytest.approx(0.05 / 2000, rel=1e-3), "weight is compensated, only the push is left"
    assert max(path) < 1e-4 and max(path) < 1.01 * path[-1]


def test_moves_where_it_is_told(hand):
    model, _ = hand
    data = mujoco.MjData(model)
    data.ctrl[:] = [0.01, -0.02, 0.03]
    mujoco.mj_step(model, data, nstep=1000)
    assert data.body("hand").xpos == pytest.approx([0.01, -0.02, 0.23], abs=1e-6)


def test_geoms_touch_nothing(hand):
    model, data = hand
    assert data.ncon == 0 and not model.geom_contype.any() and not model.geom_conaffinity.any()
