"""Write a run as a USD scene: hands, skins, arrays, foci and field over time, for usdview, Blender, Omniverse etc.

from palmfield.outputs import open_result
from palmfield.outputs.usd import Shown, write_usd
with open_result("out/palm") as result:
    write_usd(result, "palm.usdz", Shown(colour="arp"))
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
