#!/usr/bin/env python3
"""Cases with wrong results and no message at commit f6cb3e2, found by readers, and their present results.

python scripts/verification/seen_cases.py [--only PART] [--write docs/bench/seen_cases.md] [--commit HASH]

Each case is run, and its present result in the table is from that run. References have a tenth of the target accuracy,
or less, and use another solver if possible. A test compares each case with independent references.
"""

import argparse
import contextlib
import io
import re
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from foreign_hands import HANDS, NO_HANDS
from small_scene import small_scene_texts

import palmfield
from palmfield.cli.app import main as command
from palmfield.errors import PalmfieldError
from palmfield.hand.reportcard import report_card
from palmfield.planning.scene_plan import warnings
from palmfield.skin import Motion, Sheet, Slab, Spot, preset, solve, static
from palmfield.studies.bench.field import git_commit
from palmfield.studies.bench.table import keep_rows, processor
from palmfield.types import Float

GEL = preset("ecoflex_00-10")
TIMES: Float = 1e-3 * np.arange(1, 41)
AT = [[0.0, 0.0], [0.02, 0.0]]
DEMO, BAR = "mjcf/scenes/palm_am200.xml", "\N{BOX DRAWINGS LIGHT VERTICAL}"
STEADY = {"modulation": "none", "am_quantity": None, "am_frequency_Hz": None, "am_depth": None}


class Case(NamedTuple):
    """A case. part: of the page; what: description; before: result at f6cb3e2; now: runs it and describes the result"""

    part: str
    what: str
    before: str
    now: Callable[[], str]


def percent(value: float) -> str:
    return f"{100 * value:.2g} %"


def disc(side: str, height: float = 0.02) -> Slab:
    return Slab((Sheet(GEL, height),), shape="disc", side=side, radius_m=0.06)


def off(motion: Motion, reference: Motion, field: str = "displacement_m") -> float:
    """Return the true error: relative L2 over the times at the worst point."""
    a, b = getattr(motion, field), getattr(reference, field)
    return float((np.linalg.norm(a - b, axis=(0, 2)) / np.linalg.norm(b, axis=(0, 2))).max())


def stated(motion: Motion, reference: Motion) -> str:
    true = off(motion, reference)
    kept = "covered" if true <= motion.error else "NOT covered"
    return f"`{motion.solver.split(',')[0].split(':')[0]}` states {percent(motion.error)}, true {percent(true)}: {kept}"


# -- numbers ---------------------------------------------------------------------------------------------------------


def sudden_box(accuracy: float) -> str:
    box = Slab((Sheet(GEL, 0.01),), shape="box", side="fixed", size_m=(0.05, 0.05))
    load, times = Spot(0.0103, [0.0], [1.0], law="held"), TIMES[:15]
    reference = solve(box, load, times, AT[:1], solver="spectral_elements", accuracy=0.004, device="cpu")
    solvers = ("auto", "wedges")
    answers = [solve(box, load, times, AT[:1], solver=name, accuracy=accuracy, device="cpu") for name in solvers]
    return "; ".join(stated(answer, reference) for answer in answers)


def wide_spot(width: float) -> str:
    load = Spot(width, [0.0, 2e-3], [0.0, 1.0])
    reference = solve(disc("roller"), load, TIMES, AT, solver="axisymmetric", accuracy=1e-3, device="cpu")
    try:
        solve(disc("roller"), load, TIMES, AT, solver="lateral_waves", device="cpu")
        waves = "lateral_waves answer"
    except PalmfieldError:
        waves = "`lateral_waves` refuses"
    return f"{stated(solve(disc('roller'), load, TIMES, AT, accuracy=0.02, device='cpu'), reference)}; {waves}"


def wide_spot_on_fixed_disc() -> str:
    load = Spot(0.2, [0.0, 2e-3], [0.0, 1.0])
    reference = solve(disc("fixed"), load, TIMES, AT, solver="axisymmetric", accuracy=1e-3, device="cpu")
    return stated(solve(disc("fixed"), load, TIMES, AT, device="cpu"), reference)


def velocity_of_a_motion() -> str:
    load = Spot(0.0103, [0.0, 4e-3], [0.0, 1.0])
    reference = solve(disc("fixed"), load, TIMES, AT, solver="axisymmetric", accuracy=1e-3, device="cpu")
    motion = solve(disc("fixed"), load, TIMES, AT, accuracy=0.05, accuracy_of="velocity", device="cpu")
    true = off(motion, reference, "velocity_m_s")
    return f"`accuracy_of=velocity`: states {percent(motion.velocity_error)}, true {percent(true)}"


def rest_on_a_disc() -> str:
    grid = np.stack(np.meshgrid(*2 * [np.linspace(-0.04, 0.04, 9)]), axis=-1).reshape(-1, 2)
    load = Spot(0.0103, [0.0], [1.0], law="held")
    begin = time.process_time()
    motion = static(disc("fixed"), load, grid, accuracy=0.01)
    took = time.process_time() - begin
    fine = static(disc("fixed"), load, grid, accuracy=5e-4)
    size = np.linalg.norm(fine.displacement_m[0], axis=1)
    true = np.linalg.norm((motion.displacement_m - fine.displacement_m)[0], axis=1) / np.maximum(
        size, 1e-3 * size.max()
    )
    return f"81 points in {took:.1f} s of one core, states {percent(motion.error)}, true {percent(float(true.max()))}"


def late_time_for_rest() -> str:
    elastic = preset("ecoflex_00-10").__class__(**{**vars(GEL), "branches": ()})
    body = Slab((Sheet(elastic, 0.02),), shape="disc", side="fixed", radius_m=0.06)
    return refusal(lambda: solve(body, Spot(0.0103, [0.0], [1.0], law="held"), [5.0], AT[:1], device="cpu"))


# -- physics ---------------------------------------------------------------------------------------------------------


def demo_summary() -> str:
    with tempfile.TemporaryDirectory() as folder:
        rows = table("run", DEMO, "--details", "--set", "skin.accuracy=0.3", "--out", folder, "--overwrite")
    return f"at accuracy 0.3: {rows['peak skin displacement']}; p0 {rows['p0']}"


def am_in_the_plan() -> str:
    return table("plan", DEMO)["modulation"]


def table(*line: str) -> dict[str, str]:
    """Return the table that a command prints: words of the first column, and the rest of each row in one line."""
    output = io.StringIO()
    sys.argv = ["palmfield", *line]
    with contextlib.redirect_stdout(output), contextlib.redirect_stderr(io.StringIO()), contextlib.suppress(SystemExit):
        command()
    rows: dict[str, str] = {}
    name = ""
    for text in output.getvalue().splitlines():
        if text.startswith(BAR):
            first, *others = (cell.strip() for cell in text.strip(BAR).split(BAR))
            name = first or name
            rows[name] = " ".join([rows.get(name, ""), *others]).strip()
    return rows


def body_of_the_plan() -> str:
    with scene() as path:
        text = str(palmfield.plan(path))
    warned = [word for word in ("hand", "finger", "palm") if f" {word}" in text.lower()]
    return f"words about hands in a plan of a disc: {', '.join(warned) if warned else 'none'}"


def hidden_focus() -> str:
    with scene(stimulus=STEADY | {"focus_m": "0 0 0.2"}, skin={"radius_m": 0.01}) as path:
        return warned(path)


# -- inputs ----------------------------------------------------------------------------------------------------------


@contextlib.contextmanager
def scene(old: str = "", new: str = "", **changes: dict[str, object]) -> Iterator[Path]:
    """Return a small scene in its own folder; old, new: a change of its text."""
    with tempfile.TemporaryDirectory() as folder:
        plain, haptic = small_scene_texts(**changes)
        assert old in haptic
        Path(folder, "plain.xml").write_text(plain)
        path = Path(folder, "small.xml")
        path.write_text(haptic.replace(old, new, 1) if old else haptic)
        yield path


def refusal(call: Callable[[], object]) -> str:
    try:
        call()
    except PalmfieldError as error:
        return f"refused: {shortened(str(error))}"
    return "ACCEPTED"


def sensor_off_the_skin() -> str:
    with scene() as path:
        plain, site = path.with_name("plain.xml"), '<site name="centre" size="0.001"/>'
        plain.write_text(plain.read_text().replace(site, site.replace("size", 'pos="0 0 0.02" size')))
        return refusal(lambda: palmfield.Simulation(path).step()).replace(str(path.parent) + "/", "")


def layer_thicker_than_the_body() -> str:
    return refusal(lambda: palmfield.Simulation(DEMO, keys={"skin.depth_m": 0.2}).step())


def two_arrays_at_one_place() -> str:
    second = '<instance name="second"><config key="site" value="array"/></instance>'
    with scene('<plugin plugin="palmfield.array">', f'<plugin plugin="palmfield.array">{second}') as path:
        text = path.read_text().replace(
            '<instance name="stimulus">', '<instance name="stimulus"><config key="arrays" value="array second"/>'
        )
        path.write_text(text)
        return refusal(lambda: palmfield.load(path)).replace(str(path.parent) + "/", "")


def refused_scene(old: str = "", new: str = "", **changes: dict[str, object]) -> str:
    with scene(old, new, **changes) as path:
        text = refusal(lambda: palmfield.load(path))
        return text.replace(str(path.parent) + "/", "")


def warned(path: Path) -> str:
    warnings_now = warnings(path)
    return "warned: " + "; ".join(shortened(text) for text in warnings_now) if warnings_now else "SILENT"


def warned_scene(**changes: dict[str, object]) -> str:
    with scene(**changes) as path:
        return warned(path)


def typed(*line: str) -> str:
    error = io.StringIO()
    sys.argv = ["palmfield", *line]
    with contextlib.redirect_stderr(error), contextlib.redirect_stdout(io.StringIO()):
        try:
            command()
            code = 0
        except SystemExit as stop:
            code = stop.code if isinstance(stop.code, int) else 1
    return f"exit {code}: {shortened(error.getvalue().strip())}"


def shortened(text: str, most: int = 220) -> str:
    line = " ".join(text.split()).replace("|", "/")
    return line if len(line) <= most else line[:most] + " ..."


# -- hands -----------------------------------------------------------------------------------------------------------


def card(file: str) -> str:
    (foreign,) = [one for one in (*HANDS, *NO_HANDS) if one.file == file]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, foreign.file)
        foreign.make(path)
        try:
            found = report_card(path)
        except PalmfieldError as error:
            return f"refused before it is examined: {shortened(str(error)).replace(folder + '/', '')}"
    why = str(found.refusal or "; ".join(found.doubts)).replace(folder + "/", "")
    return f"{found.facts['verdict']}{': ' + shortened(why) if why else ''}"


FOCUS = '<config key="focus_m"'
SILENT = "accepted in silence"
TORN = "accepted; bending a finger tears its skin"
BEFORE = {
    "webxr.glb": TORN, "openxr.glb": TORN, "quads.obj": "the wrist cannot be closed", "crossed.ply": "layers that fold",
    **dict.fromkeys(("bottle.ply", "ring.ply", "fork.ply"), "accepted as a hand"),
}  # fmt: skip
"""Former results for meshes with this property."""
CASES = (
    Case(
        "Numbers",
        "unmodulated focus on a box 50 x 50 x 10 mm, accuracy 0.3",
        "states 1.2 %, true 8.8 %",
        lambda: sudden_box(0.3),
    ),
    Case("Numbers", "the same, accuracy 0.1", "states 1.2 %, true 6.4 %", lambda: sudden_box(0.1)),
    *(
        Case(
            "Numbers",
            f"roller disc R 60, h 20 mm under a spot of {mm} mm",
            f"states 1e-15 to 0.2 %, true {was}",
            lambda mm=mm: wide_spot(1e-3 * mm),
        )
        for mm, was in ((60, "2 %"), (100, "24 %"), (200, "more than 100 %"))
    ),
    Case(
        "Numbers",
        "fixed disc R 60 under a spot of 200 mm, by `auto`",
        "states 0.21 %, true 27 %",
        wide_spot_on_fixed_disc,
    ),
    Case("Numbers", "error of the velocity of a motion", "no number", velocity_of_a_motion),
    Case(
        "Numbers", "static solution at 81 points of a fixed disc", "minutes; states 0.18 %, true 0.36 %", rest_on_a_disc
    ),
    Case(
        "Numbers",
        "a late time instead of a static solution, on a body without damping",
        "an answer that still oscillates",
        late_time_for_rest,
    ),
    Case("Physics", "the demo's summary", "45.6 Pa, 3.54 um +- 2.5 %", demo_summary),
    Case("Physics", "effect of AM of the duty on the ARP, in the plan", "not said", am_in_the_plan),
    Case("Physics", "a plan of a flat disc", "has words about hands", body_of_the_plan),
    Case("Physics", "a focus 80 mm behind a disc of 10 mm", "silent", hidden_focus),
    Case("Inputs", "`modulation` none with am_ keys", SILENT, lambda: warned_scene(stimulus={"modulation": "none"})),
    Case("Inputs", "a key given twice", SILENT, lambda: refused_scene(FOCUS, f'{FOCUS} value="0 0 0.1"/>{FOCUS}')),
    Case("Inputs", "two arrays at one place", SILENT, two_arrays_at_one_place),
    Case("Inputs", "a sensor 20 mm off the skin", SILENT, sensor_off_the_skin),
    Case("Inputs", "a layer thicker than the body", SILENT, layer_thicker_than_the_body),
    Case("Inputs", "a mesh's key with shape disc", SILENT, lambda: refused_scene(skin={"mesh": "hand.obj"})),
    Case("Inputs", "a hand's key with shape disc", SILENT, lambda: refused_scene(skin={"patch_radius_m": 0.02})),
    Case(
        "Inputs", "a near miss of a key", "unknown key", lambda: refused_scene('key="thickness_m"', 'key="thicknes_m"')
    ),
    Case(
        "Inputs",
        "an element of the scene that is not closed",
        "the parser's raw text",
        lambda: refused_scene("</custom>", ""),
    ),
    Case(
        "Inputs",
        "`drive --focus 0 0 150`",
        SILENT,
        lambda: typed(
            *["drive", "--focus", "0", "0", "150", "--board", "sonicsurface", "--record", "none.bin", "--level", "1"]
        ),
    ),
    *(
        Case("Hands", one.habit, BEFORE.get(one.file, "not tried"), lambda file=one.file: card(file))
        for one in (*HANDS, *NO_HANDS)
    ),
)


HEAD = ["| case | before | now |", "|---|---|---|"]
SHORT = ["| case | result |", "|---|---|"]
WHOLE = ("Numbers", "Physics")
"""Parts whose cases are all on the page; of the others it has counts."""


def verdict(now: str) -> str:
    """Return the result of a case without the words of the message."""
    found = re.match(r"refused before it is examined|refused|warned|exit \d+|accepted with doubts", now)
    return found[0] if found else now


def page(rows: list[tuple[Case, str]], commit: str, link: str) -> str:
    """Return Markdown; link: to the rows with whole messages."""
    lines = [
        "# Cases that once failed silently", "",
        "For developers. At commit f6cb3e2 these cases gave wrong results without an error message. This script runs "
        "them again:", "",
        "    python scripts/verification/seen_cases.py --write docs/bench/seen_cases.md", "",
        f'"Covered" means that the stated error is at least the true error. {link} has all cases, the former results '
        f"and all messages (commit {commit}, {processor()}).", "",
    ]  # fmt: skip
    for part in dict.fromkeys(case.part for case, _ in rows):
        lines += [f"## {part}", ""]
        if part not in WHOLE:
            counts = Counter(verdict(now) for case, now in rows if case.part == part)
            lines += [f"Now: {', '.join(f'{what} ({count} cases)' for what, count in counts.items())}.", ""]
            continue
        lines += SHORT
        lines += [f"| {case.what} | {verdict(now)} |" for case, now in rows if case.part == part]
        lines.append("")
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", help="a part of the page: " + ", ".join(dict.fromkeys(case.part for case in CASES)))
    parser.add_argument("--write", type=Path)
    parser.add_argument("--commit")
    arguments = parser.parse_args()
    rows = []
    for case in CASES:
        if arguments.only in (None, case.part):
            rows.append((case, case.now()))
            print(f"{case.what}: {rows[-1][1]}", flush=True)
    if arguments.write is not None:
        link = keep_rows(arguments.write, [*HEAD, *(f"| {case.what} | {case.before} | {now} |" for case, now in rows)])
        arguments.write.write_text(page(rows, arguments.commit or git_commit(), link))
    return 1 if any(word in now for _, now in rows for word in ("NOT covered", "ACCEPTED", "SILENT")) else 0


if __name__ == "__main__":
    sys.exit(main())
