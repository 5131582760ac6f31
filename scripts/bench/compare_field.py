r"""Compare the field of palmfield with other programs in speed and error: `palmfield bench field` with peers.

    python scripts/bench/compare_field.py --peers-python PEERS/bin/python \
        --out docs/bench/field.md --picture docs/images/bench_field.png

scripts/peers/setup.py makes PEERS; without it, the report lists the missing programs.
"""

import sys
from pathlib import Path
from typing import Any

import field_peers
import peers_python

from palmfield.studies.bench import field
from palmfield.studies.bench.processes import PeerMethods

COMMAND = "python scripts/bench/compare_field.py"


def report(python: Path | None = None, **options: Any) -> str:
    """Measure, draw and return the report; options and errors as `palmfield.studies.bench.field.main`.

    python: interpreter with the programs [default: this one]
    Raises PalmfieldError also if the interpreter does not run or lacks NumPy.
    """
    peers = PeerMethods(
        field_peers.METHODS,
        field_peers.__name__,
        Path(__file__).resolve().parent,
        Path(sys.executable) if python is None else peers_python.interpreter(python),
        COMMAND if python is None else f"{COMMAND} --peers-python PATH",
    )
    return field.main(**options, peers=peers)


def main() -> None:
    parser = peers_python.parser(__doc__, field.RUNS)
    parser.add_argument("--points", type=int, default=field.POINTS, help="roughly how many points a range has")
    options = vars(parser.parse_args())
    python = options.pop("peers_python")
    peers_python.print_report(lambda: report(python, **options))


if __name__ == "__main__":
    main()
