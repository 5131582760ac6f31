"""A package that is not palmfield brings a solver that steps skins, by an entry point; and nobody knows steppers by
their class."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest

import palmfield
from palmfield.config import SkinConfig
from palmfield.errors import SceneError
from palmfield.planning.scene_plan import plan
from palmfield.session.simulation import load

PACKAGE = '''
import numpy as np
from palmfield.skin.explicit_layer import ExplicitLayer
from palmfield.skin.stepper import Reader, SkinStepper, check_step, checked_operator


class PistonLayer(ExplicitLayer):
    """The layer's whole face moves as one, on a spring and a dashpot."""

    resolution = "one piston"
    unknowns = state_size = 1
    expected_error = 0.5

    def __init__(self, layer):
        self.layer = layer

    def refuse(self):
        pass

    def seconds(self, duration_s, device):
        return 1e-3

    def stepper(self, device):
        return Piston(self.layer)


class Piston(SkinStepper):
    name, error, points, unknowns, state_size = "piston", 0.5, None, 1, 1
    stiffness_N_m, time_s = 100.0, 2e-3

    def __init__(self, layer):
        self.step_s, self._weights, self._layer = layer.step_s, layer.quadrature.weights, layer

    def step(self, state, loads, t0, t1, observe=None):
        check_step(self, state, loads, len(self._weights), t0, t1)
        forces = loads.pressure_Pa @ self._weights
        seen = []
        for pushed in np.einsum("wsk,wk->sw", loads.last, forces):
            state[:, 0] += (1.0 - np.exp(-self.step_s / self.time_s)) * (-pushed / self.stiffness_N_m - state[:, 0])
            seen.append(None if observe is None else self.read(state, observe))
        return None if observe is None else np.stack(seen, axis=1)

    def reader(self, operator):
        mesh, matrix = self._layer.mesh, checked_operator(operator, self._layer.system.ndof)
        up = np.zeros((len(mesh.nodes), 3))
        up[: mesh.surface_nodes, 2] = 1.0
        return Reader(matrix.shape[0], matrix @ up.ravel()[: matrix.shape[1]])

    def read(self, state, reader):
        moved = state[:, :1] * reader.matrix
        return np.stack([moved, np.zeros_like(moved)], axis=1)
'''


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """A package with an entry point, as pip would install it."""
    info = tmp_path / "site" / "piston-1.0.dist-info"
    info.mkdir(parents=True)
    (info.parent / "piston_skin.py").write_text(PACKAGE)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: piston\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[palmfield.skin_solvers]\npiston = piston_skin:PistonLayer\nlost = piston_skin:Nothing\n"
    )
    monkeypatch.syspath_prepend(str(info.parent))
    yield
    sys.modules.pop("piston_skin", None)


def test_a_stepper_of_another_package_steps_a_scene(installed, small_scene):
    """Where the load stays, the piston comes to rest under the mean force that MuJoCo gets."""
    steady = {"modulation": "none", "am_quantity": None, "am_frequency_Hz": None, "am_depth": None}
    path = small_scene(skin={"solver": "piston"}, stimulus=steady)
    sim = load(path, device="cpu")
    result = palmfield.run(sim, None, duration_s=0.03, progress=False)
    own, moved = result.summary["skins"][0], result.dataset["skin/skin"]["displacement"].values
    assert (own["solver"], own["dofs"], own["solver_why"]) == ("piston", 1, "set by key solver")
    assert own["mesh_error_relative"] == 0.5 and own["reduction_error_relative"] == 0.0
    stepper, state = sim.runtime.model.begin[0].value, sim.runtime.state.skins[0]
    assert stepper.name == "piston" and state[0, 4] < 0.0
    layer = sim.runtime.model.skins[0].layer
    arp = sim.runtime.work.radiation.on(sim.runtime.posed, 0, "quadrature", sim.runtime.state.emitted[0][0]).arp
    assert state[0, 4] == pytest.approx(-(arp @ layer.quadrature.weights) / 100.0, rel=1e-3)
    assert moved[-1].min() == pytest.approx(state[0, 4], rel=1e-3)


def test_a_plan_knows_it_by_what_it_says(installed, small_scene):
    told = plan(small_scene(skin={"solver": "piston"}))
    rows = {row.what: row for row in told.modelled}
    assert rows["mesh of piston"].size == "one piston" and "skin solver piston" in rows
    assert {row.what: row.size for row in told.error}["piston"].startswith("about 50 %; ")
    assert told.numbers["skins"][0]["unknowns"] == 1


def test_worlds_are_stepped_by_it(installed, small_scene):
    sims = palmfield.Simulation(small_scene(skin={"solver": "piston"}), worlds=2, device="cpu")
    sims.step(2)
    first, second = sims.skin().displacement[..., 2]
    assert first.min() < 0.0
    np.testing.assert_array_equal(first, second)


def test_a_solver_that_nobody_has_is_refused_with_those_there_are(installed, small_scene):
    with pytest.raises(SceneError) as refusal:
        load(small_scene(skin={"solver": "pistn"}))
    assert "key 'solver' has value 'pistn'; allowed: auto | wedges | reduced | modal" in str(refusal.value)
    with pytest.raises(SceneError, match="'lost': the entry point 'piston_skin:Nothing' of the solver cannot be"):
        load(small_scene(skin={"solver": "lost"}))


def test_own_solvers_ask_for_no_entry_points(monkeypatch):
    monkeypatch.setattr("palmfield.config.skin.entry_points", lambda **which: pytest.fail("asked"))
    for solver in ("auto", "wedges", "particles"):
        assert SkinConfig(solver=solver, shape="disc", radius_m=0.02, thickness_m=0.01).solver == solver


PACKAGE_FOLDER = Path(palmfield.__file__).parent


def test_nobody_outside_the_skin_knows_steppers_by_their_class_or_a_list_of_names():
    by_class = re.compile(r"isinstance\(.*Stepper|\bEXPLICIT\b")
    assert by_class.search("    if isinstance(stepper, ModalStepper):")
    found = [
        f"{file.relative_to(PACKAGE_FOLDER)}:{number}"
        for file in sorted(PACKAGE_FOLDER.rglob("*.py"))
        if PACKAGE_FOLDER / "skin" not in file.parents
        for number, line in enumerate(file.read_text().splitlines(), 1)
        if by_class.search(line)
    ]
    assert found == []
