"""The plugin of one phased array: its keys, and in its state what its transducers emit."""

from typing import Any, ClassVar

from palmfield.config import ArrayConfig, Config
from palmfield.engine.host import Module
from palmfield.mujoco_host.mujoco_view import ModelView


class ArrayModule(Module):
    """Holds the keys of one array and the room for what its transducers emit; the scene steps all arrays together."""

    name: ClassVar[str] = ArrayConfig.plugin
    config: ClassVar[type[Config]] = ArrayConfig

    @classmethod
    def state_size(cls, settings: Any, model: ModelView) -> int:
        """Header and one complex number a transducer."""
        # Imported here: MuJoCo registers the plugins in every process, and Warp takes half a second to load.
        from palmfield.simulation.build import model_of
        from palmfield.simulation.scene_reader import read_scene
        from palmfield.simulation.state import array_room

        spec, _ = read_scene(model)
        number = next(i for i, array in enumerate(spec.arrays) if array.config == settings)
        return array_room(len(model_of(spec).arrays.parts[number]))
