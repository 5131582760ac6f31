#!/usr/bin/env python3
"""Render a run's USD scene with Blender's path tracer Cycles, as in a user's Blender.

In an environment of Python 3.13 with `pip install bpy numpy` (Blender as a module, 430 MB; palmfield is not needed):

    python scripts/verification/render_usd.py out/demo/scene.usdc out/scene_cycles.png --frame 40

It prints the frame rate in Blender, and the mean and the darkest and lightest tenths of the pixels: the mean of a scene
with the light of a viewport is between 0.2 and 0.8.
"""

import argparse
from pathlib import Path

import bpy
import numpy as np


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path, help="a scene that `palmfield run` or `palmfield usd` wrote")
    parser.add_argument("picture", type=Path, help="PNG file to write")
    parser.add_argument("--frame", type=float, help="time code; the middle of the run by default")
    parser.add_argument("--samples", type=int, default=24, help="rays a pixel, 24 by default")
    arguments = parser.parse_args()
    bpy.ops.wm.read_factory_settings()
    for one in list(bpy.data.objects):  # what a new Blender file starts with
        bpy.data.objects.remove(one)
    bpy.ops.wm.usd_import(filepath=str(arguments.scene.resolve()))
    scene = bpy.context.scene
    scene.camera = next(one for one in scene.objects if one.type == "CAMERA")
    scene.render.engine, scene.cycles.device, scene.cycles.samples = "CYCLES", "CPU", arguments.samples
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 960, 720, 100
    scene.view_settings.view_transform = "Standard"
    first, last = scene.frame_start, scene.frame_end
    at = (first + last) / 2 if arguments.frame is None else arguments.frame
    scene.frame_set(int(at), subframe=at - int(at))
    scene.render.filepath = str(arguments.picture.resolve())
    bpy.ops.render.render(write_still=True)
    picture = bpy.data.images.load(scene.render.filepath)
    pixels = np.array(picture.pixels[:]).reshape(-1, 4)[:, :3].mean(axis=1)
    low, high = np.quantile(pixels, [0.1, 0.9])
    print(f"time codes {first} to {last} at {scene.render.fps / scene.render.fps_base:g} a second, drawn at {at:g}")
    print(f"mean {pixels.mean():.3f}, a tenth darker than {low:.3f}, a tenth lighter than {high:.3f}")


if __name__ == "__main__":
    main()
