"""Plugin of one phased array: its keys; its state is the emission of its transducers."""

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from palmfield.config import ArrayConfig, Config
from palmfield.engine.host import Module
from palmfield.mujoco_host.mujoco_view import ModelView

if TYPE_CHECKING:
    from palmfield.mujoco_host.drawing import Drawing

PHASES_GROUP = 1
"""Geom group: if it is on, a viewer shows the phases of the transducers."""
LEAST_RADIUS, DISC_m, ABOVE_m = 0.25, 2e-4, 2e-4


class ArrayModule(Module):
    """Stores the keys of one array and the emission of its transducers. The first skin steps all arrays."""

    name: ClassVar[str] = ArrayConfig.plugin
    config: ClassVar[type[Config]] = ArrayConfig

    @classmethod
    def state_size(cls, settings: Any, model: ModelView) -> int:
        """Return the size of the header and one complex number per transducer."""
        # Imported here: MuJoCo registers the plugins in every process, and Warp takes half a second to load.
        from palmfield.simulation.build import model_of
        from palmfield.simulation.scene_reader import read_scene
        from palmfield.simulation.state import array_room

        spec, _ = read_scene(model)
        number = next(i for i, array in enumerate(spec.arrays) if array.config == settings)
        return array_room(len(model_of(spec).arrays.parts[number]))

    def draw(self, drawing: "Drawing") -> None:
        """Draw a disc on each transducer. The colour (cyclic scale) shows the phase, the size the amplitude."""
        from palmfield.engine.scene_view import phase_colours, view_of

        view = view_of(self.world) if drawing.shows("geom", PHASES_GROUP) else None
        if view is None:
            return
        drawn = view.transducers(view.runtime.binding.array_instances.index(self.instance))
        shown = drawn.levels > 0.0
        radius = drawn.radius_m * (LEAST_RADIUS + (1.0 - LEAST_RADIUS) * np.minimum(drawn.levels[shown], 1.0))
        places, colours = drawn.places[shown] + ABOVE_m * drawn.axes[shown], phase_colours(drawn.phases[shown])
        drawing.discs(places, drawn.axes[shown], radius, DISC_m, colours)
