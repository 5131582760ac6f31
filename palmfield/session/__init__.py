"""A scene as a user has it: opened, stepped, looked at, recorded.

import palmfield
sim = palmfield.Simulation("mjcf/scenes/palm_am200.xml")
sim.run(0.01)
print(sim.skin().displacement)

`palmfield.load` and `palmfield.recover` are public there; here are the objects that they give and take.
"""

from typing import TYPE_CHECKING

from palmfield.lazy_names import lazy_names

if TYPE_CHECKING:
    from palmfield.session.loudest_moment import LoudestMoment
    from palmfield.session.open_scene import compiled
    from palmfield.session.preview import Preview
    from palmfield.session.recorded_run import Result
    from palmfield.session.recorder import Recorder
    from palmfield.session.simulation import Simulation
    from palmfield.session.skin import Skin
    from palmfield.session.worlds import WorldsSkin

_WHERE = {
    "LoudestMoment": "loudest_moment",
    "compiled": "open_scene",
    "Preview": "preview",
    "Result": "recorded_run",
    "Recorder": "recorder",
    "Simulation": "simulation",
    "Skin": "skin",
    "WorldsSkin": "worlds",
}
__all__ = ["LoudestMoment", "Preview", "Recorder", "Result", "Simulation", "Skin", "WorldsSkin", "compiled"]
__getattr__, __dir__ = lazy_names(__name__, _WHERE)
