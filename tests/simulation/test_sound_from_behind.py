"""Sound from behind an opaque body doesn't reach its front: boundary elements are the judge."""

import numpy as np
import pytest
import trimesh

from palmfield.acoustics.air import sound_speed
from palmfield.acoustics.arrays import combined, layout, placed
from palmfield.acoustics.body_scattering import RigidScatteredField, boundary_mesh
from palmfield.acoustics.focus import focus
from palmfield.acoustics.phased_array import MultiArrayField, directivity_groups
from palmfield.acoustics.surface_arp import MATRIX_FROM, SurfaceArp
from palmfield.session.simulation import Simulation, load
from palmfield.types import Air, Complex, Float

pytestmark = pytest.mark.usefixtures("kept_operators")

AIR = Air()
FRONT = '<instance name="array"><config key="layout" value="openmpd"/></instance>'
REAR = '<instance name="back"><config key="layout" value="openmpd"/><config key="site" value="rear"/></instance>'
CAPS = (
    '<instance name="array"><config key="layout" value="csv"/><config key="transducers" value="caps.csv"/></instance>'
)
SCENE = """<mujoco model="disc">
  <option timestep="0.001" gravity="0 0 0"/>
  <extension>
    <plugin plugin="palmfield.array">{arrays}</plugin>
    <plugin plugin="palmfield.stimulus"><instance name="stimulus"><config key="focus_m" value="0 0 0.15"/>{only}
      <config key="drive_amplitude" value="0.2"/></instance></plugin>
    <plugin plugin="palmfield.skin"><instance name="skin"><config key="body" value="pad"/>
      <config key="shape" value="disc"/><config key="radius_m" value="0.03"/><config key="thickness_m" value="0.015"/>
      <config key="material" value="ecoflex_00-10"/><config key="accuracy" value="0.4"/>
      <config key="element_m" value="0.012"/><config key="body_sound" value="{sound}"/></instance></plugin>
  </extension>
  <worldbody>
    <site name="array"/><site name="rear" pos="0 0 0.3" quat="0 1 0 0"/>
    <body name="pad" pos="0 0 0.15" quat="0 1 0 0">
      <freejoint/><geom type="cylinder" size="0.03 0.0075" pos="0 0 -0.0075" mass="1000"/></body>
  </worldbody>
</mujoco>
"""


def pressed(folder, arrays: str, sound: str, only: str = "", rows: int = 128) -> tuple[Float, Float]:
    """ARP on the skin [Pa], and forces on the bodies."""
    grid = [(-36.75 + 10.5 * i, -36.75 + 10.5 * j) for j in range(8) for i in range(8)]
    lines = [f"{x},{y},0,0,0,1" for x, y in grid] + [f"{x},{y},300,0,0,-1" for x, y in grid]
    (folder / "caps.csv").write_text("\n".join(["x_mm,y_mm,z_mm,nx,ny,nz", *lines[:rows]]))
    path = folder / "scene.xml"
    path.write_text(SCENE.format(arrays=arrays, sound=sound, only=only))
    sim = load(path)
    sim.step(2)
    return sim.skin().arp.astype(float), sim.forces.copy()


@pytest.mark.parametrize("sound", ["none", "shadows"])
def test_what_faces_the_back_adds_nothing_in_front(tmp_path, sound):
    alone, push = pressed(tmp_path, FRONT, sound)
    behind, _ = pressed(tmp_path, REAR + FRONT, sound, '<config key="arrays" value="back"/>')
    assert alone.max() > 1.0 and behind.max() == 0.0 and push[0, 2] > 0.0
    both, together = pressed(tmp_path, FRONT + REAR, sound)
    assert both.max() == pytest.approx(alone.max(), rel=1e-4)
    assert together[0] == pytest.approx(push[0], rel=0.01, abs=1e-8)
    # One table of both boards, of other transducers, against its first half
    caps, pushed = pressed(tmp_path, CAPS, sound)
    half, push = pressed(tmp_path, CAPS, sound, rows=64)
    assert caps.max() == pytest.approx(half.max(), rel=1e-4)
    assert pushed[0] == pytest.approx(push[0], rel=0.01, abs=1e-8)


@pytest.mark.parametrize("arrays", [FRONT + REAR, CAPS], ids=["boards", "table"])
def test_worlds_keep_sound_from_behind_out_as_a_single_one_does(tmp_path, arrays):
    alone, push = pressed(tmp_path, arrays, "none")
    worlds = Simulation(tmp_path / "scene.xml", worlds=2)
    worlds.step(2)
    for world in range(2):
        np.testing.assert_allclose(worlds.skin().arp[world], alone, rtol=1e-5, atol=1e-5 * alone.max())
        np.testing.assert_allclose(worlds.forces[world], push, rtol=1e-4, atol=1e-9)


def plate(tilt_deg: float) -> tuple[MultiArrayField, Float, Float, Complex, Float, Float]:
    """Two boards 200 mm apart, points on one face of a plate between them, normals, a drive, turn and middle."""
    board, middle, half = layout("openmpd"), np.array([0.0, 0.0, 0.1]), 0.003
    both = combined([board, placed(board, np.array([0.0, 0.0, 0.2]), np.diag([1.0, -1.0, -1.0]))])
    c, s = np.cos(np.radians(tilt_deg)), np.sin(np.radians(tilt_deg))
    turn = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    x, y = np.meshgrid(*2 * [np.linspace(-0.01, 0.01, 15)])
    own = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, -half)])
    drive = focus(both, AIR, middle - half * turn[:, 2])
    field = MultiArrayField(directivity_groups([both]), AIR, "cpu")
    return field, own, np.tile(-turn[:, 2], (len(own), 1)), drive, turn, middle


@pytest.mark.numerics
@pytest.mark.parametrize("tilt_deg", [60.0, 90.0])
def test_boundary_elements_agree_at_any_tilt(tilt_deg):
    field, own, normals, drive, turn, middle = plate(tilt_deg)
    wavenumber = 2.0 * np.pi * 40e3 / sound_speed(AIR)

    def incident(points: Float, given: Complex = drive) -> Complex:
        return field.pressure(points @ turn.T + middle, given).pressure.astype(np.complex128)

    body = trimesh.creation.box((0.028, 0.028, 0.006)).subdivide_to_size(0.003)
    mesh = boundary_mesh(body.vertices, body.faces, 2.0 * np.pi / wavenumber)
    solved = RigidScatteredField.of(mesh, incident, wavenumber, AIR, "cpu")
    true, free = solved.at(own).amplitude ** 2, 4.0 * np.abs(incident(own)) ** 2
    ours = SurfaceArp(field, len(own)).evaluate(own @ turn.T + middle, normals, drive).amplitude
    assert np.abs(free - true).max() > 0.6 * free.max()
    assert np.abs(4.0 * ours**2 - true).max() < 0.1 * free.max()
    # The second board alone pushes the plate's back and rim
    centres, alone = body.triangles_center, np.where(np.arange(len(drive)) < len(drive) // 2, 0.0, drive)
    solved = RigidScatteredField.of(mesh, lambda points: incident(points, alone), wavenumber, AIR, "cpu")
    at = SurfaceArp(field, len(centres))
    found = at.evaluate(centres @ turn.T + middle, body.face_normals @ turn.T, alone).arp
    push, true_push = (-(arp * body.area_faces) @ body.face_normals for arp in (found, solved.at(centres).arp))
    assert np.linalg.norm(push - true_push) < 0.15 * np.linalg.norm(true_push)


def test_it_is_continuous_in_pose_and_all_ways_agree():
    arps = []
    for tilt_deg in (84.0, 84.01):
        field, own, normals, drive, turn, middle = plate(tilt_deg)
        points = own @ turn.T + middle
        at = SurfaceArp(field, len(own))
        arps.append(at.evaluate(points, normals, drive).arp.copy())
        by_matrix = at.evaluate_many(points, normals, np.tile(drive, (MATRIX_FROM, 1)))
        np.testing.assert_allclose(by_matrix[0], arps[-1], atol=1e-3 * arps[-1].max())
    assert 0.0 < np.abs(arps[1] - arps[0]).max() < 0.01 * arps[0].max()
