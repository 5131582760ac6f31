from .play import play_focus as play_focus
from .play import play_scene as play_scene
from .play import scene_frames as scene_frames
