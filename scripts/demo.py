#!/usr/bin/env python3
"""Run one scene from a bare Python, and print its time and memory."""

import argparse
import os
import shlex
import subprocess
import sys
import time

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))

import _setup

SCENE = _setup.ROOT / "mjcf" / "scenes" / "palm_am200.xml"
OUT = _setup.ROOT / "out" / "demo"


def main() -> int:
    parser = argparse.ArgumentParser(
        description="Make .venv, install palmfield and palmfield-papers in it, and run mjcf/scenes/palm_am200.xml: a "
        "focus on the palm, modulated at 200 Hz. Results go to out/demo.",
        epilog="Anything else is passed on to `palmfield run`, for instance --out FOLDER.",
        allow_abbrev=False,
    )
    _, passed_on = parser.parse_known_args()
    python = _setup.environment()
    # The demo's own folder may be written again; one that the user names is theirs.
    own = not any(argument.split("=")[0] == "--out" for argument in passed_on)
    out = ["--out", OUT, "--overwrite"] if own else []
    command = [python.with_name("palmfield" + python.suffix), "run", SCENE, *out, *passed_on]
    shown = [os.path.relpath(part) if part in (SCENE, OUT) else part for part in command[1:]]
    _setup.say(shlex.join(["palmfield", *shown]))
    began = time.monotonic()
    status, peak_bytes = run_measured(command)
    memory = f", peak memory {peak_bytes / 2**20:.0f} MiB" if peak_bytes else ""
    _setup.say(f"{time.monotonic() - began:.1f} s{memory}")
    return status


def run_measured(command):
    """Run `command`; return its exit status and peak resident memory [bytes], 0 if the system does not report it."""
    child = subprocess.Popen(command)
    if not hasattr(os, "wait4"):
        return child.wait(), 0
    while True:
        try:
            _, ended, usage = os.wait4(child.pid, 0)
            break
        except KeyboardInterrupt:  # the child got it as well and is about to end
            continue
    child.returncode = os.WEXITSTATUS(ended) if os.WIFEXITED(ended) else 128 + os.WTERMSIG(ended)
    unit_bytes = 1 if sys.platform == "darwin" else 1024
    return child.returncode, usage.ru_maxrss * unit_bytes


if __name__ == "__main__":
    sys.exit(main())
