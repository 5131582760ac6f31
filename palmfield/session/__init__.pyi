from .loudest_moment import LoudestMoment as LoudestMoment
from .open_scene import compiled as compiled
from .preview import Preview as Preview
from .recorded_run import Result as Result
from .recorder import Recorder as Recorder
from .simulation import Simulation as Simulation
from .skin import Skin as Skin
from .worlds import WorldsSkin as WorldsSkin
