"""Skin layer of a scene: sizes for the target accuracy, patch, mesh, matrices and quadrature, each made once."""

import math
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse

from palmfield.config.skin import OF_SHAPES, Side, SkinConfig
from palmfield.errors import SceneError, naming
from palmfield.hand.patch import surface_patch
from palmfield.hand.preset import load_preset
from palmfield.hand.skeleton import MIRROR
from palmfield.hand.surface import mirrored_surface
from palmfield.locked import locked_cached_property
from palmfield.phases import phase
from palmfield.skin.approximation.estimate import choose_sizes
from palmfield.skin.base import Base, Foundation
from palmfield.skin.fem.assembly import SkinSystem, assemble
from palmfield.skin.fem.load import SurfaceQuadrature
from palmfield.skin.fem.probe import SurfaceProbe, surface_motion
from palmfield.skin.from_config import base_of, sheets_of, slowest
from palmfield.skin.materials.material import Sheet
from palmfield.skin.mesh.wedges import WedgeMesh, element_rows, extrude
from palmfield.types import Float, Patch, Surface

if TYPE_CHECKING:  # not imported at run time, because most layers are patches
    from palmfield.skin.covers import Covering

UNEVEN = 3.0
"""Factor by which a layer on a body is meshed more accurately than the target: the rules are calibrated on a disc of
even depth. On a palm (target 0.05, 200 Hz, 11 places within 18 mm), a mesh for a third of the target was compared with
12 times the unknowns: the median difference is 1.2 %, and 10 % at one place near a rim."""

RADIUS_STEP_M = 0.01
"""The radius of a patch is a multiple of this [m], so that similar stimuli share a patch. Rounding reduces the radius
of the rule by at most a quarter of this step."""
OF_MESH = ("patch_site", "patch_radius_m", "depth_m", "element_m")
"""Settings of the mesh of a layer."""
UNNAMED = naming("skin layer")


@dataclass(frozen=True)
class LayerSizes:
    """Sizes of the elements and steps of a layer.

    edge_fine_m, edge_coarse_m: element edges within fine_radius_m of the middle of the focus and at the rim [m].
    depth_fractions: depth fractions of the rows of elements, 0 at the surface, 1 at the base, shape (L+1,).
    step_s: substep [s]; a MuJoCo step has an integer number of substeps. radius_m: radius of the layer [m].
    """

    edge_fine_m: float
    edge_coarse_m: float
    fine_radius_m: float
    depth_fractions: Float
    step_s: float
    radius_m: float


@dataclass(frozen=True)
class LayerDemand:
    """Demands of the sound and the scene on a layer.

    spot_fwhm_m: full width at half maximum of the pressure spot [m].
    max_frequency_Hz: highest frequency that mesh and step must resolve.
    main_frequency_Hz: frequency of most of the response.
    path_reach_m: radius of the region of foci [m], and reach of the path, by which a patch grows [m].
    timestep_s: timestep of MuJoCo [s]. longest_step_s: upper limit of the substep [s].
    corner_Hz: approximate frequency above which the spectrum of the load falls; infinite if unknown.
    offset_m: from the centre of the layer to the middle of the region of foci, body frame [m]; 0 if the skin moves.
    """

    spot_fwhm_m: float
    max_frequency_Hz: float
    main_frequency_Hz: float
    path_reach_m: tuple[float, float]
    timestep_s: float
    longest_step_s: float = math.inf
    corner_Hz: float = math.inf
    offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)


def layer_sizes(
    config: SkinConfig,
    sheets: tuple[Sheet, ...],
    spot_fwhm_m: float,
    max_frequency_Hz: float,
    path_reach_m: tuple[float, float],
    timestep_s: float,
    resizing: float = 1.0,
    rows: int | None = None,
) -> LayerSizes:
    """Return the sizes of the layer of a scene for its target accuracy; see LayerDemand.

    sheets: sheets of the layer, thicknesses as shares. resizing: factor of all element sizes.
    rows: number of rows of elements in depth; default: the number for these sizes.
    Raises SceneError for a step_s that does not divide the timestep, and for a timestep that is not finite.
    """
    needs = slowest(sheets, max_frequency_Hz), spot_fwhm_m, max_frequency_Hz
    *_, step, radius = choose_sizes(*needs, config.accuracy)
    uneven = 1.0 if config.shape == "disc" else UNEVEN
    fine, coarse, fine_radius, fractions, _, _ = choose_sizes(*needs, max(config.accuracy / uneven, 1e-3))
    shares = np.asarray(fractions)
    if config.element_m is not None:
        coarse, fine = max(coarse * config.element_m / fine, config.element_m), config.element_m
    if resizing != 1.0:
        fine, coarse = fine * resizing, coarse * resizing
    if rows is None:
        rows_exact = (len(shares) - 1) / resizing
        rows = math.ceil(rows_exact) if resizing < 1 else max(1, math.floor(rows_exact))
    if rows != len(shares) - 1:
        shares = np.interp(np.linspace(0, 1, rows + 1), np.linspace(0, 1, len(shares)), shares)
    shares, _ = element_rows(sheets, shares)
    near, far = path_reach_m
    fine_radius, radius = fine_radius + near, radius + far
    radius = config.radius_m or config.patch_radius_m or RADIUS_STEP_M * math.ceil(radius / RADIUS_STEP_M - 0.25)
    # At any accuracy, a small patch of a curved body needs some triangles to represent its shape.
    coarse = min(coarse, (0.5 if config.shape == "disc" else 0.25) * radius)
    fine = min(fine, coarse)
    step = config.step_s or step
    if not math.isfinite(timestep_s / step):
        raise SceneError(
            f"the MuJoCo timestep of {timestep_s:g} s holds too many skin steps of {step:.2g} s; set timestep smaller"
        )
    count = math.ceil(timestep_s / step - 1e-9)
    if config.step_s is not None and abs(count * config.step_s - timestep_s) > 1e-9:
        raise SceneError(f"it must divide the timestep {timestep_s:g}", setting="step_s")
    return LayerSizes(fine, coarse, min(fine_radius, radius), shares, timestep_s / count, radius)


class SceneLayer:
    """One skin layer of a scene. Costly parts are made once, at first use; threads may share the layer.

    config: keys of the skin.
    surface: closed surface of the whole body in its frame; None for shape "disc".
    depth_m: largest depth of the layer below the vertices of the surface [m], shape (n,), or one number.
    centre_m: middle of the layer, body frame [m], shape (3,). demand: see LayerDemand.
    resizing, rows: factor of all element sizes, and number of rows; see `layer_sizes`.
    named: context that adds the name of the skin to errors.
    sheets: materials that replace those of the keys; the mesh is still that for the materials of the keys.
    """

    def __init__(
        self,
        config: SkinConfig,
        surface: Surface | None,
        depth_m: Float | float,
        centre_m: Float,
        demand: LayerDemand,
        *,
        resizing: float = 1.0,
        rows: int | None = None,
        named: naming = UNNAMED,
        sheets: tuple[Sheet, ...] | None = None,
    ) -> None:
        self.config, self.surface, self.depth_m, self.centre_m = config, surface, depth_m, centre_m
        self.demand, self.resizing, self.rows, self.named = demand, resizing, rows, named
        with named:
            self.sheets = sheets_of(config) if sheets is None else sheets
        self.lock = threading.RLock()

    def resized(self, factor: float, rows: int | None = None) -> "SceneLayer":
        """Return the layer with elements of `factor` times the chosen size; rows: another number of rows, or None."""
        return SceneLayer(
            self.config, self.surface, self.depth_m, self.centre_m, self.demand,
            resizing=factor, rows=rows, named=self.named,
        )  # fmt: skip

    def altered(self, *, side: Side | None = None, sheets: tuple[Sheet, ...] | None = None) -> "SceneLayer":
        """Return the layer with the same elements and other cut faces or materials."""
        config = self.config if side is None else self.config.model_copy(update={"side": side})
        return SceneLayer(
            config, self.surface, self.depth_m, self.centre_m, self.demand,
            resizing=self.resizing, rows=self.rows, named=self.named, sheets=sheets,
        )  # fmt: skip

    @locked_cached_property
    def sizes(self) -> LayerSizes:
        """Sizes of elements, patch and step."""
        demand = self.demand
        with self.named:
            sizes = layer_sizes(
                self.config, sheets_of(self.config), demand.spot_fwhm_m, demand.max_frequency_Hz, demand.path_reach_m,
                demand.timestep_s, self.resizing, self.rows,
            )  # fmt: skip
        sizes = sizes if self.cover is None else replace(sizes, **self.cover.sizes(sizes, self.resizing))
        return replace(sizes, step_s=min(sizes.step_s, demand.longest_step_s))

    @locked_cached_property
    def cover(self) -> "Covering | None":
        """Extent of a layer that covers a hand; None for a patch. Raises SceneError if the palm is unknown."""
        if self.config.cover == "patch":
            return None
        from palmfield.skin.covers import covering  # few scenes have one

        with self.meshing():
            return covering(self.config, self.surface, self.depth_m, self.centre_m)

    @property
    def step_s(self) -> float:
        """Substep [s]."""
        return self.sizes.step_s

    @locked_cached_property
    def patch(self) -> Patch:
        """Return the part of the surface with a layer. Raises SceneError if it cannot be made."""
        config, sizes = self.config, self.sizes
        # With equal edges there is no fine region, and a regular mesh round the middle is better
        offset = self.demand.offset_m if sizes.edge_fine_m < sizes.edge_coarse_m else (0.0, 0.0, 0.0)
        if config.shape == "disc":
            assert config.radius_m and config.thickness_m
            from palmfield.skin.mesh.disc import disc_patch

            x, y, _ = offset
            edges = sizes.edge_fine_m, sizes.edge_coarse_m, sizes.fine_radius_m
            return disc_patch(config.radius_m, config.thickness_m, *edges, (x, y))
        # The layer of a hand preset, which has bones, may reach past the middle; other bodies have no bones.
        fraction = 0.6 if config.shape in OF_SHAPES["hand"] else 0.45
        if self.cover is not None:
            with self.meshing():
                return self.cover.patch(config, sizes, fraction, self.centre_m, self.centre_m + offset, self.resizing)
        assert self.surface is not None
        # The mesh of a left hand is the mirror image of the mesh of the right hand, like its surface
        left = config.shape in OF_SHAPES["hand"] and load_preset(config.hand).side == "left"
        surface, mirror = (mirrored_surface(self.surface), MIRROR) if left else (self.surface, np.ones(3))
        with self.meshing():
            patch = surface_patch(
                surface,
                self.depth_m,
                self.centre_m * mirror,
                sizes.radius_m,
                sizes.edge_fine_m,
                sizes.edge_coarse_m,
                sizes.fine_radius_m,
                max_depth_m=config.depth_m,
                max_fraction=fraction,
                fine_at=(self.centre_m + offset) * mirror if any(offset) else None,
            )
        if left:
            faces = patch.faces[:, ::-1].copy()
            patch = replace(patch, vertices=patch.vertices * mirror, inward=patch.inward * mirror, faces=faces)
        through = patch.report["through_m"]
        if "depth_m" in config.model_fields_set and config.depth_m > through:
            with self.named:
                raise SceneError(
                    f"the body below the layer is {through:.3g} m thick; allowed: a layer of at most {fraction:g} of "
                    "this thickness",
                    setting="depth_m",
                )
        return patch

    @locked_cached_property
    def mesh(self) -> WedgeMesh:
        """Mesh of the layer."""
        patch = self.patch
        with self.meshing():
            return phase("elements")(extrude)(patch, self.sizes.depth_fractions)

    @contextmanager
    def meshing(self) -> Iterator[None]:
        """Add the name of the skin and the settings of its mesh to errors raised in the block."""
        with self.named, naming(mends=OF_MESH if self.config.cover == "patch" else OF_MESH[::2]):
            yield

    @property
    def base(self) -> Base:
        """The base of the layer, unless keys foundation_... replace it."""
        return base_of(self.config, self.sheets)

    @property
    def _levels_below(self) -> int:
        return self.base.levels if isinstance(self.base, Foundation) else 0

    @locked_cached_property
    def system(self) -> SkinSystem:
        """Mass, damping and stiffness."""
        materials = element_rows(self.sheets, self.sizes.depth_fractions)[1]
        return assemble(
            self.mesh, materials, base=self.base, side=self.config.side,
            foundation_Pa_m=self.config.foundation, absorbing_Hz=self.demand.main_frequency_Hz,
        )  # fmt: skip

    @locked_cached_property
    def quadrature(self) -> SurfaceQuadrature:
        """Return the integration points of ARP on the skin; its `operator` is the input operator of the steppers."""
        return SurfaceQuadrature(self.mesh, self.system)

    @locked_cached_property
    def surface_operator(self) -> sparse.csr_matrix:
        """Matrix from unknowns to displacement along the outward normal at the surface nodes, shape (S, ndof)."""
        return surface_motion(self.mesh, self.system)

    def probe(self, point: Float) -> SurfaceProbe:
        """Return the reader of the displacement at the skin points nearest to `point`, [m], (3,) or (p, 3)."""
        return SurfaceProbe(self.mesh, np.atleast_2d(point), self.system)

    @property
    def dofs(self) -> int:
        """Return the number of unknowns without making matrices; roller and fixed sides remove a few of them."""
        held = self.config.base == "bonded" and self.config.foundation is None
        return 3 * (len(self.mesh.nodes) + self.mesh.surface_nodes * (self._levels_below - held))

    @property
    def expected_dofs(self) -> float:
        """Expected number of unknowns of the layer, computed only from its sizes."""
        sizes = self.sizes
        inner = min(sizes.fine_radius_m, sizes.radius_m)
        middle = 0.5 * (sizes.edge_fine_m + sizes.edge_coarse_m)
        # An equilateral triangle of edge a has the area 0.43 a^2; quadratic wedges have 2 nodes per triangle and level.
        fine = inner / sizes.edge_fine_m
        triangles = math.pi / 0.43 * (fine * fine + (sizes.radius_m**2 - inner**2) / middle / middle)
        triangles = triangles if self.cover is None else self.cover.triangles(sizes)
        below = self._levels_below + 1 if self._levels_below else 0
        return 3.0 * 2.0 * triangles * (2.0 * (len(sizes.depth_fractions) - 1) + below)

    @property
    def state_room(self) -> int:
        """Return an upper bound of the state size for any stepper of the layer, without making matrices."""
        below = self.base.sheets if isinstance(self.base, Foundation) else ()
        materials = {sheet.material for sheet in (*self.sheets, *below)}
        branches = sum(len(material.relaxation.branches) for material in materials)
        return (3 + branches) * 3 * (len(self.mesh.nodes) + self._levels_below * self.mesh.surface_nodes)
