"""palmfield: from an ultrasonic array's drive to radiation pressure on a hand, skin waves and what is felt.

import palmfield
scene = palmfield.load("mjcf/scenes/palm_am200.xml")
print(palmfield.plan(scene))
result = palmfield.run(scene, "out/palm")
"""

from importlib import import_module
from typing import Any

from palmfield.errors import DeviceError, OutputError, PalmfieldError, SceneError

_WHERE = {
    "load": "palmfield.scene",
    "Scene": "palmfield.scene",
    "plan": "palmfield.planning",
    "run": "palmfield.runner",
}
__all__ = ["DeviceError", "OutputError", "PalmfieldError", "SceneError", *_WHERE]


def __getattr__(name: str) -> Any:
    # Loaded when asked for: MuJoCo imports this package in every process, and Warp takes half a second.
    if name in _WHERE:
        value = getattr(import_module(_WHERE[name]), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module 'palmfield' has no attribute '{name}'")
