"""Hands and other bodies: presets and meshes, checked and mended; skin layers cut out of them; bones that move them.

from palmfield.hand import hand_surface, load_preset
hand = hand_surface(load_preset("open_men_p50"))
print(hand.surface.vertices.shape, hand.landmarks["palm_centre"])
"""

from typing import TYPE_CHECKING

from palmfield.lazy_names import lazy_names

if TYPE_CHECKING:
    from palmfield.hand.articulated import ArticulatedHand, articulate
    from palmfield.hand.meshfile import load_mesh, load_rigged
    from palmfield.hand.patch import surface_patch
    from palmfield.hand.posed_surface import SkinBinding, face_samples
    from palmfield.hand.poses import POSE_NAMES, named_pose
    from palmfield.hand.preset import HandPreset, load_preset, preset_names
    from palmfield.hand.reportcard import ReportCard, report_card
    from palmfield.hand.skinning import SkinnedHand, SkinnedSurface
    from palmfield.hand.surface import HandSurface, hand_surface
    from palmfield.hand.wholelayer import hand_layer

_WHERE = {
    **dict.fromkeys(("ArticulatedHand", "articulate"), "articulated"),
    **dict.fromkeys(("load_mesh", "load_rigged"), "meshfile"),
    "surface_patch": "patch",
    **dict.fromkeys(("SkinBinding", "face_samples"), "posed_surface"),
    **dict.fromkeys(("POSE_NAMES", "named_pose"), "poses"),
    **dict.fromkeys(("HandPreset", "load_preset", "preset_names"), "preset"),
    **dict.fromkeys(("ReportCard", "report_card"), "reportcard"),
    **dict.fromkeys(("SkinnedHand", "SkinnedSurface"), "skinning"),
    **dict.fromkeys(("HandSurface", "hand_surface"), "surface"),
    "hand_layer": "wholelayer",
}
__all__ = [
    "POSE_NAMES",
    "ArticulatedHand",
    "HandPreset",
    "HandSurface",
    "ReportCard",
    "SkinBinding",
    "SkinnedHand",
    "SkinnedSurface",
    "articulate",
    "face_samples",
    "hand_layer",
    "hand_surface",
    "load_mesh",
    "load_preset",
    "load_rigged",
    "named_pose",
    "preset_names",
    "report_card",
    "surface_patch",
]
__getattr__, __dir__ = lazy_names(__name__, _WHERE)
