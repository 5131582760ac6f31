"""Test that the shipped scenes have the same results in equivalent forms; writes docs/bench/invariants.md.

    python scripts/verification/invariants.py [--scenes NAME ...] [--steps 8] [--out docs/bench/invariants.md]
        [--kept FOLDER]

Each scene is stepped at its shipped accuracy, unchanged and in each form of `scene_variants.VARIANTS`. Results are
stored in a folder by scene, and a later run makes the page from them. So scenes can be run one at a time, or by several
processes.
"""

import argparse
import json
import subprocess
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path

from scene_variants import LIMITS, PUSHED, SCENES, VARIANTS, changes, exceeded, plain, seen, variants

from palmfield.studies.bench.table import keep_rows

MORE: dict[str, tuple[str, dict[str, object]]] = {
    f"follow_fingertip, accuracy {accuracy:g}": ("follow_fingertip", {"skin.accuracy": accuracy})
    for accuracy in (0.4, 0.1)
}
HEAD = """# Invariants

For developers. Made by `python scripts/verification/invariants.py`, commit {commit}; do not edit. {scenes} scenes were
stepped {steps} times each on a CPU. Scenes that move begin at a quarter of their time, or at their first force. Each
scene must give the same results in other forms:

- shifted by (0.31, -0.17, 0.23) m.
- turned, with gravity and motions: by 90 degrees about z, with exchanged axes, or by 78 degrees about a skew axis
  with that shift.
- mirrored: with the other hand, or without a hand with y reversed.
- other order: the order of plugins, instances and sensors is changed.
- from a file: the transducers are read from a CSV file, in their order or in reverse order.
- p0 x 2: all results become four times as large, or stay the same if the stimulus sets the level.
- step / 2: half of the MuJoCo step.
- two worlds, the second with a displaced stimulus; each is compared with a single run.

A change is ||changed - original|| / ||original|| over all nodes and steps.
"""
LAST = """## Limits

The limit for ARP and force is single precision ({rounding:g}, and {p0:g} for p0 x 2). The limit for displacement is a
tenth of the stated error of the modes or of the reduced model. For skins without modes and without a reduced model, it
is a tenth of key `accuracy`. {over} `tests/test_invariants.py` applies the same limits to smaller scenes. Larger limits
apply to

- step / 2 (up to the `accuracy`), because MuJoCo's integrator is of first order in the step;
- follow_fingertip, turned and shifted. Each coordinate of a scripted motion is interpolated separately
  ([motion](../motion.md)), so the position of this hand depends on the axes: it differs by {apart_mm:.2f} mm;
- mirrored discs, because rounding decides the diagonals between four nodes on one circle. Up to {elsewhere:.2g} % of
  the nodes then have other positions; the others are compared, to a tenth of the `accuracy`.
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
    if settings.out:
        settings.out.write_text(page(found, stated, settings.steps, over, settings.out))


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
            print(
                f"{label}: {words}: {row_text(rows[words])} {'OVER ' + over if over else ''} ({took:.1f} s)", flush=True
            )
        return rows, float(own[()].stated), all_over


def row_text(row: Mapping[str, float]) -> str:
    return ", ".join(f"{what} {value:.2g}" for what, value in row.items())


def page(
    found: Mapping[str, Mapping[str, Mapping[str, float]]],
    stated: Mapping[str, float],
    steps: int,
    over: list[str],
    out: Path,
) -> str:
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=True).stdout
    lines = [
        HEAD.format(commit=commit.strip(), scenes=len({MORE.get(label, (label,))[0] for label in found}), steps=steps)
    ]
    links, largest = [], {variant: [f"| {variant}"] for variant in VARIANTS}
    for what in ("displacement", "ARP", "force"):
        own = ["stated [%]"] if what == "displacement" else []
        table = [" | ".join(["| scene", *own, *VARIANTS]) + " |", ""]
        most: dict[str, tuple[float, str]] = {}
        for label, rows in found.items():
            own_cells = [f"{100 * stated[label]:.2g}"] if own else []
            for variant in VARIANTS:
                if variant not in rows:
                    own_cells.append("-")
                    continue
                value = rows[variant][what] / (0.01 * stated[label] if own else 1.0)
                most[variant] = max(most.get(variant, (-1.0, "")), (value, label))
                own_cells.append(f"{value:.2g}" if value else "0")
            table.append(" | ".join([f"| {label}", *own_cells]) + " |")
        links.append(keep_rows(out, table, f"invariants_{what.lower()}"))
        for variant, (value, label) in most.items():
            largest[variant].append(f"{value:.2g} ({label})" if value else "0")
    lines += [
        "The table has the largest change of all scenes. The change of the displacement is in percent of the stated "
        "error of the modes or of the reduced model. The change of a force is relative to the largest force of a body. "
        f"Files have the changes of each scene: {', '.join(links)}.",
        "",
        "| form | displacement [% of the stated error] | ARP at the nodes of the skin | mean force |",
        "|---|---|---|---|",
        *(" | ".join(row) + " |" for row in largest.values()),
        "",
    ]
    missing = [f"`{name}`" for name in SCENES if name not in found]
    if missing:
        lines += [f"Not run at their own accuracy: {', '.join(missing)}.", ""]
    apart = max((rows["turned and shifted"]["position"] for rows in found.values()), default=0.0)
    elsewhere = max((rows["mirrored"]["mesh"] for rows in found.values()), default=0.0)
    figures = {"apart_mm": 1e3 * apart, "elsewhere": 100.0 * elsewhere}
    over_text = f"Exceeded limits: {'; '.join(over)}." if over else "No limit is exceeded."
    lines.append(LAST.format(rounding=LIMITS["ARP"], p0=PUSHED["ARP"], over=over_text, **figures).strip())
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
