"""Sound of an array in air: its pressure, and the acoustic radiation pressure (ARP) that it makes on skin.

from palmfield.acoustics import FieldEvaluator, layout
from palmfield.acoustics.arp import arp
from palmfield.acoustics.focus import focus
array, air = layout("uhev1"), Air()
field = FieldEvaluator(array, air).pressure(points, focus(array, air, [0.0, 0.0, 0.2]), gradient=True)
load_Pa = arp(field, normals, air, array.frequency_Hz)
"""

from typing import TYPE_CHECKING

from palmfield.lazy_names import lazy_names

if TYPE_CHECKING:
    from palmfield.acoustics.air import density, sound_speed
    from palmfield.acoustics.arp import SurfaceSound
    from palmfield.acoustics.arrays import layout
    from palmfield.acoustics.body_scattering import Occlusion, RigidScatteredField, boundary_mesh
    from palmfield.acoustics.field import FieldEvaluator, pressure
    from palmfield.acoustics.phased_array import ArrayInstance, MultiArrayField, PhasedArray
    from palmfield.acoustics.reference import pressure64
    from palmfield.acoustics.surface_arp import SurfaceArp
    from palmfield.acoustics.surface_load import distance_to_arrays, pushes, resultants
    from palmfield.acoustics.transfer import Transfer, arp_frames

_WHERE = {
    **dict.fromkeys(("density", "sound_speed"), "air"),
    "SurfaceSound": "arp",
    "layout": "arrays",
    **dict.fromkeys(("Occlusion", "RigidScatteredField", "boundary_mesh"), "body_scattering"),
    **dict.fromkeys(("FieldEvaluator", "pressure"), "field"),
    **dict.fromkeys(("ArrayInstance", "MultiArrayField", "PhasedArray"), "phased_array"),
    "pressure64": "reference",
    "SurfaceArp": "surface_arp",
    **dict.fromkeys(("distance_to_arrays", "pushes", "resultants"), "surface_load"),
    **dict.fromkeys(("Transfer", "arp_frames"), "transfer"),
}
__all__ = [
    "ArrayInstance",
    "FieldEvaluator",
    "MultiArrayField",
    "Occlusion",
    "PhasedArray",
    "RigidScatteredField",
    "SurfaceArp",
    "SurfaceSound",
    "Transfer",
    "arp_frames",
    "boundary_mesh",
    "density",
    "distance_to_arrays",
    "layout",
    "pressure",
    "pressure64",
    "pushes",
    "resultants",
    "sound_speed",
]
__getattr__, __dir__ = lazy_names(__name__, _WHERE)
