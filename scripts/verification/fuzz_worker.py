"""Load malformed inputs in this process, which may crash; `fuzz.run_cases` then starts another one.

python fuzz_worker.py CASES.pickle FIRST FOLDER prints a line of JSON before and after each case.
"""

import json
import pickle
import sys
import time
import traceback
import warnings
from pathlib import Path

import numpy as np
from fuzz_cases import Case

import palmfield
from palmfield.config import CONFIGS, parse
from palmfield.errors import PalmfieldError
from palmfield.hand.meshfile import load_mesh

STEPS, AT_MOST_S = 3, 15.0
"""Number of steps of an accepted scene, and largest planned time of a run for which it is stepped [s]."""


def planned_and_stepped(path: Path) -> None:
    """Plan a scene, and step it if that is quick: no NumPy warning and no NaN is allowed."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        plan = palmfield.plan(path)
        json.dumps(plan.as_dict(), allow_nan=False)
        str(plan)
        if plan.seconds > AT_MOST_S:
            return
        sim = palmfield.Simulation(path)
        for _ in range(STEPS):
            sim.step()
        for name in sim.skins:
            assert np.isfinite(sim.skin(name).normal_displacement).all(), f"skin {name} is not finite"
        assert np.isfinite(sim.data.sensordata).all(), f"sensors are {sim.data.sensordata}"


def load_case(case: Case, folder: Path) -> None:
    """Open a case as a user's scene. Raises the errors of palmfield."""
    folder.mkdir(parents=True)
    for name, data in case.files.items():
        (folder / name).write_bytes(data)
    if case.kind == "tree":
        planned_and_stepped(folder / "scene.xml")
    elif case.kind == "scene":
        palmfield.load(folder / "scene.xml")
    elif case.kind == "mesh":
        (name,) = case.files
        load_mesh(folder / name, "m")
    else:
        config = next(config for config in CONFIGS if config.plugin == case.plugin)
        parse(config, case.values, f"plugin '{case.plugin}' instance 'it'")


def main() -> None:
    cases: list[Case] = pickle.loads(Path(sys.argv[1]).read_bytes())
    for number in range(int(sys.argv[2]), len(cases)):
        print(json.dumps({"number": number, "outcome": "began"}), flush=True)
        start = time.perf_counter()
        outcome, message = "accepted", ""
        try:
            load_case(cases[number], Path(sys.argv[3]) / str(number))
        except PalmfieldError as error:
            outcome, message = "refused", str(error)
        except BaseException as error:
            outcome, message = "traceback", "".join(traceback.format_exception(error))
        seconds = time.perf_counter() - start
        print(json.dumps({"number": number, "outcome": outcome, "said": message, "seconds": seconds}), flush=True)


if __name__ == "__main__":
    main()
