"""Plugin of a region of a skin whose rates of spikes sensors read; its state is that of the afferents in it."""

from typing import Any, ClassVar

from palmfield.config import AfferentsConfig, Config
from palmfield.engine.host import Module
from palmfield.mujoco_host.mujoco_view import ModelView


class AfferentsModule(Module):
    """Read the rates of spikes in a region, see `palmfield.simulation.rates`; the skins step its afferents.

    Like all sensors, one reads the beginning of the last step. It may be attached to any body or site.
    """

    name: ClassVar[str] = AfferentsConfig.plugin
    config: ClassVar[type[Config]] = AfferentsConfig
    sensor: ClassVar[bool] = True
    handed_over = False

    @classmethod
    def state_size(cls, settings: Any, model: ModelView) -> int:
        """Return the size of the state of the afferents of the region."""
        from palmfield.simulation.build import model_of
        from palmfield.simulation.scene_reader import read_scene

        spec, _ = read_scene(model)
        number = next(i for i, region in enumerate(spec.regions) if region.config == settings)
        return model_of(spec).rates[number].size

    @classmethod
    def sensor_size(cls, settings: Any, model: ModelView, sensor: int) -> int:
        """Return the number of channels."""
        from palmfield.simulation.rates import CHANNELS

        return len(CHANNELS)

    def sense(self) -> None:
        """Fill the sensors from the state at the present time."""
        for sensor in [] if self.handed_over else self.world.sensors(self.instance):
            sensor.data[:] = self.world.scene.rates(self.world.scene.binding.region_instances.index(self.instance))

    def hand_over(self) -> None:
        """Stop filling sensors: the code that steps several worlds together does it."""
        self.handed_over = True
