"""Other programs on the slab of skin_case: scikit-fem, warp.fem and the flexes of MuJoCo. Each is optional.

Each function takes a resolution. It returns the displacement of the centre per pascal, static and at F_Hz [m/Pa] (None
if the program cannot compute it), and its number of unknowns.
"""

import json
import math
import sys
import time
from typing import Any

import numpy as np
from scipy.sparse.linalg import splu
from threadpoolctl import threadpool_limits

from palmfield.skin.materials.material import complex_bulk, complex_shear
from palmfield.skin.problem import GAUSSIAN
from palmfield.studies.bench.skin_case import CASE, Case, F_Hz

MeshSolution = tuple[float | None, complex | None, int]
HALF_M = 0.06
"""Half width of the slab: its sides change the result by 0.3 % (docs/bench/skin_c0.md)."""
PUSH_Pa = 1.0
"""Pressure, small relative to the moduli because flexes are nonlinear."""
SETTLE_STEPS = 200


def graded(half_m: float, cells: int, depth_m: float, layers: int) -> tuple[list[float], list[float]]:
    """Return coordinates [m] of a graded quarter box: from the centre of the spot outwards, and from the base to 0.

    Cells grow in geometric series, to eight times along the face and to three times through the depth.
    """

    def series(length: float, count: int, growth: float) -> list[float]:
        ratio = growth ** (1.0 / max(count - 1, 1))
        edges = np.concatenate([[0.0], np.cumsum(ratio ** np.arange(count))])
        return (length * edges / edges[-1]).tolist()

    along = series(half_m, cells, 8.0)
    down = [-z for z in series(depth_m, layers, 3.0)][::-1]
    return along, down


def pressure(case: Case, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the pressure of the spot of 1 Pa, centred on the z axis."""
    return np.exp(-GAUSSIAN * (x**2 + y**2) / case.fwhm_m**2)


def moduli(case: Case, f_Hz: float) -> tuple[complex, complex]:
    """Return shear and bulk modulus [Pa] for e^{-i w t}."""
    return complex_shear(case.material, f_Hz), complex_bulk(case.material, f_Hz)


def scikit_fem(case: Case, cells: int, layers: int) -> MeshSolution:
    """Solve with quadratic hexahedra (27 nodes) and full integration, on a graded quarter with mirror planes."""
    import skfem as fem
    from skfem.helpers import ddot, div, dot, sym_grad

    along, down = graded(HALF_M, cells, case.depth_m, layers)
    mesh = fem.MeshHex.init_tensor(np.array(along), np.array(along), np.array(down))
    basis = fem.Basis(mesh, fem.ElementVector(fem.ElementHex2()), intorder=4)

    @fem.BilinearForm
    def deviatoric(u: Any, v: Any, _: Any) -> Any:
        return 2.0 * ddot(sym_grad(u), sym_grad(v)) - 2.0 / 3.0 * div(u) * div(v)

    @fem.BilinearForm
    def volumetric(u: Any, v: Any, _: Any) -> Any:
        return div(u) * div(v)

    @fem.BilinearForm
    def inertia(u: Any, v: Any, _: Any) -> Any:
        return dot(u, v)

    @fem.LinearForm
    def load(v: Any, w: Any) -> Any:
        return -pressure(case, w.x[0], w.x[1]) * v[2]

    face = mesh.facets_satisfying(lambda x: np.isclose(x[2], 0.0))
    force = load.assemble(fem.FacetBasis(mesh, basis.elem, facets=face, intorder=6))
    # Mirror planes: no motion across; far sides: free; base: bonded
    held = [
        basis.get_dofs(mesh.facets_satisfying(lambda x: np.isclose(x[0], 0.0))).all("u^1"),
        basis.get_dofs(mesh.facets_satisfying(lambda x: np.isclose(x[1], 0.0))).all("u^2"),
        basis.get_dofs(mesh.facets_satisfying(lambda x: np.isclose(x[2], -case.depth_m))).all(),
    ]
    free = basis.complement_dofs(np.unique(np.concatenate(held)))
    centre = mesh.p.T
    corner = int(np.argmin(np.linalg.norm(centre, axis=1)))
    read = basis.nodal_dofs[2, corner]
    matrices = [form.assemble(basis)[free][:, free] for form in (deviatoric, volumetric, inertia)]
    where = int(np.searchsorted(free, read))
    return *_solve(case, matrices, force[free], where), len(free)


def warp_fem(case: Case, cells: int, layers: int) -> MeshSolution:
    """Solve with warp.fem: quadratic hexahedra (27 nodes) on the same graded quarter, in float32, solver of SciPy."""
    import skin_warp_forms as forms
    import warp as wp
    from warp import fem

    along, down = (np.array(values) for values in graded(HALF_M, cells, case.depth_m, layers))
    points = np.stack(np.meshgrid(along, along, down, indexing="ij"), axis=-1).reshape(-1, 3)
    shape = (len(along), len(along), len(down))
    i, j, k = (n.ravel() for n in np.meshgrid(*(np.arange(n - 1) for n in shape), indexing="ij"))
    corners = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
    hexes = np.stack([((i + a) * shape[1] + (j + b)) * shape[2] + (k + c) for a, b, c in corners], axis=1)
    # Millimetres: float32 holds node positions and gradients of order one
    with wp.ScopedDevice("cpu"):
        mesh = fem.Hexmesh(
            wp.array(hexes.astype(np.int32), dtype=int), wp.array((1e3 * points).astype(np.float32), dtype=wp.vec3)
        )
        space = fem.make_polynomial_space(mesh, degree=2, dtype=wp.vec3)
        inside = fem.Cells(mesh)
        both: dict[str, Any] = {"u": fem.make_trial(space, domain=inside), "v": fem.make_test(space, domain=inside)}
        matrices = [
            _scipy(fem.integrate(form, fields=both, output_dtype=wp.float64))
            for form in (forms.deviatoric, forms.volumetric, forms.inertia)
        ]
        nodes = 1e-3 * space.node_positions().numpy()
        sides = fem.BoundarySides(mesh)
        values = {"width": 1e3 * case.fwhm_m, "slope": GAUSSIAN}
        force = fem.integrate(
            forms.load, fields={"v": fem.make_test(space, domain=sides)}, values=values, output_dtype=wp.vec3d
        ).numpy()
    deviatoric, volumetric, inertia = matrices
    held = np.zeros((len(nodes), 3), dtype=bool)
    held[:, 0] = np.isclose(nodes[:, 0], 0.0, atol=1e-7)
    held[:, 1] = np.isclose(nodes[:, 1], 0.0, atol=1e-7)
    held[np.isclose(nodes[:, 2], -case.depth_m, atol=1e-7)] = True
    free = np.flatnonzero(~held.ravel())
    scaled = [1e-3 * deviatoric, 1e-3 * volumetric, 1e-9 * inertia]
    read = 3 * int(np.argmin(np.linalg.norm(nodes, axis=1))) + 2
    reduced = [matrix[free][:, free] for matrix in scaled]
    return *_solve(case, reduced, 1e-6 * force.ravel()[free], int(np.searchsorted(free, read))), len(free)


def mujoco_flex(case: Case, cells: int, layers: int) -> MeshSolution:
    """Solve with a flex of MuJoCo: a full box of trilinear cells, at rest under nodal forces; no answer at F_Hz.

    It has Young's modulus and Poisson's ratio of the relaxed solid; its sides are free. Strong damping brings it to
    rest.
    """
    import mujoco

    shear, bulk = (modulus.real for modulus in moduli(case, 0.0))
    young = 9.0 * bulk * shear / (3.0 * bulk + shear)
    poisson = (3.0 * bulk - 2.0 * shear) / (2.0 * (3.0 * bulk + shear))
    count = 2 * cells + 1
    spacing = 2.0 * HALF_M / (count - 1)
    mass = case.material.density_kg_m3 * (2.0 * HALF_M) ** 2 * case.depth_m
    model = mujoco.MjModel.from_xml_string(f"""
    <mujoco>
      <option gravity="0 0 0" timestep="0.002" integrator="discrete"><flag contact="disable"/></option>
      <worldbody>
        <flexcomp name="slab" type="grid" dim="3" count="{count} {count} {layers + 1}" dof="trilinear"
          cellcount="{count - 1} {count - 1} {layers}" mass="{mass}" radius="1e-4"
          spacing="{spacing} {spacing} {case.depth_m / layers}">
          <elasticity young="{young}" poisson="{poisson}" damping="0.02"/>
          <contact selfcollide="none"/>
          <pin gridrange="0 0 0 {count - 1} {count - 1} 0"/>
        </flexcomp>
      </worldbody>
    </mujoco>""")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    bodies = model.flex_nodebodyid
    places = data.xpos[bodies]
    face = np.flatnonzero((bodies > 0) & (places[:, 2] > 0.49 * case.depth_m))
    # Nodal forces of bilinear functions: the spot summed on a grid ten times finer
    fine = (np.arange(10 * (count - 1)) + 0.5) / 10.0
    hats = np.maximum(0.0, 1.0 - np.abs(fine - np.arange(count)[:, None]))
    x = spacing * fine - HALF_M
    spot = pressure(case, x[:, None], x[None, :]) * (spacing / 10.0) ** 2
    nodal = hats @ spot @ hats.T
    i, j = np.rint((places[face, :2] + HALF_M) / spacing).astype(int).T
    down = model.body_dofadr[bodies[face]] + 2
    data.qfrc_applied[down] = -PUSH_Pa * nodal[i, j]
    middle = down[int(np.argmin(np.linalg.norm(places[face, :2], axis=1)))]
    last = 0.0
    for _ in range(SETTLE_STEPS):
        mujoco.mj_step(model, data, 10)
        push = -data.qpos[middle] / PUSH_Pa
        if abs(push - last) < 1e-4 * abs(push):
            return float(push), None, model.nv
        last = push
    return None, None, model.nv


def _solve(case: Case, matrices: list[Any], force: np.ndarray, read: int) -> tuple[float, complex]:
    """Return the displacement at one unknown from deviatoric and volumetric stiffness and mass of unit constants."""
    deviatoric, volumetric, inertia = matrices
    answers = []
    for f_Hz in (0.0, F_Hz):
        shear, bulk = moduli(case, f_Hz)
        mass = case.material.density_kg_m3 * (2.0 * math.pi * f_Hz) ** 2
        matrix = shear * deviatoric + bulk * volumetric - mass * inertia
        if f_Hz == 0.0:
            matrix = matrix.real
        lu = splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}, diag_pivot_thresh=0.0)
        answers.append(-lu.solve(force.astype(matrix.dtype))[read])
    return float(answers[0].real), complex(answers[1])


def _scipy(matrix: Any) -> Any:
    """Return a block-sparse matrix of Warp as a matrix of SciPy."""
    from scipy.sparse import bsr_array

    count = matrix.nnz_sync()
    blocks = matrix.values.numpy()[:count].reshape(count, 3, 3)
    return bsr_array(
        (blocks, matrix.columns.numpy()[:count], matrix.offsets.numpy()), shape=(3 * matrix.nrow, 3 * matrix.ncol)
    ).tocsr()


def main() -> None:
    """Solve with one program on one mesh, twice, and print the second answer as JSON; task of a process."""
    name, cells, layers = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    run = {"scikit_fem": scikit_fem, "warp_fem": warp_fem, "mujoco_flex": mujoco_flex}[name]
    with threadpool_limits(1):
        run(CASE, cells, layers)
        begin = time.perf_counter()
        static, moving, unknowns = run(CASE, cells, layers)
        seconds = time.perf_counter() - begin
    answer: dict[str, Any] = {"static": static, "unknowns": unknowns, "seconds": seconds}
    answer["moving"] = None if moving is None else [moving.real, moving.imag]
    print(json.dumps(answer))


if __name__ == "__main__":
    main()
