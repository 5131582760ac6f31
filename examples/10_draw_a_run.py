"""Pictures of a run for a paper, as `palmfield plot` draws them."""

import sys
from pathlib import Path

import palmfield
from palmfield.outputs.pictures.draw import draw_pictures
from palmfield.outputs.pictures.options import Options

out = Path(sys.argv[1] if len(sys.argv) > 1 else "out/example")
scene = palmfield.load("mjcf/scenes/phantom_am200.xml", accuracy=0.3)
result = palmfield.run(scene, out, duration_s=0.02, overwrite=True, plots=[])
files, missing = draw_pictures(result.dataset, out / "plots", options=Options(quantity="velocity"), suffix="svg")
print(f"{len(files)} drawn:", ", ".join(files))
for kind, reason in missing.items():
    print(f"no {kind}: {reason}")
