"""Everything of a scene that does not change while it runs: array, device, surface, skin layer, matrices."""

import math
import threading
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from palmfield.aim import Aim
from palmfield.config import Side
from palmfield.device import resolve
from palmfield.drive.device import DEVICES
from palmfield.emission import response
from palmfield.emitter import Emitter, Placement
from palmfield.engine.pose import Pose, seen_from
from palmfield.errors import SceneError
from palmfield.foresight import Choice, choice
from palmfield.hand.meshfile import load_mesh
from palmfield.hand.patch import surface_patch
from palmfield.hand.preset import load_preset
from palmfield.hand.rigged import joint_of_body
from palmfield.hand.skinning import SkinnedHand, SkinnedSurface, rigged_file, skinned_mesh
from palmfield.hand.surface import hand_surface
from palmfield.limits import check_body_sound, check_device
from palmfield.posed import Bound, PosedBody
from palmfield.setting import Setting
from palmfield.skin.approximation.estimate import choose_sizes
from palmfield.skin.fem.assembly import SkinSystem, assemble
from palmfield.skin.fem.load import SurfaceQuadrature
from palmfield.skin.fem.solver import SkinSolver
from palmfield.skin.from_config import base_of, sheets_of, slowest
from palmfield.skin.mesh.disc import disc_patch
from palmfield.skin.mesh.rows import rows_of
from palmfield.skin.mesh.surface import closed_boundary
from palmfield.skin.mesh.wedges import WedgeMesh, extrude
from palmfield.skin.reduction.stepping import FullSkin, ReducedSkin
from palmfield.stimulus.schedule import SitesStimulus, frame_at, main_frequencies, plane_path
from palmfield.stimulus.surface_path import SkinPath, drawn, through
from palmfield.types import Complex, Float, Int, Patch, Surface

# The rules are calibrated on a disc of even depth. A hand's layer thins at rims and webs, differently on each mesh: its
# 200 Hz response still moves by 2.5 % where the disc's is within 0.5 %.
UNEVEN = 6.0


T = TypeVar("T")


class once(cached_property[T]):
    """A cached property that several threads may ask for: the first one computes, the others wait."""

    def __get__(self, instance: Any, owner: Any = None) -> Any:
        if instance is None:
            return self
        with instance.lock:
            return super().__get__(instance, owner)


class Rig:
    """The static part of a scene. Costly parts are made when first asked for, once, also from several threads."""

    def __init__(self, setting: Setting, resizing: float = 1.0):
        self.setting, self.resizing = setting, resizing
        self.body, self.duration_s = setting.body, setting.duration_s
        self.stepper: FullSkin | ReducedSkin | None = None
        self.boards, self.skin, self.driver = setting.boards, setting.skin, setting.driver
        self.timestep_s = setting.timestep_s
        self.stimulus_frame, self.patch_centre = setting.stimulus_frame, np.array(setting.patch_centre)
        self.lock = threading.RLock()
        self._posed: list[tuple[Pose, PosedBody]] = []
        resolve(setting.boards[0].config.compute)
        self.device = DEVICES[setting.driver.device]
        self.sheets = sheets_of(setting.skin)
        self.material = self.sheets[0].material
        self.stimulus = setting.stimulus
        if self.stimulus.path == "sites":
            assert self.skin_path is not None
            known = self.stimulus.model_dump(exclude_unset=True)
            self.stimulus = SitesStimulus(**known, sites_length_m=float(self.skin_path.arc_m[-1]))
        placements = tuple(board.placement for board in self.boards)
        self.reference_emitter = Emitter(self.boards, placements, self.stimulus, self.device)
        self.air, self.array = self.reference_emitter.air, self.reference_emitter.array
        self._emitters = [self.reference_emitter]
        check_device(self)
        self.reference_foci = focus = self.reference_aim(frame_at(self.stimulus, self.stimulus.start_s).focus)
        self.reference_focus: Float = np.atleast_2d(focus)[0]
        self.silent = not np.any(self.unit_drive(focus)[0])
        self.response = response(
            self.boards, self.reference_emitter, self.stimulus, self.reference_aim, self.reference_focus,
            self.skin.accuracy, spread=self.skin.body_sound != "scattering",
        )  # fmt: skip
        check_body_sound(self)

    # -- poses and places ------------------------------------------------------------------------------------------

    @once
    def reference_pose(self) -> Pose:
        """The pose that MuJoCo's reference configuration gives."""
        turn = np.array(self.body.rotation).reshape(3, 3)
        others = [(np.array(place.position), np.reshape(place.rotation, (3, 3))) for _, place in self.setting.obstacles]
        if self.hand is not None:
            others = [(bone.origin, np.eye(3)) for bone in self.hand.bones] + others
        still = np.zeros(3), np.eye(3)
        placements = tuple(board.placement for board in self.boards)
        return Pose(np.array(self.body.position), turn, placements, seen_from(still, others))

    def posed(self, pose: Pose) -> PosedBody:
        """The body in a pose; two are kept."""
        with self.lock:
            for known, body in self._posed:
                if known.same_bones(pose):
                    return body
            made = PosedBody(self, pose.bones)
            # The reference pose, or the first that was asked for, and the last.
            self._posed = [*self._posed[:1], (pose, made)]
            return made

    @once
    def reference_aim(self) -> Aim:
        """Where the stimulus's points are in the reference pose."""
        frame = self.stimulus_frame
        return Aim(self, (np.array(frame.position), np.reshape(frame.rotation, (3, 3))), self.reference_pose)

    @once
    def skin_path(self) -> SkinPath | None:
        """The path that the focus takes on the resting surface, None for a path elsewhere."""
        stimulus = self.setting.stimulus
        if stimulus.path_on != "skin":
            return None
        element = "plugin 'palmfield.stimulus': key 'path_on' has value 'skin'"
        if self.surface is None:
            raise SceneError(f"{element}, but the skin's shape is a flat disc: set path_on to plane")
        try:
            if stimulus.path == "sites":
                return through(self.surface, np.array(self.setting.path_sites))
            path = plane_path(stimulus)
            assert path is not None
            turn, frame = np.reshape(self.body.rotation, (3, 3)), self.stimulus_frame
            axes = np.reshape(frame.rotation, (3, 3))
            start = np.array(frame.position) + axes @ np.array(stimulus.focus_m) - np.array(self.body.position)
            return drawn(self.surface, start @ turn, axes[:, 0] @ turn, path)
        except SceneError as error:
            raise SceneError(f"{element}: {error}") from None

    @once
    def path_reach_m(self) -> tuple[float, float]:
        """How far the path goes from the focus's middle, and from the middle of the skin layer [m]."""
        if self.skin_path is not None:
            assert self.surface is not None
            at, _ = self.skin_path.at(self.skin_path.arc_m, self.surface.vertices, self.surface.faces)
            reach = float(np.linalg.norm(at - self.patch_centre, axis=1).max())
            return reach, reach
        foci = np.reshape(self.stimulus.foci_m, (-1, 3))[:, :2]
        beside = float(np.hypot(*foci.T).max(initial=0.0))
        if self.stimulus.path_diameter_m:
            return (0.5 * self.stimulus.path_diameter_m + beside,) * 2
        path = plane_path(self.stimulus)
        reach = beside + (0.0 if path is None else float(np.hypot(*path.points.T).max()))
        return reach, reach

    # -- sound ---------------------------------------------------------------------------------------------------

    def emitter(self, placements: tuple[Placement, ...]) -> Emitter:
        """The arrays in this relative pose; the reference one and the last are kept."""
        with self.lock:
            for emitter in self._emitters:
                if emitter.same(placements):
                    return emitter
            made = Emitter(self.boards, placements, self.stimulus, self.device)
            self._emitters = [self.reference_emitter, made]
            return made

    def unit_drive(self, point: Float) -> tuple[Complex, float]:
        """What the arrays emit for a focus at `point` in the reference pose; see `Emitter.unit_drive`."""
        return self.reference_emitter.unit_drive(point)

    @once
    def spot_fwhm_m(self) -> float:
        """Full width at half maximum of |p|^2 around the reference focus, along the array's x axis [m]."""
        drive, _ = self.unit_drive(self.reference_focus)
        offset = np.linspace(0.0, 0.06, 241)
        points = self.reference_focus + offset[:, None] * np.array([1.0, 0.0, 0.0])
        square = np.abs(self.reference_emitter.pressure64(points, drive)) ** 2
        below = np.flatnonzero(square < 0.5 * square[0])
        return 2 * float(offset[below[0]]) if len(below) else 2 * float(offset[-1])

    def resized(self, factor: float, *, side: Side | None = None) -> "Rig":
        """The same scene with elements of `factor` times the plan's size, and perhaps other cut faces."""
        skin = self.skin if side is None else self.skin.model_copy(update={"side": side})
        return Rig(self.setting._replace(skin=skin), factor)

    # -- surface and skin ----------------------------------------------------------------------------------------

    @once
    def _hand(self) -> tuple[Surface, Float | float]:
        if self.skin.shape == "mesh":
            assert self.skin.mesh and self.skin.mesh_unit
            return load_mesh(Path(self.skin.mesh), self.skin.mesh_unit), self.skin.depth_m
        if self.skin.shape == "rigged":
            assert self.hand is not None
            return self.hand.surface, self.skin.depth_m
        hand = hand_surface(load_preset(self.skin.hand))
        return hand.surface, hand.depth_to_bone

    @once
    def hand(self) -> SkinnedSurface | None:
        """The skin with its bones of an articulated hand or a rigged mesh, None for a body in one piece."""
        if self.skin.shape == "rigged":
            assert self.skin.mesh and self.skin.mesh_unit
            mesh = rigged_file(self.skin.mesh, self.skin.mesh_unit)
            joint, _ = joint_of_body(self.skin.body, mesh.joints)
            return skinned_mesh(mesh, mesh.joints.rest[joint, :3, 3])
        return SkinnedHand(load_preset(self.skin.hand)) if self.skin.shape == "articulated" else None

    @once
    def owners(self) -> Int:
        """The bone that each face of a surface with bones pushes, shape (m,)."""
        assert self.hand is not None
        return self.hand.dominant_bone()[self.hand.surface.faces[:, 0]]

    def bound(self, points: Float) -> Bound | None:
        """The bones that carry points of the resting skin [m], shape (n, 3); None for a body in one piece."""
        return None if self.hand is None else Bound.to(self.hand, points)

    @once
    def nodes_bound(self) -> Bound | None:
        """Bones of the skin layer's surface nodes."""
        return self.bound(self.mesh.nodes[: self.mesh.surface_nodes])

    @once
    def points_bound(self) -> Bound | None:
        """Bones of the points at which ARP on the skin is integrated."""
        return self.bound(self.quadrature.points)

    @once
    def obstacles(self) -> list[tuple[Float, Int]]:
        """Meshes [m] of what casts shadows besides the body, each in its own body's frame."""
        return [obstacle.mesh() for obstacle, _ in self.setting.obstacles]

    @property
    def surface(self) -> Surface | None:
        """The whole closed surface in the body frame; None for a disc, whose lit face is the skin itself."""
        return None if self.skin.shape == "disc" else self._hand[0]

    @property
    def closed_surface(self) -> tuple[Float, Int]:
        """Vertices [m] and faces of the body that the sound meets, closed, in the body frame."""
        return closed_boundary(self.mesh) if self.surface is None else (self.surface.vertices, self.surface.faces)

    @once
    def max_frequency_Hz(self) -> float:
        """Highest frequency that mesh and step resolve."""
        if self.skin.max_frequency_Hz is not None:
            return self.skin.max_frequency_Hz
        return max([200.0, *main_frequencies(self.stimulus)])

    @property
    def main_frequency_Hz(self) -> float:
        """Frequency of most of the skin's response: the lowest of the stimulus, or half of the highest resolved."""
        return next(iter(main_frequencies(self.stimulus)), 0.5 * self.max_frequency_Hz)

    @once
    def sizes(self) -> tuple[float, float, float, Float, float, float]:
        """Edge at the focus, edge at the rim, radius of the fine part [m], depth fractions, step [s], radius [m]."""
        s = self.skin
        wanted = (slowest(self.sheets, self.max_frequency_Hz), self.spot_fwhm_m, self.max_frequency_Hz)
        *_, step, radius = choose_sizes(*wanted, s.accuracy)
        uneven = 1.0 if s.shape == "disc" else UNEVEN
        fine, coarse, fine_radius, fractions, _, _ = choose_sizes(*wanted, max(s.accuracy / uneven, 1e-3))
        shares = np.asarray(fractions)
        if s.element_m is not None:
            coarse, fine = max(coarse * s.element_m / fine, s.element_m), s.element_m
        if self.resizing != 1.0:
            fine, coarse = fine * self.resizing, coarse * self.resizing
            layers = (len(shares) - 1) / self.resizing
            layers = math.ceil(layers) if self.resizing < 1 else max(1, math.floor(layers))
            shares = np.interp(np.linspace(0, 1, layers + 1), np.linspace(0, 1, len(shares)), shares)
        shares, _ = rows_of(self.sheets, shares)
        near, far = self.path_reach_m
        fine_radius, radius = fine_radius + near, radius + far
        radius = s.radius_m or s.patch_radius_m or radius
        # A small patch of a curved body needs some triangles for its shape, whatever the accuracy.
        coarse = min(coarse, (0.5 if s.shape == "disc" else 0.25) * radius)
        fine = min(fine, coarse)
        step = s.step_s or step
        count = math.ceil(self.timestep_s / step - 1e-9)
        if s.step_s is not None and abs(count * s.step_s - self.timestep_s) > 1e-9:
            raise SceneError(
                f"plugin 'palmfield.skin': step_s {s.step_s:g} must divide the timestep {self.timestep_s:g}"
            )
        return fine, coarse, min(fine_radius, radius), shares, self.timestep_s / count, radius

    @once
    def patch(self) -> Patch:
        """The part of the surface that gets a skin layer."""
        fine, coarse, fine_radius, _, _, radius = self.sizes
        if self.skin.shape == "disc":
            assert self.skin.radius_m and self.skin.thickness_m
            return disc_patch(self.skin.radius_m, self.skin.thickness_m, fine, coarse, fine_radius)
        surface, depth = self._hand
        # A hand knows where its bones are, so the layer may reach past the middle; any other body is all there is.
        fraction = 0.45 if self.skin.shape in ("mesh", "rigged") else 0.6
        try:
            return surface_patch(
                surface,
                depth,
                self.patch_centre,
                radius,
                fine,
                coarse,
                fine_radius,
                max_depth_m=self.skin.depth_m,
                max_fraction=fraction,
            )
        except SceneError as error:
            raise _with_keys(error) from None

    @once
    def mesh(self) -> WedgeMesh:
        """The skin layer's elements."""
        patch = self.patch
        try:
            return extrude(patch, self.sizes[3])
        except SceneError as error:
            raise _with_keys(error) from None

    @once
    def system(self) -> SkinSystem:
        """Mass and stiffness."""
        rows = rows_of(self.sheets, self.sizes[3])[1]
        return assemble(
            self.mesh, rows, base=base_of(self.skin), side=self.skin.side, foundation_Pa_m=self.skin.foundation,
            absorbing_Hz=self.main_frequency_Hz,
        )  # fmt: skip

    @once
    def quadrature(self) -> SurfaceQuadrature:
        """Points of the skin at which ARP is integrated."""
        return SurfaceQuadrature(self.mesh, self.system)

    @once
    def solver(self) -> SkinSolver:
        """Time stepping with its factorised matrix."""
        return SkinSolver(self.system, self.sizes[4])

    @property
    def dofs(self) -> int:
        """Unknowns of the skin layer; roller and fixed sides take a few of them away."""
        held = self.skin.base == "bonded" and self.skin.foundation is None
        return 3 * (len(self.mesh.nodes) - (self.mesh.surface_nodes if held else 0))

    @once
    def choice(self) -> Choice:
        """Which solver steps the skin, and why. Raises SceneError where one is asked for that can't."""
        found = choice(self)
        if self.skin.solver == "reduced" and found.name != "reduced":
            raise SceneError(
                f"plugin 'palmfield.skin': key 'solver' has value 'reduced', but {found.why}: set it to auto"
            )
        return found

    @property
    def skin_room(self) -> int:
        """Numbers of state that the skin can need, for the whole layer: an upper bound without the matrices."""
        branches = sum(len(material.branches) for material in {sheet.material for sheet in self.sheets})
        return (3 + branches) * 3 * len(self.mesh.nodes)

    @property
    def state_size(self) -> int:
        """Numbers of state: skin, whether it is the whole layer's though a small model began, what is emitted."""
        return self.skin_room + 1 + (2 * len(self.array) if self.response.on else 0)


def _with_keys(error: SceneError) -> SceneError:
    return SceneError(
        f"plugin 'palmfield.skin': {error} (the scene's keys for these: patch_site, patch_radius_m, depth_m, element_m)"
    )


@lru_cache(maxsize=8)
def rig(setting: Setting) -> Rig:
    """The rig for a setting; equal ones share it, so that two models of one scene factorise once."""
    return Rig(setting)
