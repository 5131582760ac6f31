"""Writes docs/bench/field.md and its picture: `palmfield bench field` into this repository.

    python scripts/bench_field.py --peers-python PEERS/bin/python

scripts/peers/setup.py makes PEERS; without it the peers that are not installed are named so.
"""

import argparse
from pathlib import Path

from palmfield.studies.bench.field import main

ROOT = Path(__file__).resolve().parents[1]

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--peers-python", type=Path)
    parser.add_argument("--commit", default="")
    given = parser.parse_args()
    picture = ROOT / "docs" / "images" / "bench_field.png"
    print(main(ROOT / "docs" / "bench" / "field.md", picture, given.peers_python, commit=given.commit))
