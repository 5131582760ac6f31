#!/usr/bin/env python3
"""Draw every kind of picture of a run at small size, and the page with all of them.

python scripts/draw_plots.py RUN [--page docs/plots.md] [--images docs/images/plots]

RUN is the folder of a run; the page in the repository is of `palmfield run mjcf/scenes/palm_circle.xml`.
"""

import argparse
from pathlib import Path

from palmfield.outputs.pictures.kinds import KINDS
from palmfield.outputs.pictures.options import Options
from palmfield.outputs.store import RESULT, open_result
from palmfield.outputs.style import save, style

ROOT = Path(__file__).resolve().parents[1]
DPI = 70


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "plots.md")
    parser.add_argument("--images", type=Path, default=ROOT / "docs" / "images" / "plots")
    args = parser.parse_args()
    args.images.mkdir(parents=True, exist_ok=True)
    # What stands above the pictures is kept
    parts = [args.page.read_text(encoding="utf-8").partition("\n## ")[0].rstrip("\n") + "\n"]
    with open_result(args.run / RESULT) as result:
        for name, kind in KINDS.items():
            with style():
                figure = kind.draw(result, Options())
                figure.set_dpi(DPI)
                save(figure, args.images / f"{name}.png", DPI)
            about = (kind.draw.__doc__ or kind.about).split("\n\n")[0].strip()
            parts.append(f"## {name}\n\n{' '.join(about.split())}\n\n![{kind.about}](images/plots/{name}.png)\n")
    args.page.write_text("\n".join(parts), encoding="utf-8")


if __name__ == "__main__":
    main()
