"""Sound of an array in air: its pressure, and the acoustic radiation pressure (ARP) that it makes on skin.

from palmfield.acoustics import FieldEvaluator, layout
from palmfield.acoustics.arp import arp
from palmfield.acoustics.focus import focus
array, air = layout("uhev1"), Air()
field = FieldEvaluator(array, air).pressure(points, focus(array, air, [0.0, 0.0, 0.2]), gradient=True)
load_Pa = arp(field, normals, air, array.frequency_Hz)
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from palmfield.acoustics.arrays import layout
    from palmfield.acoustics.derived import intensity, particle_velocity
    from palmfield.acoustics.field import FieldEvaluator, pressure
    from palmfield.acoustics.transfer import Transfer, arp_frames

_WHERE = {
    "FieldEvaluator": "field",
    "Transfer": "transfer",
    "arp_frames": "transfer",
    "intensity": "derived",
    "layout": "arrays",
    "particle_velocity": "derived",
    "pressure": "field",
}
__all__ = ["FieldEvaluator", "Transfer", "arp_frames", "intensity", "layout", "particle_velocity", "pressure"]


def __getattr__(name: str) -> Any:
    # Loaded when asked for: Warp takes half a second, and air and types need neither it nor SciPy
    if name not in _WHERE:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    return getattr(import_module(f"{__name__}.{_WHERE[name]}"), name)
