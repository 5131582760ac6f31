"""Plugin of one skin. Its state is the motion of the layer; the plugin of the first skin steps the whole scene."""

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from palmfield.config import Config, SkinConfig
from palmfield.engine.host import Module, World
from palmfield.mujoco_host.mujoco_view import ModelView
from palmfield.types import Float

if TYPE_CHECKING:
    from palmfield.mujoco_host.drawing import Drawing

ARP_GROUP = 2
"""Geom group: if it is on, a viewer shows the ARP on the skins."""
LIFT_m, LABEL_m = 6e-4, 0.02
"""Heights above the skin of the coloured triangles, which lie above a viewer's coarser mesh, and of the label."""


class SkinModule(Module):
    """Pushes the body with the resultant of the ARP, and stores the motion of the skin layer in the plugin state.

    The sensor is attached to a site of the body and reads `palmfield.simulation.sensors.CHANNELS`. These channels are
    the mean force over the present step, and three quantities at the skin point nearest to the site: the ARP, and the
    displacement and velocity along the outward normal. As for all MuJoCo sensors, the reading is that at the beginning
    of the step. After mj_step it is one time step older than data.time, until mj_forward is called.

    number: number of this skin in the scene; leads: whether this skin (the first) steps the scene
    scene: the `palmfield.engine.scene_runtime.SceneRuntime` that all skins share
    """

    name: ClassVar[str] = SkinConfig.plugin
    config: ClassVar[type[Config]] = SkinConfig
    sensor: ClassVar[bool] = True

    def __init__(self, settings: Any, world: World, instance: int):
        # Imported here: MuJoCo registers the plugins in every process, and Warp takes half a second to load.
        from palmfield.engine.scene_runtime import SceneRuntime

        super().__init__(settings, world, instance)
        if world.scene is None:
            world.scene = SceneRuntime(world)
        self.scene = world.scene
        self.number = [skin.instance for skin in self.scene.binding.skins].index(instance)
        self.leads = self.number == 0
        self.only_senses = not self.leads
        self._sensors: list[Any] | None = None
        self._began = False

    @classmethod
    def state_size(cls, settings: Any, model: ModelView) -> int:
        """Return the state size of the whole layer; a reduced model uses a part of it."""
        from palmfield.simulation.build import model_of
        from palmfield.simulation.scene_reader import read_scene, with_files_found
        from palmfield.simulation.state import skin_room

        spec, _ = read_scene(model)
        own = with_files_found(settings, f"plugin '{cls.name}'")
        number = next(i for i, skin in enumerate(spec.skins) if skin.config == own)
        return skin_room(model_of(spec), number)

    @classmethod
    def sensor_size(cls, settings: Any, model: ModelView, sensor: int) -> int:
        """Return the number of channels, see `palmfield.simulation.sensors.CHANNELS`."""
        from palmfield.simulation.sensors import CHANNELS

        return len(CHANNELS)

    @property
    def applied(self) -> Float:
        """Return the mean force of the sound on the body of this skin in the present step [N], world axes, (3,)."""
        force: Float = self.scene.applied[self.scene.model.skins[self.number].body]
        return force

    def forces(self) -> None:
        """Push all bodies of the scene."""
        self.scene.push()

    def sense(self) -> None:
        """Fill the sensors from the state at the present time."""
        if self._sensors is None:
            self._sensors = self.world.sensors(self.instance)
        if self._sensors:
            self.scene.sense(self.number, self._sensors)

    def advance(self) -> None:
        """Advance the scene by the last MuJoCo step. The first step shows the waiting time in a terminal."""
        if not (self._began or self.world.quiet):
            from palmfield.terminal import bars

            with bars() as bar:
                self.scene.prepare(bar)
        self._began = True
        self.scene.advance()

    def draw(self, drawing: "Drawing") -> None:
        """Draw the mean ARP on the skin by colour, and its maximum as a label."""
        from palmfield.engine.scene_view import FAINT, EXPOSURE_s, arp_colours, view_of

        view = view_of(self.world) if drawing.shows("geom", ARP_GROUP) else None
        skin = None if view is None else view.skin(self.number)
        if skin is None or skin.arp.max() <= 0.0:
            return
        loudest = int(np.argmax(skin.arp))
        over = f"mean over {1e3 * EXPOSURE_s:g} ms"
        drawing.label(
            skin.vertices[loudest] + LABEL_m * skin.normals[loudest],
            f"ARP {skin.arp[loudest]:.3g} Pa, {over}",
        )
        shares = skin.arp[skin.faces].mean(axis=1) / skin.top
        order = np.argsort(-shares)[: int(np.count_nonzero(shares > FAINT))]
        drawing.triangles(skin.vertices + LIFT_m * skin.normals, skin.faces[order], arp_colours(shares[order]))

    def hand_over(self) -> None:
        """Stop computing forces, sensors and state, because other code now steps several worlds together."""
        self.only_senses, self._sensors = True, []

    def copy_from(self, other: "SkinModule") -> None:
        """Take over the data of the same module in another mjData."""
        if self.leads:
            self.scene.adopt(other.scene)
