"""Run the scripted scenarios, draw one picture of each, and write docs/scenarios.md.

python scripts/scenarios.py [NAME ...] [--out DIR] [--duration S] [--draw]
"""

import argparse
import json
import subprocess
import time
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
from _scenario_stories import SCENES, SPEEDS_M_S, STORIES, Run, stroke_velocities
from matplotlib.figure import Figure

import palmfield
from palmfield.outputs.store import open_result
from palmfield.outputs.style import save, style

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "scenarios.md"
IMAGES = ROOT / "docs" / "images"
# The stroke lasts as long as its target is stated for.
DURATIONS_S = {"stroke_palm": 0.5}

HEAD = """\
# Scripted scenarios

For authors of scenes with moving hands. `mjcf/scenes/` has eight examples. To run one, type `palmfield run
mjcf/scenes/tap_button.xml --out out/tap_button`. `python scripts/scenarios.py` writes this page; do not edit it.

Each example has a picture, a check of its motion or sound, and its cost. The values are from single runs with
`accuracy` 0.2 (stroke_palm: 0.1) on a shared machine. Most of the error comes from the fixed cut edges of small
patches (15 to 32 mm).

## Writing one

The plugin `palmfield.motion` moves a hand ([keys](keys.md), [motion](motion.md)):

```xml
<include file="plain_articulated.xml"/>
<plugin plugin="palmfield.motion">
  <instance name="motion">
    <config key="hand" value="open_men_p50"/>
    <config key="keyframes" value="../motions/tap_button.toml"/>
  </instance>
</plugin>
```

`hand` names the preset whose joints move. Without this key only the pose of the hand moves. One of the keys
`keyframes`, `trajectory`, `tracking` and `function` gives the motion. Paths are relative to the scene. `follow` is
`servo` (springs, with a slight lag) or `exact`.

A second hand needs another instance of `palmfield.motion` with `body` `PREFIXhand_target` (`two_hands.xml`). The
skin of a second hand needs another instance of `palmfield.skin` (`two_hands_both_feel.xml`). With `body_sound`
`shadows`, bodies with skin and the bodies in key `obstacles` cast shadows. These examples use `shadow_edges`
`rays`, which is faster ([shadows](bench/shadows.md)).

A keyframe file is TOML. It has two or more tables `[[key]]` with rising times:

```toml
[[key]]
time_s = 0.0
position_m = [0.0, 0.0, 0.26]    # hand frame: palmar skin at the centre of the palm
pose = "flat"                    # flat, relaxed, splay, point or pinch; default relaxed

[[key]]
time_s = 0.2
position_m = [0.0, 0.0, 0.19]
turn_deg = [0.0, 20.0, 0.0]      # rotation vector; or quaternion = [w, x, y, z]
joints_deg = { index_mcp_flexion = 30 }    # angles that differ from the pose
```

A pose whose skin intersects itself is refused; the error gives the number of the key.

Keys `frame`, `path_on` and `path_sites` of the stimulus ([keys](keys.md)) make the focus follow the hand. """


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"scenarios: {', '.join(STORIES)} (default: all)")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "scenarios", help="folder of the results")
    parser.add_argument("--duration", type=float, help="simulated time [s] in place of each scene's own")
    parser.add_argument("--draw", action="store_true", help="only draw and write the page from results that are there")
    options = parser.parse_args()
    for name in options.names:
        if name not in STORIES:
            parser.error(f"scenario '{name}' is not known; allowed: {', '.join(STORIES)}")
    for name in options.names or STORIES:
        out = options.out / name
        if not options.draw:
            simulate(name, out, options.duration)
        print(f"{name}: {draw(name, out)}", flush=True)
    write_page(options.out)


def simulate(name: str, out: Path, duration_s: float | None) -> None:
    """Run a scenario and write its results, and facts.json with its cost."""
    processor, wall = time.process_time(), time.perf_counter()
    sim = palmfield.Simulation(SCENES / f"{name}.xml")
    result = palmfield.run(sim, out, duration_s=duration_s or DURATIONS_S.get(name), overwrite=True)
    [skin] = result.summary["skins"]
    facts = {
        "commit": commit(),
        "processor_s": time.process_time() - processor,
        "wall_s": time.perf_counter() - wall,
        "unknowns": skin["dofs"],
        "skin_steps": result.summary["skin_steps"],
        "steps": round(result.summary["simulated_time_s"] / sim.model.opt.timestep),
        "simulated_s": result.summary["simulated_time_s"],
        "solver": skin["solver"],
    }
    if name == "stroke_palm":
        for speed in SPEEDS_M_S:
            np.savez_compressed(out / f"wake_{speed:g}.npz", **stroke_velocities(speed))
    (out / "facts.json").write_text(json.dumps(facts, indent=1) + "\n")


def draw(name: str, out: Path) -> str:
    """Draw the picture of a finished run: the scene at its loudest, and the panels over time. Returns the check."""
    story = STORIES[name]
    wakes = {}
    if name == "stroke_palm":
        wakes = {speed: dict(np.load(out / f"wake_{speed:g}.npz")) for speed in SPEEDS_M_S}
    run = Run(open_result(out), palmfield.Simulation(SCENES / f"{name}.xml"), wakes)
    with style():
        figure = Figure(figsize=(14.0, 6.0), dpi=100, layout="constrained")
        left, right = figure.subfigures(1, 2, width_ratios=(8.0, 6.0), squeeze=False)[0]
        scene = left.add_axes((0.0, 0.0, 1.0, 1.0))
        scene.imshow(matplotlib.image.imread(out / "scene.png"))
        scene.set_axis_off()
        check = story.write(run, list(right.subplots(len(story.panels), 1, height_ratios=story.panels)))
        save(figure, IMAGES / f"scenario_{name}.png", 100)
    facts = json.loads((out / "facts.json").read_text())
    (out / "facts.json").write_text(json.dumps(facts | {"check": check}, indent=1) + "\n")
    return check


def commit() -> str:
    """Return the short hash of the checkout, with a plus if files differ from it."""
    hash_ = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    changed = subprocess.run(["git", "status", "--short"], cwd=ROOT, capture_output=True, text=True, check=True)
    return hash_.stdout.strip() + ("+" if changed.stdout.strip() else "")


def write_page(results: Path) -> None:
    """Write docs/scenarios.md from the facts of all scenarios that have been run."""
    parts = [HEAD]
    for name, story in STORIES.items():
        path = results / name / "facts.json"
        if not path.exists():
            continue
        facts = json.loads(path.read_text())
        summary = json.loads((results / name / "summary.json").read_text())
        parts.append(
            f"## {name}\n\n{story.text}\n\n![{name}](images/scenario_{name}.png)\n\n**Check.** {facts['check']}\n\n"
            f"{1e3 * facts['simulated_s']:.0f} ms, {facts['skin_steps'] - 1} skin steps, {facts['unknowns']} unknowns, "
            f"{facts['solver']}; {facts['processor_s']:.0f} s of processor time; commit {facts['commit']}. "
            f"{error_in_words(summary['skins'][0])}\n"
        )
    PAGE.write_text("\n".join(parts), encoding="utf-8")


def error_in_words(skin: dict[str, Any]) -> str:
    """Describe the error estimate of a run for its largest displacement. skin: its entry in the summary"""
    if "displacement_error_relative" not in skin:
        return f"No error estimate: {skin.get('displacement_error_missing', 'the skin did not move')}."
    error, target = skin["displacement_error_relative"], skin["accuracy_wanted_relative"]
    return (
        f"Error of the displacement {100 * error:.0f} % (target {100 * target:.0f} %): mesh "
        f"{100 * skin['mesh_error_relative']:.0f} %, cut edge {100 * skin['edge_error_relative']:.0f} %."
    )


if __name__ == "__main__":
    main()
