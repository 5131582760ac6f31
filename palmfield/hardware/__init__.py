"""A scene or a focus on a real board: what is sent, whether that is safe, and what bytes make a board do."""

from typing import TYPE_CHECKING

from palmfield.lazy_names import lazy_names

if TYPE_CHECKING:
    from palmfield.hardware.play import play_focus, play_scene, scene_frames

_WHERE = dict.fromkeys(("play_focus", "play_scene", "scene_frames"), "play")
__all__ = ["play_focus", "play_scene", "scene_frames"]
__getattr__, __dir__ = lazy_names(__name__, _WHERE)
