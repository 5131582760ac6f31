"""Motion of hands: keyframes, trajectories, recorded tracking, and transfer of tracked motion to another hand.

from palmfield.hand import articulate, load_preset
from palmfield.motion import read_stream
from palmfield.motion.retarget import retarget
motion = retarget(articulate(load_preset("open_men_p50")), read_stream("recorded.csv"))
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
