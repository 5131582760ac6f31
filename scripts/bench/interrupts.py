"""Measure the time from Ctrl-C to the end of `palmfield run` and `palmfield prepare`, and the files left.

    python scripts/bench/interrupts.py [--scenes palm_am200 stroke_palm] [--caches empty full] [--moments compile ...]

Each case runs a command in its own process until it begins a phase (`palmfield.phases`), waits for a short time, and
sends SIGINT. The table has the time to the end of the process, its exit code, files that cannot be read under their
final names (results, pictures, USD, entries of the cache, kernels), and whether the partial results can be read.
"empty" begins without results in the cache, at moment `compile` also without kernels; "full" begins with the cache of a
complete run. Files with temporary names (*.part, which palmfield removes later, and Warp's folders) are not counted.
"""

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import zipfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from palmfield.studies.bench.table import processor

ROOT = Path(__file__).resolve().parents[2]
WRAPPED = """
import os, sys, threading
from palmfield import phases
from palmfield.profile import Profile

class Marker(Profile):
    def begin(self, name):
        os.write({fd}, (name + chr(10)).encode())
        super().begin(name)

phases.running.append(Marker())
from palmfield.cli.app import start
sys.argv[0] = "palmfield"
start()
"""


class Moment(NamedTuple):
    """Time of the SIGINT. phase: awaited phase, "" for the start of the process; SIGINT follows `after_s` [s] later.

    words: further arguments of the command; command: of palmfield
    """

    phase: str
    after_s: float
    words: tuple[str, ...] = ()
    command: str = "run"


MODAL = ("--set", "skin.solver=modal")
MOMENTS = {
    "start": Moment("", 0.1),
    "imports": Moment("imports", 0.25),
    "compile": Moment("kernels", 0.4),
    "mesh": Moment("patch", 0.05),
    "force samples": Moment("force samples", 0.2),
    "matrices": Moment("matrices", 0.1),
    "factor": Moment("factors", 0.1),
    "reduced model": Moment("small model", 1.0),
    "modes, begin": Moment("modes", 2.0, MODAL, "prepare"),
    "modes, later": Moment("modes", 12.0, MODAL, "prepare"),
    "steps": Moment("stepping", 0.03),
    "estimate": Moment("error estimate", 0.2),
    "result file": Moment("result file", 0.02),
    "pictures, begin": Moment("second process", 0.1),
    "pictures and USD": Moment("second process", 0.6),
}


class Ended(NamedTuple):
    """End of a case. seconds: from SIGINT to the end [s], None if the process ended earlier"""

    seconds: float | None
    code: int
    half: list[str]
    partial: str
    said: str


def case(scene: str, moment: Moment, caches: Path, folder: Path) -> Ended:
    """Run a command with the caches in a folder, which it changes, and interrupt it."""
    out = folder / "out"
    read, write = os.pipe()
    words = [moment.command, f"mjcf/scenes/{scene}.xml", *moment.words]
    words += ["--out", str(out)] if moment.command == "run" else []
    env = os.environ | {"PALMFIELD_CACHE": str(caches / "results"), "WARP_CACHE_PATH": str(caches / "kernels")}
    with tempfile.TemporaryFile("w+") as errors:
        child = subprocess.Popen(
            [sys.executable, "-c", WRAPPED.format(fd=write), *words],
            cwd=ROOT, env=env, stdout=subprocess.DEVNULL, stderr=errors, pass_fds=[write],
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        )  # fmt: skip
        os.close(write)
        with os.fdopen(read) as marks:
            reached = not moment.phase or any(line.rstrip("\n") == moment.phase for line in marks)
            seconds = None
            if reached:
                time.sleep(moment.after_s)
            if reached and child.poll() is None:
                began = time.perf_counter()
                child.send_signal(signal.SIGINT)
                child.wait()
                seconds = time.perf_counter() - began
            child.wait()
        errors.seek(0)
        lines = errors.read().strip().splitlines()
    half = unreadable(out, caches)
    return Ended(seconds, child.returncode, half, partial_of(out), lines[-1] if lines else "")


def unreadable(out: Path, caches: Path) -> list[str]:
    """Return the files with final names that cannot be read."""
    readers = {".npz": _npz, ".json": _json, ".png": _png, ".nc": _nc, ".usdc": _usd, ".o": _elf}
    found = [path for place in (out, caches) if place.is_dir() for path in sorted(place.rglob("*"))]
    bad = []
    for path in found:
        temporary = any(part.endswith(".part") or part.startswith(("p_", ".")) for part in path.parts[-3:])
        reader = readers.get(path.suffix)
        if reader is None or temporary or not path.is_file():
            continue
        try:
            reader(path)
        except Exception as error:
            bad.append(f"{path.name}: {type(error).__name__}")
    return bad


def _npz(path: Path) -> None:
    with zipfile.ZipFile(path) as archive:
        if archive.testzip() is not None:
            raise ValueError(path)


def _json(path: Path) -> None:
    json.loads(path.read_text())


def _png(path: Path) -> None:
    from matplotlib import image

    image.imread(path)


def _nc(path: Path) -> None:
    from palmfield.outputs.store import open_result

    with open_result(path) as tree:
        for node in tree.subtree:
            for variable in node.data_vars.values():
                np.asarray(variable)


def _usd(path: Path) -> None:
    from pxr import Usd

    stage = Usd.Stage.Open(str(path))
    if len(list(stage.Traverse())) < 3:
        raise ValueError(path)


def _elf(path: Path) -> None:
    """Check that an object file is as long as its section table states."""
    data = path.read_bytes()
    sections, size, count = (int.from_bytes(data[at : at + n], "little") for at, n in ((40, 8), (58, 2), (60, 2)))
    if data[:4] != b"\x7fELF" or len(data) < sections + size * count:
        raise ValueError(path)


def partial_of(out: Path) -> str:
    """Return whether the results in a folder can be read, and their number of steps, in words."""
    if not out.is_dir():
        return "no folder"
    if (out / ".partial").is_dir() and not (out / "result.nc").exists():
        import palmfield

        palmfield.recover(out)
    if not (out / "result.nc").exists():
        return "no result"
    from palmfield.outputs.store import open_result

    with open_result(out / "result.nc") as tree:
        kind = "whole" if tree.attrs["complete"] else "partial"
        return f"{kind}, {len(tree['time'])} times"


def filled(scene: str, folder: Path) -> None:
    """Run a scene once, so that a folder contains its results and kernels."""
    env = os.environ | {"PALMFIELD_CACHE": str(folder / "results"), "WARP_CACHE_PATH": str(folder / "kernels")}
    words = ["run", f"mjcf/scenes/{scene}.xml", "--out", str(folder / "out")]
    subprocess.run([sys.executable, "-m", "palmfield", *words], cwd=ROOT, env=env, capture_output=True, check=True)
    shutil.rmtree(folder / "out")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", nargs="+", default=["palm_am200", "stroke_palm"])
    parser.add_argument("--caches", nargs="+", default=["empty", "full"], choices=["empty", "full"])
    parser.add_argument("--moments", nargs="+", default=list(MOMENTS), choices=list(MOMENTS))
    parser.add_argument("--kept", type=Path, help="folder for full caches that further calls of this script use")
    options = parser.parse_args()
    print(f"{processor()}, load {os.getloadavg()[0]:.1f}\n")
    print("| scene | cache | moment | end [s] | code | unreadable files | results |")
    print("|---|---|---|---|---|---|---|", flush=True)
    with tempfile.TemporaryDirectory() as made:
        for scene in options.scenes:
            full = (options.kept or Path(made)) / scene
            if not full.is_dir():
                filled(scene, full)
            for cache in options.caches:
                for name in options.moments:
                    with tempfile.TemporaryDirectory() as folder:
                        own = Path(folder) / "caches"
                        if cache == "full":
                            shutil.copytree(full, own)
                        elif name != "compile":
                            shutil.copytree(full / "kernels", own / "kernels")
                        end = case(scene, MOMENTS[name], own, Path(folder))
                    took = "not reached" if end.seconds is None else f"{end.seconds:.2f}"
                    cells = took, end.code, "; ".join(end.half) or "none", end.partial
                    print(f"| {scene} | {cache} | {name} | " + " | ".join(map(str, cells)) + " |", flush=True)
                    if end.code not in (0, 130):
                        print(end.said, file=sys.stderr)


if __name__ == "__main__":
    main()
