"""Measure the waiting time of a user: demo with empty and full cache, a changed number, a first step.

    python scripts/bench/answer_times.py [--times 5] [--picture docs/bench/answer_times.png]

Each command runs in its own process, with caches of results and of kernels in temporary folders. "Empty" begins with
both caches empty. The rows "another focus", "another frequency" and "another level" begin with the caches that the
command of the demo has left. Prints commit, processor, load of the machine, the time of a fixed kernel (`yardstick`)
before and after, and a table in Markdown: medians of wall time, processor time (user and system) and memory. The wall
times are valid for a load below 0.5 before. Draws the processor time by phase (`palmfield run --profile`).
"""

import argparse
import os
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

from palmfield.studies.bench.processes import yardstick
from palmfield.studies.bench.table import processor

ROOT = Path(__file__).resolve().parents[2]
DEMO = "mjcf/scenes/palm_am200.xml"
PHASE = re.compile(r"^│ (\w[^│]*?) +│ +([\d.]+) ", re.MULTILINE)
TOTAL, NEXT_TABLE, SMALL_S = "all", "┃ arrays", 0.1
"""Last row of the table of phases, heading of the next table, and largest time of phases that are drawn together."""
FIRST_STEP = "import palmfield; palmfield.Simulation('mjcf/scenes/{}.xml').step()"


class Case(NamedTuple):
    """A command and its initial caches: "" for empty ones, else the name of the case whose caches are used.

    words: arguments of `palmfield`, or one string of Python
    """

    words: list[str] | str
    caches: str = ""


def demo(*changes: str) -> list[str]:
    return ["run", DEMO, "--profile", "--out", "{out}", *(word for change in changes for word in ("--set", change))]


CASES = {
    "demo, empty cache": Case(demo()),
    "demo, nothing changed": Case(demo(), "demo, empty cache"),
    "another focus, 5 mm away": Case(demo("stimulus.focus_m=0.004 0.003 0.2"), "demo, empty cache"),
    "another frequency, 160 Hz": Case(demo("stimulus.am_frequency_Hz=160"), "demo, empty cache"),
    "another level, half": Case(demo("stimulus.drive_amplitude=0.5"), "demo, empty cache"),
    "`Simulation(...).run(0.1)`, cached": Case(
        f"import palmfield; palmfield.Simulation('{DEMO}').run(0.1)", "demo, empty cache"
    ),
    "first step, palm_circle, empty": Case(FIRST_STEP.format("palm_circle")),
    "first step, palm_circle, cached": Case(FIRST_STEP.format("palm_circle"), "first step, palm_circle, empty"),
    "first step, stroke_palm, empty": Case(FIRST_STEP.format("stroke_palm")),
    "first step, stroke_palm, cached": Case(FIRST_STEP.format("stroke_palm"), "first step, stroke_palm, empty"),
}


class Run(NamedTuple):
    """Measurements of a process. wall_s, cpu_s: its times; peak_MiB: its memory; phases: processor time by name [s]"""

    wall_s: float
    cpu_s: float
    peak_MiB: float
    phases: dict[str, float]


def run(case: Case, caches: Path, out: Path) -> Run:
    """Run a case with the caches in a folder."""
    env = os.environ | {"PALMFIELD_CACHE": str(caches / "results"), "WARP_CACHE_PATH": str(caches / "kernels")}
    words = ["-c", case.words] if isinstance(case.words, str) else ["-m", "palmfield", *case.words]
    words = [sys.executable, *(word.replace("{out}", str(out)) for word in words)]
    began = time.perf_counter()
    with tempfile.TemporaryFile("w+") as errors:
        child = subprocess.Popen(words, cwd=ROOT, env=env, stdout=subprocess.DEVNULL, stderr=errors)
        _, status, used = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
        wall_s = time.perf_counter() - began
        errors.seek(0)
        output = errors.read()
    if status:
        raise SystemExit(f"{words}\n{output}")
    shutil.rmtree(out, ignore_errors=True)
    rows = PHASE.findall(output.partition(NEXT_TABLE)[0])
    phases = {name.strip(): float(seconds) for name, seconds in rows if name.strip() != TOTAL}
    return Run(wall_s, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024, phases)


def measured(times: int, folder: Path) -> dict[str, list[Run]]:
    """Run all cases in turn, so that a slow minute of the machine affects all of them."""
    runs: dict[str, list[Run]] = {name: [] for name in CASES}
    for number in range(times):
        for name, case in CASES.items():
            own = folder / f"{number} {name}"
            if case.caches:
                shutil.copytree(folder / f"{number} {case.caches}", own)
            runs[name].append(run(case, own, folder / "out"))
            print(f"{number + 1}/{times} {name}: {runs[name][-1].wall_s:.1f} s", file=sys.stderr, flush=True)
        for old in folder.iterdir():
            shutil.rmtree(old, ignore_errors=True)
    return runs


def draw(runs: dict[str, list[Run]], path: Path) -> None:
    """Draw the processor time by phase of the cases that print it, for the run with the median time of each."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    shown = {name: sorted(own, key=lambda one: one.cpu_s)[len(own) // 2] for name, own in runs.items()}
    shown = {name: one for name, one in shown.items() if one.phases}
    largest: dict[str, float] = {}
    for one in shown.values():
        largest |= {name: max(seconds, largest.get(name, 0.0)) for name, seconds in one.phases.items()}
    names = [name for name, seconds in largest.items() if seconds > SMALL_S]
    figure, axes = pyplot.subplots(figsize=(9.0, 3.6), layout="constrained")
    left = [0.0] * len(shown)
    colours = pyplot.get_cmap("tab20")
    for number, phase in enumerate(names):
        widths = [one.phases.get(phase, 0.0) for one in shown.values()]
        axes.barh(list(shown), widths, left=left, label=phase, color=colours(number % 20))
        left = [begin + width for begin, width in zip(left, widths, strict=True)]
    rest = [sum(one.phases.values()) - begin for one, begin in zip(shown.values(), left, strict=True)]
    axes.barh(list(shown), rest, left=left, label="other", color="lightgrey")
    axes.invert_yaxis()
    axes.set_xlabel("processor time [s]")
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize="small", frameon=False)
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=int, default=5)
    parser.add_argument("--picture", type=Path, help="where the bars of phases are drawn")
    options = parser.parse_args()
    before, yard_ms = os.getloadavg()[0], 1e3 * statistics.median(yardstick() for _ in range(5))
    with tempfile.TemporaryDirectory() as folder:
        runs = measured(options.times, Path(folder))
    commit = subprocess.run(["git", "rev-parse", "--short=8", "HEAD"], cwd=ROOT, capture_output=True, text=True).stdout
    print(f"commit {commit.strip()}, {processor()}, {os.cpu_count()} cores, Python {sys.version.split()[0]}")
    after_ms = 1e3 * statistics.median(yardstick() for _ in range(5))
    loads = f"load {before:.1f} before, {os.getloadavg()[0]:.1f} after"
    print(f"yardstick {yard_ms:.1f} ms before, {after_ms:.1f} ms after; {loads}\n")
    print("| what | wall [s] | CPU [s] | memory [MiB] |\n|---|---|---|---|")
    for name, own in runs.items():
        wall, cpu, peak = (statistics.median(getattr(one, field) for one in own) for field in Run._fields[:3])
        print(f"| {name} | {wall:.1f} | {cpu:.1f} | {peak:.0f} |")
    if options.picture is not None:
        draw(runs, options.picture)


if __name__ == "__main__":
    main()
