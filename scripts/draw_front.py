#!/usr/bin/env python3
"""Draw the first picture of the README: sound on a hand and motion of its skin, of one run.

python scripts/draw_front.py [DIR]

DIR: folder of a run of mjcf/scenes/palm_circle.xml. If it is missing, the run is made (a minute on two cores).
"""

import argparse
import tempfile
from pathlib import Path

import matplotlib.image
import numpy as np

import palmfield
from palmfield.outputs import open_result
from palmfield.outputs.pictures.kinds.maps import motion_map
from palmfield.outputs.pictures.options import Options
from palmfield.outputs.render import render_scene
from palmfield.outputs.style import save, style

ROOT = Path(__file__).resolve().parents[1]
PICTURE = ROOT / "docs" / "images" / "front.png"
MOMENT_S = 0.0265
"""Time of the picture: the focus, and its wake, have moved around the circle nearly twice."""
MARGIN = 20


def on_white(picture: np.ndarray, height: int) -> np.ndarray:
    """Return a picture, RGB in 0..1, in the middle of a white strip with this height."""
    picture = picture[:height, :, :3]
    above = (height - len(picture)) // 2
    result = np.ones((height, picture.shape[1] + MARGIN, 3), picture.dtype)
    result[above : above + len(picture), : picture.shape[1]] = picture
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", nargs="?", type=Path, default=Path("out/front"))
    run = parser.parse_args().run
    if not (run / "result.nc").exists():
        scene = palmfield.load(ROOT / "mjcf" / "scenes" / "palm_circle.xml", accuracy=0.1)
        palmfield.run(scene, run, duration_s=0.06, plots=[])
    with tempfile.TemporaryDirectory() as folder, open_result(run) as result:
        parts = [Path(folder) / "scene.png", Path(folder) / "motion.png"]
        render_scene(result, parts[0])
        with style():
            figure = motion_map(result, Options(time_s=MOMENT_S, limits=(-0.6, 0.6)))
            figure.set_size_inches(7.2, 6.9)
            figure.set_dpi(100)
            save(figure, parts[1], 100)
        pictures = [matplotlib.image.imread(part) for part in parts]
    height = max(len(picture) for picture in pictures)
    matplotlib.image.imsave(PICTURE, np.clip(np.hstack([on_white(picture, height) for picture in pictures]), 0.0, 1.0))
    print(PICTURE)


if __name__ == "__main__":
    main()
