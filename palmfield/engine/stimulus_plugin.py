"""Plugins of one stimulus and of the board that plays the drive; they store keys."""

from typing import TYPE_CHECKING, ClassVar

from palmfield.config import Config, DriverConfig, StimulusConfig
from palmfield.engine.host import Module

if TYPE_CHECKING:
    from palmfield.mujoco_host.drawing import Drawing

FOCI_GROUP = 1
"""Site group: if it is on, a viewer shows the foci."""
FOCUS_m, TRAIL_m = 2e-3, 8e-4
"""Radius of a focus, and radius of the balls at its next positions."""


class StimulusModule(Module):
    """Stores the keys of the stimulus."""

    name: ClassVar[str] = StimulusConfig.plugin
    config: ClassVar[type[Config]] = StimulusConfig

    def draw(self, drawing: "Drawing") -> None:
        """Draw a ball at each focus, and small balls at the next positions of the focus."""
        from palmfield.engine.scene_view import FOCUS, view_of

        view = view_of(self.world) if drawing.shows("site", FOCI_GROUP) else None
        if view is None:
            return
        same = [number for number, plugin, _ in self.world.model.instances() if plugin == self.name]
        foci = view.foci(same.index(self.instance))
        if len(foci):
            drawing.spheres(foci[0], FOCUS_m, FOCUS)
            moved = foci[1:][(foci[1:] != foci[0]).any(axis=(1, 2))].reshape(-1, 3)
            drawing.spheres(moved, TRAIL_m, FOCUS)


class DriverModule(Module):
    """Stores the keys of the board."""

    name: ClassVar[str] = DriverConfig.plugin
    config: ClassVar[type[Config]] = DriverConfig
