"""Measure the time of a simulated millisecond of recorded runs: written step by step, and in blocks of steps.

    python scripts/bench/recorded_run.py [SCENE ...] [--steps 100] [--times 9] [--before COMMIT] [--device D]

Results stay in memory. Both ways alternate in one process, from reset to the selected number of steps. With --before, a
second process alternately runs that commit. Prints a table in Markdown: medians of wall time and processor time, and
the median of the ratios of neighbouring runs.
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

from palmfield.session.recorder import TOGETHER
from palmfield.studies.bench.table import processor

ROOT = Path(__file__).resolve().parents[2]
SCENES = ("palm_circle", "phantom_stm70", "palm_am200", "stroke_palm", "approach_withdraw")
WORKER = """
import sys, time
from palmfield.outputs.store import MemoryStore
from palmfield.session.recorded_run import initial_block, recorder_of, result_attributes
from palmfield.session.simulation import Simulation
sim = Simulation(f"mjcf/scenes/{sys.argv[1]}.xml", device=sys.argv[2] or None)
for line in sys.stdin:
    steps, *together = map(int, line.split())
    sim.reset()
    recorder = recorder_of(sim, MemoryStore(initial_block(sim), result_attributes(sim)), *together)
    recorder.start()
    wall, processor = time.perf_counter(), time.process_time()
    for _ in range(steps):
        sim.step()
        recorder.step()
    recorder.stop()
    ms = 1e3 * steps * sim.model.opt.timestep
    print((time.perf_counter() - wall) * 1e3 / ms, (time.process_time() - processor) * 1e3 / ms, flush=True)
"""


class Runs:
    """A process that repeatedly runs a scene of a checkout."""

    def __init__(self, where: Path, scene: str, device: str):
        words = [sys.executable, "-c", WORKER, scene, device]
        self._python = subprocess.Popen(words, cwd=where, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def run(self, *numbers: int) -> tuple[float, float]:
        """Return wall and processor time [ms] per simulated ms, the number of steps, and that of steps in a block."""
        stdin, stdout = self._python.stdin, self._python.stdout
        assert stdin is not None and stdout is not None
        print(*numbers, file=stdin, flush=True)
        wall, spent = map(float, stdout.readline().split())
        return wall, spent


def compare(scene: str, checkouts: list[Path], device: str, steps: int, times: int) -> None:
    """Print the row of a scene."""
    processes = [Runs(where, scene, device) for where in checkouts]
    ways = [(process, (steps,)) for process in processes[1:]]
    ways += [(processes[0], (steps, 1)), (processes[0], (steps, TOGETHER))]
    # The first runs make what later ones find in caches
    rounds = [[process.run(*numbers) for process, numbers in ways] for _ in range(times + 1)][1:]
    cells = [scene]
    for number in range(2):
        columns = list(zip(*[[run[number] for run in one] for one in rounds], strict=True))
        cells += [f"{statistics.median(column):.2f}" for column in columns]
        for column in columns[:-1]:
            ratios = [after / before for before, after in zip(column, columns[-1], strict=True)]
            cells.append(f"{statistics.median(ratios):.2f}")
    print(f"| {' | '.join(cells)} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", default=SCENES)
    parser.add_argument("--before", help="commit to compare with")
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--times", type=int, default=9)
    parser.add_argument("--device", default="", help="where the sound is computed, for example cuda:0")
    args = parser.parse_args()
    ways = [*([args.before] if args.before else []), "step by step", "blocks"]
    heads = [f"{kind}: {way}" for kind in ("wall [ms]", "CPU [ms]") for way in (*ways, *(f"/ {w}" for w in ways[:-1]))]
    print(f"{processor()}, {os.cpu_count()} cores\n\n| scene | {' | '.join(heads)} |\n|{'---|' * (1 + len(heads))}")
    if args.before is None:
        for scene in args.scenes:
            compare(scene, [ROOT], args.device, args.steps, args.times)
        return
    with tempfile.TemporaryDirectory() as folder:
        before, git = Path(folder) / "before", ["git", "-C", str(ROOT), "worktree"]
        subprocess.run([*git, "add", "--quiet", "--detach", str(before), args.before], check=True)
        try:
            for scene in args.scenes:
                compare(scene, [ROOT, before], args.device, args.steps, args.times)
        finally:
            subprocess.run([*git, "remove", "--force", str(before)], check=True)


if __name__ == "__main__":
    main()
