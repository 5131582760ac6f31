"""The coupled scene: what it says, the model made of it, its state, and one step of the pipeline.

SceneSpec -> build -> HapticModel -> step(model, state, posed, t0, t1) -> what observers see.

`palmfield.simulation.build.build` and `palmfield.simulation.step.step` are the two verbs; here are their nouns.
"""

from typing import TYPE_CHECKING

from palmfield.lazy_names import lazy_names

if TYPE_CHECKING:
    from palmfield.simulation.build import model_of
    from palmfield.simulation.model import BodyModel, HapticModel, SkinModel, StepperChoice, StimulusModel
    from palmfield.simulation.posed_scene import PosedScene, reference_scene
    from palmfield.simulation.radiation import Radiation
    from palmfield.simulation.scene_reader import read_scene
    from palmfield.simulation.sensors import CHANNELS, SkinReading
    from palmfield.simulation.spec import ArraySpec, ObstacleSpec, SceneSpec, SkinSpec, StimulusSpec
    from palmfield.simulation.state import HapticState, new_state
    from palmfield.simulation.step import StepTrace
    from palmfield.simulation.workspace import Workspace

_WHERE = {
    "model_of": "build",
    **dict.fromkeys(("BodyModel", "HapticModel", "SkinModel", "StepperChoice", "StimulusModel"), "model"),
    **dict.fromkeys(("PosedScene", "reference_scene"), "posed_scene"),
    "Radiation": "radiation",
    "read_scene": "scene_reader",
    **dict.fromkeys(("CHANNELS", "SkinReading"), "sensors"),
    **dict.fromkeys(("ArraySpec", "ObstacleSpec", "SceneSpec", "SkinSpec", "StimulusSpec"), "spec"),
    **dict.fromkeys(("HapticState", "new_state"), "state"),
    "StepTrace": "step",
    "Workspace": "workspace",
}
__all__ = [
    "CHANNELS",
    "ArraySpec",
    "BodyModel",
    "HapticModel",
    "HapticState",
    "ObstacleSpec",
    "PosedScene",
    "Radiation",
    "SceneSpec",
    "SkinModel",
    "SkinReading",
    "SkinSpec",
    "StepTrace",
    "StepperChoice",
    "StimulusModel",
    "StimulusSpec",
    "Workspace",
    "model_of",
    "new_state",
    "read_scene",
    "reference_scene",
]
__getattr__, __dir__ = lazy_names(__name__, _WHERE)
