"""palmfield: from the drive of an ultrasonic array to radiation pressure on a hand, skin waves and sensation.

import palmfield
print(palmfield.plan("mjcf/scenes/palm_am200.xml"))
sim = palmfield.Simulation("mjcf/scenes/palm_am200.xml", keys={"stimulus.focus_m": (0, 0, 0.19)})
sim.run(0.02)
print(sim.skin().normal_displacement)
result = palmfield.run("mjcf/scenes/palm_am200.xml", "out/palm")
print(result.summary)

`dir(palmfield)` lists the public names. `dir` also lists those of subpackages such as `palmfield.skin`.
"""

import logging
from importlib import import_module
from typing import TYPE_CHECKING, Any

from palmfield.errors import DeviceError, OutputError, PalmfieldError, SceneError

logging.getLogger("palmfield").addHandler(logging.NullHandler())

if TYPE_CHECKING:
    from palmfield.engine.host import raise_errors
    from palmfield.estimate.estimated_run import run
    from palmfield.planning.scene_plan import Plan, plan
    from palmfield.session.recorded_run import Result, recover
    from palmfield.session.simulation import Simulation, load
    from palmfield.studies.sweeps.whole_sweep import sweep

    __version__: str

_WHERE = {
    "Plan": "planning.scene_plan",
    "Result": "session.recorded_run",
    "Simulation": "session.simulation",
    "load": "session.simulation",
    "plan": "planning.scene_plan",
    "raise_errors": "engine.host",
    "recover": "session.recorded_run",
    "run": "estimate.estimated_run",
    "sweep": "studies.sweeps.whole_sweep",
}
__all__ = [
    "DeviceError",
    "OutputError",
    "PalmfieldError",
    "Plan",
    "Result",
    "SceneError",
    "Simulation",
    "__version__",
    "load",
    "plan",
    "raise_errors",
    "recover",
    "run",
    "sweep",
]


def __getattr__(name: str) -> Any:
    # Loaded at first use, because MuJoCo imports this package in every process, and Warp takes half a second
    if name == "__version__":
        from importlib.metadata import version

        value: Any = version("palmfield")
    elif name in _WHERE:
        value = getattr(import_module(f"{__name__}.{_WHERE[name]}"), name)
    else:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
