"""Gives malformed inputs to palmfield in this process, which may die of one: `fuzz.run_cases` starts another then.

python fuzz_worker.py CASES.pickle FIRST FOLDER prints a line of JSON before and after each case.
"""

import json
import pickle
import sys
import time
import traceback
from pathlib import Path

from fuzz_cases import Case

import palmfield
from palmfield.config import CONFIGS, parse
from palmfield.errors import PalmfieldError
from palmfield.hand.meshfile import load_mesh


def given(case: Case, folder: Path) -> None:
    """Open what a case says as a user's scene would. Raises what palmfield raises."""
    folder.mkdir(parents=True)
    for name, data in case.files.items():
        (folder / name).write_bytes(data)
    if case.kind == "scene":
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
        outcome, said = "accepted", ""
        try:
            given(cases[number], Path(sys.argv[3]) / str(number))
        except PalmfieldError as error:
            outcome, said = "refused", str(error)
        except BaseException as error:
            outcome, said = "traceback", "".join(traceback.format_exception(error))
        seconds = time.perf_counter() - start
        print(json.dumps({"number": number, "outcome": outcome, "said": said, "seconds": seconds}), flush=True)


if __name__ == "__main__":
    main()
