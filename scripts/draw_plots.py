#!/usr/bin/env python3
"""Every kind of picture of a run, small, with the page that shows them.

python scripts/draw_plots.py RUN [--page docs/plots.md] [--images docs/images/plots]

RUN is the folder of a run, for the committed page of `palmfield run mjcf/scenes/palm_circle.xml`.
"""

import argparse
from pathlib import Path

from palmfield.outputs.pictures.asked import Asked
from palmfield.outputs.pictures.kinds import KINDS
from palmfield.outputs.store import RESULT, open_result
from palmfield.outputs.style import save, style

ROOT = Path(__file__).resolve().parents[1]
DPI = 70
HEAD = """# Pictures of a run

`palmfield plot DIR` draws every kind that a run holds to DIR/plots, for a paper: PNG of 300 dpi, or SVG or PDF
(`--format`), with colours that are even to the eye and safe for the colour-blind, lines that differ in grey too, and
units on every axis. `palmfield plot DIR motion wavefronts` draws two kinds; `palmfield plot --list` says which there
are. Runs draw three pictures by themselves, or what is asked for: `palmfield run SCENE --plots motion,rms`, or
`--no-plots`.

```sh
palmfield plot out/palm                                    # all that the run holds
palmfield plot out/palm motion --time 12.5 --limits=-1,1   # a map at 12.5 ms, colours from -1 to 1 um
palmfield plot out/palm course spectrum --place 10,0,205 --place 0,0,205 --format svg
palmfield plot out/palm rms --quantity velocity
```

`--place` is a point of the world as the run begins, in mm; the nearest vertex of the skin is taken, and a place more
than 10 mm from the skin is refused with where its middle is. `--quantity velocity` shows the skin's velocity in place
of its displacement. What a run doesn't hold is left out and said; where it was named, it is an error.

`palmfield render out/palm --video palm.mp4 --from 20 --to 40` makes a film of the same run: the hand with the motion on
its skin, 200 times slower than it was and magnified so that the largest motion is seen as about 2 mm (`--slow`,
`--magnify`), with a scale bar, a colour bar and a clock. `--show velocity` or `arp` changes the colours. It takes about
a second a frame, needs no window, and the extra `video` (PyAV, whose wheels bundle FFmpeg with parts under the GPL).

The pictures below are of `mjcf/scenes/palm_circle.xml`, drawn small by `scripts/draw_plots.py`.
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "plots.md")
    parser.add_argument("--images", type=Path, default=ROOT / "docs" / "images" / "plots")
    given = parser.parse_args()
    given.images.mkdir(parents=True, exist_ok=True)
    parts = [HEAD]
    with open_result(given.run / RESULT) as result:
        for name, kind in KINDS.items():
            with style():
                figure = kind.draw(result, Asked())
                figure.set_dpi(DPI)
                save(figure, given.images / f"{name}.png", DPI)
            about = (kind.draw.__doc__ or kind.about).split("\n\n")[0].strip()
            parts.append(f"## {name}\n\n{' '.join(about.split())}\n\n![{kind.about}](images/plots/{name}.png)\n")
    given.page.write_text("\n".join(parts), encoding="utf-8")


if __name__ == "__main__":
    main()
