r"""Compare skin solvers with other programs on one slab (`palmfield bench skin` with peers). Takes some minutes.

    python scripts/bench/compare_skin.py --peers-python PEERS/bin/python \
        --out docs/bench/skin.md --picture docs/images/bench_skin.png

scripts/peers/setup.py makes PEERS; without it, the report lists the missing programs.
"""

import importlib.util
import json
import os
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import peers_python

from palmfield.studies.bench import skin
from palmfield.studies.bench.processes import ONE_THREAD, ROOT
from palmfield.studies.bench.skin import PeerSolutions, SkinRow
from palmfield.studies.bench.skin_case import CASE, Case, F_Hz

PEERS = {
    "scikit_fem": ("scikit-fem, quadratic", "skfem", ((4, 2), (6, 3), (8, 4))),
    "warp_fem": ("warp.fem, quadratic", "warp", ((4, 2), (6, 3), (8, 4))),
    "mujoco_flex": ("MuJoCo flex, trilinear", "mujoco", ((4, 2), (8, 3), (12, 4))),
}
"""Properties of each other program: its name here, the required module, cells along a side, and layers."""
ABOUT = (
    f"The other programs solve once at rest and once at {F_Hz:g} Hz, on a quarter of a disc with a radius of "
    f"{1e3 * skin.RADIUS_M:g} mm. MuJoCo's flex settles on a whole disc, with the relaxed moduli. Flex gives no "
    f"result at {F_Hz:g} Hz."
)
COMMAND = "python scripts/bench/compare_skin.py"
PROGRAM = Path(__file__).resolve().parent / "skin_peers.py"


def peer(case: Case, function: str, cells: int, layers: int, python: Path) -> SkinRow:
    """Run another program in its own process under `python`; its second run counts, when everything is compiled."""
    name, module, _ = PEERS[function]
    size = f"{cells} cells, {layers} layers"
    environment = {**os.environ, **ONE_THREAD, "PYTHONPATH": str(ROOT)}
    command: list[str | Path] = [python, PROGRAM, function, str(cells), str(layers)]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False, cwd=ROOT)
    if done.returncode != 0:
        words = (done.stderr.strip().splitlines() or ["no message"])[-1]
        return SkinRow(name, size, missing=f"{words} (needs {module})")
    answer = json.loads(done.stdout.strip().splitlines()[-1])
    still, exact = case.exact()
    moving = None if answer["moving"] is None else abs(complex(*answer["moving"]) / exact - 1.0)
    static = None if answer["static"] is None else abs(answer["static"] / still - 1.0)
    return SkinRow(name, f"{size}, {answer['unknowns']} unknowns", answer["seconds"], static, moving)


def report(python: Path | None = None, **options: Any) -> str:
    """Measure, draw and return the report; options and errors as `palmfield.studies.bench.skin.main`.

    python: interpreter for programs that are missing in this one [default: none]
    Raises PalmfieldError also if the interpreter does not run or lacks NumPy.
    """
    elsewhere = None if python is None else peers_python.interpreter(python)
    jobs = []
    for function, (name, module, meshes) in PEERS.items():
        here = importlib.util.find_spec(module) is not None
        program = Path(sys.executable) if here or elsewhere is None else elsewhere
        jobs += [(name, partial(peer, CASE, function, *mesh, program)) for mesh in meshes]
    command = COMMAND if python is None else f"{COMMAND} --peers-python PATH"
    return skin.main(**options, peers=PeerSolutions(jobs, ABOUT, command))


def main() -> None:
    options = vars(peers_python.parser(__doc__, 3).parse_args())
    python = options.pop("peers_python")
    peers_python.print_report(lambda: report(python, **options))


if __name__ == "__main__":
    main()
