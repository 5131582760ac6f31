"""Everything of a scene that does not change while it runs: array, device, surface, skin layer, matrices."""

import math
import threading
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from palmfield.acoustics.air import sound_speed
from palmfield.acoustics.shadow import shadow_mesh
from palmfield.config import DriverConfig, Side, SkinConfig, StimulusConfig
from palmfield.device import resolve
from palmfield.drive.device import DEVICES, check
from palmfield.emission import response
from palmfield.emitter import Board, Emitter, Placement
from palmfield.errors import DeviceError, SceneError
from palmfield.foresight import Choice, choice
from palmfield.hand.meshfile import load_mesh
from palmfield.hand.patch import surface_patch
from palmfield.hand.preset import load_preset
from palmfield.hand.surface import hand_surface
from palmfield.obstacle import boundary_mesh
from palmfield.skin.assembly import SkinSystem, assemble
from palmfield.skin.disc import disc_patch
from palmfield.skin.estimate import choose_sizes
from palmfield.skin.from_keys import base_of, rows_of, sheets_of, slowest
from palmfield.skin.load import SurfaceQuadrature
from palmfield.skin.solver import SkinSolver
from palmfield.skin.stepping import FullSkin, ReducedSkin
from palmfield.skin.surface import closed_boundary
from palmfield.skin.wedges import WedgeMesh, extrude
from palmfield.stimulus import frame_at, frame_rates, main_frequencies
from palmfield.types import Complex, Float, Int, Patch, Surface

# The rules are calibrated on a disc of even depth. A hand's layer thins at rims and webs, differently on each mesh: its
# 200 Hz response still moves by 2.5 % where the disc's is within 0.5 %.
UNEVEN = 6.0
Triple = tuple[float, float, float]


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

    def __init__(
        self,
        boards: tuple[Board, ...],
        stimulus: StimulusConfig,
        skin: SkinConfig,
        driver: DriverConfig,
        timestep_s: float,
        stimulus_frame: Placement,
        patch_centre: Triple,
        body: Placement,
        duration_s: float,
        resizing: float = 1.0,
    ):
        self.resizing = resizing
        self.body, self.duration_s = body, duration_s
        self.stepper: FullSkin | ReducedSkin | None = None
        self.boards, self.stimulus, self.skin, self.driver = boards, stimulus, skin, driver
        self.timestep_s = timestep_s
        self.stimulus_frame, self.patch_centre = stimulus_frame, np.array(patch_centre)
        turn = np.array(stimulus_frame.rotation).reshape(3, 3)
        self.reference_focus = np.array(stimulus_frame.position) + turn @ frame_at(stimulus, stimulus.start_s).focus
        self.lock = threading.RLock()
        resolve(boards[0].config.compute)
        self.device = DEVICES[driver.device]
        self.sheets = sheets_of(skin)
        self.material = self.sheets[0].material
        self._placements = tuple(board.placement for board in boards)
        self.reference_emitter = Emitter(boards, self._placements, stimulus, self.device)
        self.air, self.array = self.reference_emitter.air, self.reference_emitter.array
        self._emitters = [self.reference_emitter]
        check_device(self)
        self.unit_drive(self.reference_focus)
        self.response = response(
            boards, self.reference_emitter, stimulus, stimulus_frame, self.reference_focus, skin.accuracy,
            spread=skin.body_sound != "scattering",
        )  # fmt: skip
        check_body_sound(self)

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
        return Rig(
            self.boards,
            self.stimulus,
            skin,
            self.driver,
            self.timestep_s,
            self.stimulus_frame,
            tuple(self.patch_centre),
            self.body,
            self.duration_s,
            resizing=factor,
        )

    @once
    def shadow_mesh(self) -> Any:
        """What casts shadows, in the body frame."""
        vertices, faces = self.closed_surface
        return shadow_mesh(Surface(vertices, faces, np.zeros_like(vertices)), self.reference_emitter.evaluator.device)

    @once
    def boundary_mesh(self) -> tuple[Float, Int]:
        """Boundary elements of the body, in its frame."""
        wavelength = sound_speed(self.air) / self.array.frequency_Hz
        return boundary_mesh(*self.closed_surface, wavelength)

    # -- surface and skin ----------------------------------------------------------------------------------------

    @once
    def _hand(self) -> tuple[Surface, Float | float]:
        if self.skin.shape == "mesh":
            assert self.skin.mesh and self.skin.mesh_unit
            return load_mesh(Path(self.skin.mesh), self.skin.mesh_unit), self.skin.depth_m
        hand = hand_surface(load_preset(self.skin.hand))
        return hand.surface, hand.depth_to_bone

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
        if self.stimulus.path_diameter_m:
            fine_radius += 0.5 * self.stimulus.path_diameter_m
            radius += 0.5 * self.stimulus.path_diameter_m
        radius = s.radius_m or s.patch_radius_m or radius
        coarse = min(coarse, 0.5 * radius)
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
        fraction = 0.6 if self.skin.shape == "hand" else 0.45
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


def check_body_sound(rig: Rig) -> None:
    """Refuse what boundary elements can't follow in sensible time: they solve once for a focus and a pose."""
    if rig.skin.body_sound != "scattering":
        return
    name = "plugin 'palmfield.skin': key 'body_sound' has value 'scattering'; allowed:"
    if rig.stimulus.path != "point":
        raise SceneError(f"{name} with path 'point' only, as each focus takes a solution of its own; use shadows")
    if rig.skin.arp_law != "default":
        raise SceneError(f"{name} with arp_law 'default' only; it has the total field")
    if rig.response.on and np.ptp(np.abs(rig.response.pole.rate)) > 0.0:
        raise SceneError(f"{name} with transducers that change together; set key 'response' of the array to off")


def check_device(rig: Rig) -> None:
    """Refuse a stimulus that the device cannot play (DeviceError) and a device on another array (SceneError)."""
    stimulus, device = rig.stimulus, rig.device
    if device.name == "ideal":
        return
    rates = frame_rates(stimulus)
    moving = stimulus.path != "point"
    if moving and not rates:
        raise DeviceError(
            f"plugin 'palmfield.stimulus': a path without steps needs any number of frames/s; {device.name} gives "
            f"{device.max_frame_rate_Hz:.1f}: set path_points and a path_rate_Hz that fit, or use device ideal"
        )
    turn = rates[0] / stimulus.path_rate_Hz if moving and stimulus.path_rate_Hz else None
    wants_level = stimulus.arp_peak_Pa is not None or stimulus.drive_amplitude not in (None, 0.0, 1.0)
    modulated = stimulus.modulation == "am"
    rate = max(rates) if rates else 0.0
    if modulated and not rates:
        rate = 10 * (stimulus.am_frequency_Hz or 0.0)
    check(device, frame_rate_Hz=rate, points_per_turn=turn, modulated=modulated, element="palmfield.stimulus")
    if stimulus.ramp_s > 0 or wants_level:
        raise DeviceError(
            f"plugin 'palmfield.stimulus': a ramp or a level between off and full needs continuous amplitude; "
            f"{device.name} gives on or off: drop ramp_s, arp_peak_Pa and drive_amplitude, or use device ideal"
        )
    if len(rig.boards) > 1:
        raise SceneError(
            f"plugin 'palmfield.driver': device '{device.name}' drives one array; the scene has "
            f"{len(rig.boards)} of 'palmfield.array': use device ideal"
        )
    layout = rig.boards[0].config.layout
    if layout != device.name:
        raise SceneError(
            f"plugin 'palmfield.driver': device '{device.name}' drives the layout '{device.name}' only; "
            f"plugin 'palmfield.array' has layout '{layout}': set it to '{device.name}'"
        )


def _with_keys(error: SceneError) -> SceneError:
    return SceneError(
        f"plugin 'palmfield.skin': {error} (the scene's keys for these: patch_site, patch_radius_m, depth_m, element_m)"
    )


@lru_cache(maxsize=8)
def rig(
    boards: tuple[Board, ...],
    stimulus: StimulusConfig,
    skin: SkinConfig,
    driver: DriverConfig,
    timestep_s: float,
    stimulus_frame: Placement,
    patch_centre: Triple,
    body: Placement,
    duration_s: float,
) -> Rig:
    """The rig for these configurations; equal ones share it, so that two models of one scene factorise once.

    boards: the scene's arrays; timestep_s: MuJoCo's step [s]
    stimulus_frame: frame of focus and path, in the frame of the first array, in the reference pose
    patch_centre: middle of the skin layer in the body frame [m]
    body: the skin's body in the frame of the first array, in the reference pose
    duration_s: how long the scene runs by default [s]
    """
    return Rig(boards, stimulus, skin, driver, timestep_s, stimulus_frame, patch_centre, body, duration_s)
