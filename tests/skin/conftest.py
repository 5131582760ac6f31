"""The reference disc (120 x 20 mm Ecoflex, spot of 10.3 mm) for the tests of this folder."""

from dataclasses import dataclass

import numpy as np
import pytest
import warp as wp
from scipy import sparse

from palmfield.skin.fem.assembly import SkinSystem, assemble
from palmfield.skin.fem.load import SurfaceQuadrature
from palmfield.skin.fem.probe import SurfaceProbe
from palmfield.skin.fem.wedge_stepper import WedgeStepper
from palmfield.skin.materials.catalogue import PRESETS
from palmfield.skin.materials.material import Material
from palmfield.skin.mesh.disc import disc_patch
from palmfield.skin.mesh.wedges import WedgeMesh, extrude
from palmfield.skin.reduction.device_models import SECTIONS
from palmfield.skin.stepper import StepMemory, SurfaceLoads
from palmfield.types import Float
from warp_kernels.skin_steps import LANES

SPOT_M, DEPTH_M, RADIUS_M = 0.0103, 0.02, 0.06


def depth_fractions(layers: int) -> Float:
    edges = np.concatenate([[0.0], np.cumsum(1.6 ** np.arange(layers))])
    return edges / edges[-1]


@dataclass
class Spot:
    """A layer under a Gaussian spot at its centre: the force, and the operator that reads the centre's push."""

    mesh: WedgeMesh
    system: SkinSystem
    force: Float
    read: Float

    def push(self, u):
        return -(self.read @ u)[0]


def disc_spot(
    fine_m: float,
    layers: int,
    material: Material = PRESETS["ecoflex_00-10"],
    radius_m: float = RADIUS_M,
    depth_m: float = DEPTH_M,
    growth: float = 2.5,
    **conditions,
) -> Spot:
    fine_radius = min(0.012, 0.5 * radius_m)
    mesh = extrude(disc_patch(radius_m, depth_m, fine_m, growth * fine_m, fine_radius), depth_fractions(layers))
    system = assemble(mesh, material, **{"side": "roller", **conditions})
    quadrature = SurfaceQuadrature(mesh, system)
    distance2 = (quadrature.points[:, :2] ** 2).sum(axis=1)
    force = quadrature.assemble(np.exp(-4 * np.log(2) * distance2 / SPOT_M**2))
    return Spot(mesh, system, force, SurfaceProbe(mesh, np.zeros((1, 3)), system).operator)


class NodalStepper:
    """A WedgeStepper one substep at a time, under nodal forces [N]; its states are (rows, unknowns)."""

    def __init__(self, system: SkinSystem, step_s: float, rho_inf: float = 0.8) -> None:
        self.whole = WedgeStepper(system, sparse.identity(system.ndof, format="csr"), step_s, rho_inf)

    def new_state(self) -> Float:
        return np.zeros((self.whole.state_rows, self.whole.unknowns))

    def step(self, state: Float, first: Float, last: Float) -> None:
        ends = np.eye(2)[:, None, None]
        loads = SurfaceLoads(np.array([[first, last]]), ends[0], ends[1])
        self.whole.step(state.reshape(1, -1), loads, 0.0, self.whole.step_s)


@pytest.fixture(scope="session")
def nodal_stepper():
    return NodalStepper


@pytest.fixture(scope="session")
def make_spot():
    return disc_spot


@pytest.fixture(scope="session")
def coarse_spot():
    """About 1.5 k degrees of freedom: for what must hold on any mesh."""
    return disc_spot(0.009, 1, radius_m=0.03)


@pytest.fixture(scope="session")
def on_device():
    """Steps a skin by the launches of a device model on the CPU."""

    def step(model, state, loads):
        """States after all substeps, shape (w, n), and sums of squares, (w, SECTIONS).

        loads: pressure at all of the layer's points; of the second world the last pattern is none, whatever lies there
        """
        worlds, substeps, patterns = loads.first.shape
        counts, pressure = np.full((worlds, 2), patterns), loads.pressure_Pa.copy()
        counts[1, 1], pressure[1, -1] = patterns - 1, np.nan
        weights = np.array([model.weights(*ends) for ends in zip(loads.first, loads.last, strict=True)])
        after = wp.zeros(state.shape, dtype=wp.float64, device="cpu")
        squares = wp.zeros((worlds, SECTIONS, substeps, LANES), dtype=wp.float64, device="cpu")
        counts, pressure, weights, before = (
            wp.array(values, dtype=dtype, device="cpu")
            for values, dtype in (
                (counts, wp.int32),
                (pressure.reshape(-1, pressure.shape[2]), wp.float32),
                (weights, wp.float64),
                (state, wp.float64),
            )
        )
        for call in model.calls(StepMemory(counts, pressure, weights, before, after, squares)):
            call()
        return after.numpy(), squares.numpy().sum(axis=(2, 3))

    return step
