"""Measure the processor time to start commands and a scene, and count the modules that they import.

    python scripts/bench/startup.py [--before COMMIT] [--times 5]

A first call of each fills caches of bytecode, meshes and reduced models in temporary folders; all later calls use them.
With --before, the commands also run in a checkout of that commit, alternately. It prints a table in Markdown.
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path

from palmfield.studies.bench.table import processor

ROOT = Path(__file__).resolve().parents[2]
SCENE = "mjcf/scenes/palm_am200.xml"
STEPS = f"import palmfield; palmfield.Simulation('{SCENE}').run(0.002)"
CASES: dict[str, str | list[str]] = {
    "MuJoCo, Warp and SciPy alone": "import mujoco, warp, scipy.sparse, scipy.spatial, scipy.special",
    "`import palmfield`": "import palmfield",
    "`palmfield --help`": ["--help"],
    "`palmfield keys`": ["keys"],
    "`palmfield info`": ["info", SCENE],
    "`palmfield plan`": ["plan", SCENE],
    "`palmfield.Simulation(...).run(0.002)`": STEPS,
    "imports of `palmfield run` before its steps": (
        "import palmfield; palmfield.run\nfrom palmfield.outputs.summary_table import format_summary\n"
        "from palmfield.planning.scene_plan import warnings"
    ),
}
COUNT = """
import atexit, sys
def count():
    own = [m.__file__ for n, m in list(sys.modules.items()) if n.split(".")[0] in ("palmfield", "warp_kernels")]
    own = [file for file in own if file and file.endswith(".py")]
    print(len(own), sum(len(open(file).readlines()) for file in own), file=sys.stderr)
atexit.register(count)
"""


def code_of(case: str | list[str]) -> str:
    if isinstance(case, str):
        return case
    return f"import runpy, sys; sys.argv = {['palmfield', *case]!r}; runpy.run_module('palmfield', run_name='__main__')"


def call(code: str, where: Path, caches: Path, *, caching: bool = True) -> tuple[float, list[str]]:
    """Return the processor seconds of a Python that runs this code in a checkout, and the last words of its output."""
    folder = str(caches / f"{where.name}_kept") if caching else "off"
    env = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    env |= {"PYTHONPYCACHEPREFIX": str(caches / f"{where.name}_bytecode"), "PALMFIELD_CACHE": folder}
    with tempfile.TemporaryFile("w+") as errors:
        words = [sys.executable, "-c", code]
        python = subprocess.Popen(words, cwd=where, env=env, stdout=subprocess.DEVNULL, stderr=errors)
        _, status, used = os.wait4(python.pid, 0)
        python.returncode = os.waitstatus_to_exitcode(status)
        errors.seek(0)
        output = errors.read()
    if status:
        raise SystemExit(f"{code}\n{output}")
    return used.ru_utime + used.ru_stime, output.split()[-2:]


def compare(checkouts: list[Path], caches: Path, times: int) -> None:
    """Print a row for each case: medians of processor seconds, modules and lines, of each checkout."""

    def row(name: str, *numbers: Iterable[str]) -> None:
        print(f"| {name} | {' | '.join(' -> '.join(cell) for cell in numbers)} |", flush=True)

    print("| work | CPU time [s] | imported modules | imported lines |\n|---|---|---|---|")
    for name, case in CASES.items():
        code = code_of(case)
        seconds: dict[Path, list[float]] = {where: [] for where in checkouts}
        for turn in range(times + 1):
            for where, own in seconds.items():
                spent, _ = call(code, where, caches)
                own += [spent] if turn else []  # the first call fills the caches
        counted = [call(COUNT + code, where, caches)[1] for where in checkouts]
        row(name, (f"{statistics.median(own):.2f}" for own in seconds.values()), *zip(*counted, strict=True))
    counted = [call(COUNT + STEPS, where, caches, caching=False)[1] for where in checkouts]
    steps = "`palmfield.Simulation(...).run(0.002)` with the cache switched off"
    row(steps, ("" for _ in checkouts[:1]), *zip(*counted, strict=True))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--before", help="commit to compare with")
    parser.add_argument("--times", type=int, default=5)
    args = parser.parse_args()
    print(f"{processor()}, {os.cpu_count()} cores, Python {sys.version.split()[0]}\n")
    with tempfile.TemporaryDirectory() as folder:
        caches = Path(folder)
        if args.before is None:
            return compare([ROOT], caches, args.times)
        before, git = caches / "before", ["git", "-C", str(ROOT), "worktree"]
        subprocess.run([*git, "add", "--quiet", "--detach", str(before), args.before], check=True)
        try:
            compare([before, ROOT], caches, args.times)
        finally:
            subprocess.run([*git, "remove", "--force", str(before)], check=True)


if __name__ == "__main__":
    main()
