"""A run as a USD scene: hands, skins, arrays, foci and field over time, for usdview, Blender, Omniverse and the like.

from palmfield.outputs import open_result
from palmfield.outputs.usd import Shown, write_usd
with open_result("out/palm") as result:
    write_usd(result, "palm.usdz", Shown(colour="arp"))
"""

from typing import TYPE_CHECKING

from palmfield.lazy_names import lazy_names

if TYPE_CHECKING:
    from palmfield.outputs.usd.shown import Shown
    from palmfield.outputs.usd.validation import validate_usd
    from palmfield.outputs.usd.write import write_usd

_WHERE = {"Shown": "shown", "validate_usd": "validation", "write_usd": "write"}
__all__ = ["Shown", "validate_usd", "write_usd"]
__getattr__, __dir__ = lazy_names(__name__, _WHERE)
