"""ARP along a predicted path, on bodies at rest. It is computed from a few stored fields."""

from typing import TYPE_CHECKING

from palmfield.simulation.cached import Cached
from palmfield.simulation.model import HapticModel
from palmfield.simulation.posed_scene import SERIAL, PosedScene
from palmfield.simulation.radiation import Radiation
from palmfield.simulation.skin_sound import Role
from palmfield.simulation.small_models.known_load import path_drives
from palmfield.types import Complex, Float32

if TYPE_CHECKING:
    from palmfield.acoustics.spanned_arp import SpannedArp, SpannedFields


class PathSound:
    """Computes ARP on the skins of a model and on their bodies. It belongs to one state and to one thread at a time.

    off: number of consecutive courses that left the path
    reference: result of `reference_scene`; the stored fields are valid only in this pose
    """

    def __init__(
        self, model: HapticModel, radiation: Radiation, reference: PosedScene, beside: "PathSound | None" = None
    ):
        """beside: PathSound of another world that the same thread steps. Both share results for the same stimuli"""
        self.model, self.radiation, self.reference = model, radiation, reference
        self.off = 0
        same = beside is not None and beside.model.spec.stimuli == model.spec.stimuli
        self._fields: Cached = beside._fields if beside is not None and same else Cached()
        self._arp = Cached()  # with buffers of its own

    def adopt(self, other: "PathSound") -> None:
        """Copy the results of another state of the same model."""
        self.reference, self.off, self._arp = other.reference, other.off, Cached()
        self._fields.adopt(other._fields)

    def holds(self, posed: PosedScene) -> bool:
        """Return whether arrays and bodies are in the reference pose."""
        still = posed.arrays.serial == self.model.arrays.serial
        return still and list(map(SERIAL, posed.bodies)) == list(map(SERIAL, self.reference.bodies))

    def arp(self, posed: PosedScene, skin: int, role: Role, drives: Complex) -> Float32 | None:
        """Return the ARP [Pa] of drives (m, N) at the points of a skin for a role, shape (m, n).

        The result is None if the pose differs, if a drive is off the path, or if the stored fields cannot represent its
        sound. Otherwise it is a view of a buffer; the next call with the same number of drives overwrites it.
        """
        if not self.holds(posed):
            return None
        name = skin, role, self.radiation.chosen[skin].serial if role == "load" else 0
        fields = self._fields.of(name, (), self._make, posed, skin, role)
        return None if fields is None else self._arp.of(name, (), self._spanned, fields).evaluate(drives)

    def _spanned(self, fields: "SpannedFields") -> "SpannedArp":
        from palmfield.acoustics.spanned_arp import SpannedArp

        return SpannedArp(fields)

    def _make(self, posed: PosedScene, skin: int, role: Role) -> "SpannedFields | None":
        from palmfield.acoustics.spanned_arp import drives_span, spanned_fields  # few scenes have such a path

        model = self.model
        basis = self._fields.of("span", (), lambda: drives_span(path_drives(model, self.reference)))
        *_, points, normals, _, _ = self.radiation.points(posed, skin, role)
        if basis is None or len(points) == 0:
            return None
        return spanned_fields(model.arrays.field, points, normals, basis, model.skins[skin].spec.arp_law)
