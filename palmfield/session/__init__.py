"""What a user does with a scene: load and step it, run it, plan it, play it on a board.

import palmfield
sim = palmfield.Simulation("mjcf/scenes/palm_am200.xml")
sim.run(0.01)
print(sim.skin().displacement, palmfield.plan(sim))

`palmfield.load`, `plan`, `run` and `recover` are public there; here are the objects that they give and take.
"""

from typing import TYPE_CHECKING

from palmfield.lazy_names import lazy_names

if TYPE_CHECKING:
    from palmfield.session.array_inputs import p0_band, p0_band_at
    from palmfield.session.load import compiled
    from palmfield.session.loudest_moment import LoudestMoment
    from palmfield.session.numerical_error import error_estimate
    from palmfield.session.plan import Plan, warnings
    from palmfield.session.planning.rows import Row
    from palmfield.session.play import play_focus, play_scene, scene_frames
    from palmfield.session.preview import Preview
    from palmfield.session.recorder import Recorder
    from palmfield.session.run import Result
    from palmfield.session.sensation_levels import felt_levels
    from palmfield.session.simulation import Simulation
    from palmfield.session.skin import Skin
    from palmfield.session.summary import array_numbers, scene_numbers, skin_numbers, stimulus_numbers
    from palmfield.session.worlds import Worlds, WorldsSkin

_WHERE = {
    "p0_band": "array_inputs",
    "p0_band_at": "array_inputs",
    "LoudestMoment": "loudest_moment",
    "error_estimate": "numerical_error",
    "compiled": "load",
    **dict.fromkeys(("Plan", "warnings"), "plan"),
    "Row": "planning.rows",
    **dict.fromkeys(("play_focus", "play_scene", "scene_frames"), "play"),
    "Preview": "preview",
    "Recorder": "recorder",
    "Result": "run",
    "felt_levels": "sensation_levels",
    "Simulation": "simulation",
    "Skin": "skin",
    **dict.fromkeys(("array_numbers", "scene_numbers", "skin_numbers", "stimulus_numbers"), "summary"),
    **dict.fromkeys(("Worlds", "WorldsSkin"), "worlds"),
}
__all__ = [
    "LoudestMoment",
    "Plan",
    "Preview",
    "Recorder",
    "Result",
    "Row",
    "Simulation",
    "Skin",
    "Worlds",
    "WorldsSkin",
    "array_numbers",
    "compiled",
    "error_estimate",
    "felt_levels",
    "p0_band",
    "p0_band_at",
    "play_focus",
    "play_scene",
    "scene_frames",
    "scene_numbers",
    "skin_numbers",
    "stimulus_numbers",
    "warnings",
]
__getattr__, __dir__ = lazy_names(__name__, _WHERE)
