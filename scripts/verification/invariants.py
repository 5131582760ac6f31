"""Do the shipped scenes show the same when they are written in another way? docs/bench/invariants.md is its output.

    python scripts/verification/invariants.py [--scenes NAME ...] [--steps 8] [--out docs/bench/invariants.md]
        [--kept FOLDER]

Each scene is stepped at its shipped accuracy, as it is and in each way of `scene_variants.VARIANTS`. Of what is kept in
a folder, scene by scene, a later run makes the page: scenes can be run at a time, or by several processes.
"""

import argparse
import json
import subprocess
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path

from scene_variants import LIMITS, PUSHED, SCENES, VARIANTS, changes, exceeded, plain, seen, variants

MORE: dict[str, tuple[str, dict[str, object]]] = {
    f"follow_fingertip, accuracy {accuracy:g}": ("follow_fingertip", {"skin.accuracy": accuracy})
    for accuracy in (0.4, 0.1)
}
HEAD = """# Invariants

Made by `python scripts/verification/invariants.py`, commit {commit}; do not edit. {scenes} scenes, {steps} steps each
(moving scenes from a quarter of their time on, or from when something is felt), CPU. Each scene is written in
another form and must give the same results:

- shifted: by (0.31, -0.17, 0.23) m; turned: everything in the world, gravity and scripted motions, by 90 degrees
  about z, with exchanged axes (x to y, y to z, z to x), and by 78 degrees about a skew axis with that shift;
- mirrored: the other hands, paths and motions; scenes without a hand with y reversed;
- other order: plugins, instances and sensors in reverse order; from a file: the transducers of the layout as a CSV
  file, in their order and in reverse;
- p0 x 2: ARP, force and motion four times as large (unchanged if the stimulus sets the level);
- step / 2: half the MuJoCo step;
- two worlds: the stimulus of the scene and one displaced by 2 mm (by sites: with 0.75 of the speed), each compared
  with a single run.

Changes are over all nodes and steps, ||changed - own|| / ||own||, the largest of the skins of a scene.
"""
LAST = """## Limits

ARP and force: single precision ({rounding:g}; p0 x 2: {p0:g}, as the sound moves what feels it). Displacement:
a tenth of the error that modes or the small model state; without these of the scene's key `accuracy`. {over}
`tests/test_invariants.py` holds smaller scenes to the same limits. Where more is allowed:

- step / 2 (up to the `accuracy`): what leads a hand moves once in a step of MuJoCo's, and its integrator is of first
  order in the step.
- follow_fingertip, turned and shifted: a scripted motion is a monotone cubic in each of the file's axes, so that it
  stays between two keys in each of them ([motion](../motion.md)). Between keys it depends on these axes: this hand is
  {apart_mm:.2f} mm elsewhere. Exchanging the axes changes nothing.
- mirrored discs: on the rings of a disc's mesh four neighbours can lie on one circle, which leaves the diagonal between
  them to rounding. Up to {elsewhere:.2g} % of the nodes, all in the middle of edges, lie elsewhere; the others are
  compared, to a tenth of the `accuracy`. A left hand has the mirror image of the right one's mesh.
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", nargs="+", default=[*SCENES, *MORE])
    parser.add_argument("--steps", type=int, default=8)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--kept", type=Path)
    settings = parser.parse_args()
    found: dict[str, dict[str, dict[str, float]]] = {}
    stated: dict[str, float] = {}
    over: list[str] = []
    for label in settings.scenes:
        name, keys = MORE.get(label, (label, {}))
        file = settings.kept and settings.kept / f"{label}.json"
        if file and file.exists():
            found[label], stated[label], new = json.loads(file.read_text())
        else:
            found[label], stated[label], new = scene_changes(label, name, settings.steps, keys)
            if file:
                file.write_text(json.dumps([found[label], stated[label], new]))
        over += new
    text = page(found, stated, settings.steps, over)
    print(text)
    if settings.out:
        settings.out.write_text(text)


def scene_changes(
    label: str, name: str, steps: int, keys: Mapping[str, object]
) -> tuple[dict[str, dict[str, float]], float, list[str]]:
    rows, all_over = {}, []
    with tempfile.TemporaryDirectory() as folder:
        own = {(): seen(plain(name, Path(folder) / "own"), name, steps, keys)}
        for number, words in enumerate(variants(name)):
            begun = time.perf_counter()
            variant = VARIANTS[words](name, Path(folder) / str(number))
            known = tuple(map(str, variant.truth.items()))
            if known not in own:
                own[known] = seen(plain(name, Path(folder) / "own"), name, steps, {**keys, **variant.truth})
            rows[words] = changes(seen(variant, name, steps, keys), own[known])
            over = exceeded(name, words, rows[words], own[known])
            all_over += [f"{label}, {words}: {over}"] if over else []
            took = time.perf_counter() - begun
            print(f"{label}: {words}: {told(rows[words])} {'OVER ' + over if over else ''} ({took:.1f} s)", flush=True)
        return rows, float(own[()].stated), all_over


def told(row: Mapping[str, float]) -> str:
    return ", ".join(f"{what} {value:.2g}" for what, value in row.items())


def page(
    found: Mapping[str, Mapping[str, Mapping[str, float]]], stated: Mapping[str, float], steps: int, over: list[str]
) -> str:
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=True).stdout
    lines = [
        HEAD.format(commit=commit.strip(), scenes=len({MORE.get(label, (label,))[0] for label in found}), steps=steps)
    ]
    for what, words in (
        ("displacement", "Displacement, in percent of the error stated by modes or small model (`stated`, in percent)"),
        ("ARP", "ARP at the skin's nodes"),
        ("force", "Mean forces, relative to the largest of a body"),
    ):
        lines += [f"## {words}", ""]
        own = ["stated"] if what == "displacement" else []
        lines.append(" | ".join(["| scene", *own, *VARIANTS]) + " |")
        lines.append("|---" * (1 + len(own) + len(VARIANTS)) + "|")
        for label, rows in found.items():
            cells = [f"{100 * stated[label]:.2g}"] if own else []
            for variant in VARIANTS:
                if variant not in rows:
                    cells.append("-")
                    continue
                value = rows[variant][what] / (0.01 * stated[label] if own else 1.0)
                cells.append(f"{value:.2g}" if value else "0")
            lines.append(" | ".join([f"| {label}", *cells]) + " |")
        lines.append("")
    missing = [f"`{name}`" for name in SCENES if name not in found]
    if missing:
        lines += [f"Not run at their own accuracy: {', '.join(missing)}.", ""]
    apart = max((rows["turned and shifted"]["position"] for rows in found.values()), default=0.0)
    elsewhere = max((rows["mirrored"]["mesh"] for rows in found.values()), default=0.0)
    figures = {"apart_mm": 1e3 * apart, "elsewhere": 100.0 * elsewhere}
    told_over = f"Exceeded: {'; '.join(over)}." if over else "None is exceeded."
    lines.append(LAST.format(rounding=LIMITS["ARP"], p0=PUSHED["ARP"], over=told_over, **figures).strip())
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
