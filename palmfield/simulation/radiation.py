"""ARP on the surfaces of a posed scene, and its force on the bodies that carry skin, with caches.

A Radiation belongs to one state and is used by one thread at a time. It stores buffers for the points of each skin. It
also stores the last ARP for each role, under the serial numbers of pose and drive.
"""

import numpy as np

from palmfield.acoustics.arp import SurfaceSound
from palmfield.acoustics.surface_arp import SurfaceArp
from palmfield.acoustics.surface_load import Parts, pushes, resultants
from palmfield.drive.transducer_response import EmittedCourse
from palmfield.simulation.cached import Cached
from palmfield.simulation.model import HapticModel, SkinModel
from palmfield.simulation.posed_scene import PosedScene
from palmfield.simulation.skin_sound import ChosenPoints, FreeSound, Key, Role, SkinPoints, Solution, VisibleSamples
from palmfield.types import Complex, Float, Float32, Int

ALWAYS = np.ones(1, dtype=bool)


class Radiation:
    """Computes ARP at the points of the skins of a model.

    cached: results that a copy of the state uses again; chosen: for each skin, its points for the role "load"
    """

    def __init__(self, model: HapticModel, beside: "Radiation | None" = None):
        """beside: Radiation of another world with the same thread; buffers and search trees are shared, results not"""
        self.model, self.cached = model, Cached()
        # Buffers and trees, moved in place; and all points ever chosen, stored so that ids of arrays stay unique
        self._shared: Cached = Cached() if beside is None else beside._shared
        self._choices: Cached = Cached() if beside is None else beside._choices
        self.chosen: dict[int, ChosenPoints] = {} if beside is None else beside.chosen
        self._sound = [self._sound_on(skin) for skin in model.skins]

    def _sound_on(self, skin: SkinModel) -> FreeSound:
        """Make the object for shadows and scattering of a skin. Only the code that it needs is loaded."""
        kind = skin.spec.config.body_sound
        if kind == "none":
            return FreeSound()
        from palmfield.simulation.shadows import BentSound, ScatteredSound, ShadedSound

        if kind == "scattering":
            return ScatteredSound(self.model, self.cached)
        return (BentSound if bends(skin) else ShadedSound)(self.model, self._shared)

    def choose(self, skin: int, points: Int) -> None:
        """Set the points for the role "load": numbers of quadrature points of a skin, shape (p,)."""
        if skin not in self.chosen or self.chosen[skin].numbers is not points:
            self.chosen[skin] = self._choices.of((skin, id(points)), (), ChosenPoints, self.model.skins[skin], points)

    def on(self, posed: PosedScene, skin: int, role: Role, drive: Complex, serial: int = 0) -> SurfaceSound:
        """Return the ARP at quadrature points, force samples or surface nodes of a skin. drive: emission, shape (N,)

        serial: serial number of the drive, which is the key of the stored result; 0 for a drive without one
        """
        if serial:
            key = *self._places(posed, skin, role), serial
            return self.cached.of(("sound", skin, role), key, self.on, posed, skin, role, drive)
        return self._sound[skin].sound(self.points(posed, skin, role), drive)

    def patterns(self, posed: PosedScene, skin: int, role: Role, course: EmittedCourse) -> Float32:
        """Return the patterns of ARP [Pa] to which the `weights` of a course apply, shape (p, n)."""
        if len(course.units) == 0:
            return np.zeros((1, len(self.points(posed, skin, role)[3])), np.float32)
        if len(course.units) == 1:
            return self.on(posed, skin, role, course.units[0], course.serial).arp[None]
        if len(course.units) < len(course.levels):
            return self.sums(posed, skin, course.units, course.levels, role)
        if course.batch is not None:
            key = *self._places(posed, skin, role), course.batch.serial
            batch = self.cached.of(("batch", skin, role), key, self.many, posed, skin, course.batch.drives, role)
            return batch[course.row : course.row + len(course.units)]
        # An unchanged emission is computed once
        changes = np.logical_or.reduce(course.units[1:] != course.units[:-1], axis=1)
        if np.logical_and.reduce(changes):
            return self.many(posed, skin, course.units, role)
        first = np.concatenate((ALWAYS, changes))
        computed = self.many(posed, skin, course.units[first], role)
        return np.asarray(computed[np.add.accumulate(first, dtype=np.intp) - 1])

    def _places(self, posed: PosedScene, skin: int, role: Role) -> Key:
        """Return a key, equal while the points of a skin for a role and all bodies in the sound's path do not move."""
        return posed.sound_keys[skin] if role != "load" else (*posed.sound_keys[skin], self.chosen[skin].serial)

    def many(
        self, posed: PosedScene, skin: int, drives: Complex, role: Role = "quadrature", peaks: Float32 | None = None
    ) -> Float32:
        """Return the ARP as `on` does, for several drives of shape (m, N); the result has shape (m, n).

        peaks: array to fill with the peak amplitudes of the pressures [Pa], shape (m, n)
        """
        at, sound = self.points(posed, skin, role), self._sound[skin]
        if sound.one_by_one:
            each = [sound.sound(at, drive) for drive in drives]
            if peaks is not None:
                peaks[:] = [one.amplitude for one in each]
            return np.stack([one.arp for one in each])
        *_, points, normals, _, field = at
        shades = sound.shades(at) if sound.bends else None
        return field.evaluate_many(points, normals, drives, shades=shades, amplitudes=peaks)

    def sounds(self, posed: PosedScene, skin: int, drives: Complex, role: Role = "quadrature") -> SurfaceSound:
        """Return ARP as `many` does, and the peak amplitudes of the pressures, shapes (m, n)."""
        peaks = np.empty((len(drives), len(self.points(posed, skin, role)[3])), np.float32)
        return SurfaceSound(self.many(posed, skin, drives, role, peaks), peaks)

    def sums(self, posed: PosedScene, skin: int, units: Complex, levels: Complex, role: Role = "quadrature") -> Float32:
        """Return ARP as `many` does, for the drives levels (m, k) @ units (k, N) with a small k; shape (m, n)."""
        if self.model.skins[skin].spec.config.body_sound != "none":
            return self.many(posed, skin, levels @ units, role)
        *_, points, normals, _, field = self.points(posed, skin, role)
        return field.evaluate_sums(points, normals, units, levels)

    def at(
        self, posed: PosedScene, skin: int, role: Role, points: Float, normals: Float, drive: Complex
    ) -> SurfaceSound:
        """Return the ARP at any points of the body of a skin, with outward normals; array frame, shapes (n, 3)."""
        name = "field", skin, role, len(points)
        field = self._shared.of(name, posed.arrays.serial, self._field, posed, skin, len(points))
        return self._sound[skin].sound((posed, skin, role, points, normals, None, field), drive)

    def many_at(self, posed: PosedScene, skin: int, points: Float, normals: Float, drives: Complex) -> Float32:
        """Return the ARP as `at` does, for several drives of shape (m, N) in the free field; shape (m, n)."""
        name = "field", skin, "probe", len(points)
        field = self._shared.of(name, posed.arrays.serial, self._field, posed, skin, len(points))
        return field.evaluate_many(points, normals, drives)

    def force(self, posed: PosedScene, body: int, arp: Float | Float32) -> Float:
        """Return forces [N] on the parts of a body and torques about their origins [N m], world axes, shape (2, b, 3).

        arp: ARP at the samples of the body [Pa], shape (n,)
        """
        surface = posed.bodies[body]
        key = posed.arrays.serial, surface.serial
        of_unit, parts = self.cached.of(("push", body), key, self._of_unit_pressure, posed, body)
        return np.array(resultants(arp, of_unit, surface.origins, parts)) @ posed.array_frame.rotation.T

    def _of_unit_pressure(self, posed: PosedScene, body: int) -> tuple[Float, Parts]:
        """Return the effect of a unit pressure on each sample of a body (see `pushes`), and the part of each sample."""
        points, normals, areas, numbers = self.samples(posed, self.model.first_skins[body])
        surface = posed.bodies[body]
        return pushes(areas, normals, points), Parts(surface.sample_parts[numbers], len(surface.origins))

    def solution(self, skin: int) -> Solution | None:
        """Return the last boundary-element solution for the body of a skin."""
        return self.cached.last(("solution", skin))  # type: ignore[no-any-return]

    def adopt(self, skin: int, solution: Solution) -> None:
        """Store a boundary-element solution for the body of a skin."""
        key = Solution.key(solution.posed, skin, solution.drive)
        self.cached.of(("solution", skin), key, lambda: solution)

    def continue_from(self, other: "Radiation") -> None:
        """Copy the results of another Radiation, for a copy of its state in the same PosedScenes."""
        self.cached.adopt(other.cached)
        self._choices.adopt(other._choices)

    def points(self, posed: PosedScene, skin: int, role: Role) -> SkinPoints:
        """Return points [m] and outward normals of a skin or its body, array frame, shapes (n, 3)."""
        part, numbers = posed.skins[skin], None
        if role == "load":
            chosen, move = self.chosen[skin], part.body.moved
            points, normals = self.cached.of(("load", skin), (part.serial, chosen.serial), move, *chosen.rest)
            numbers = chosen.numbers
        elif role == "samples":
            # The same as `samples`, inlined to save a call
            key, inputs = (posed.arrays.serial, part.body.serial), (self._sound[skin].samples, part.body, posed.arrays)
            points, normals, _, numbers = self.cached.of(("samples", skin), key, *inputs)
        else:
            points, normals = part.nodes if role == "nodes" else part.quadrature
        name = "field", skin, role, len(points)
        field = self._shared.of(name, posed.arrays.serial, self._field, posed, skin, len(points))
        return posed, skin, role, points, normals, numbers, field

    def samples(self, posed: PosedScene, skin: int) -> VisibleSamples:
        """Return the force samples of a body that face the arrays; all samples if sound is diffracted around it."""
        body, arrays = posed.skins[skin].body, posed.arrays
        return self.cached.of(("samples", skin), (arrays.serial, body.serial), self._sound[skin].samples, body, arrays)

    def _field(self, posed: PosedScene, skin: int, count: int) -> SurfaceArp:
        """Return the field evaluator for this number of points of a skin."""
        return SurfaceArp(posed.arrays.field, count, self.model.skins[skin].spec.arp_law)


def bends(skin: SkinModel) -> bool:
    """Return whether sound is diffracted around the obstacles that cast shadows on a skin."""
    config = skin.spec.config
    return config.body_sound == "shadows" and config.shadow_edges == "knife_edge"
