"""Make an environment with the programs that palmfield's field and skin are compared with.

    python3 scripts/peers/setup.py --dir ~/.cache/palmfield-peers

The script uses the standard library only. These programs need older libraries than palmfield, hence their own
environment. It prints the path of the interpreter for `scripts/bench/compare_field.py --peers-python PATH`, and for
`compare_skin.py`.
"""

import argparse
import subprocess
import sys
import venv
from pathlib import Path

PACKAGES = (
    "numpy>=2.0",
    "scipy<1.17",  # levitate 3.0 uses sph_harm, which later versions have no more
    "levitate==3.0.0",
    "autd3-emulator==0.12.0",
    "autd3-pattern==0.12.0",
    "numba>=0.60",
    "scikit-fem>=12",
    "pypardiso>=0.4",  # a hundred times as quick as SuperLU on solids of quadratic hexahedra
    "threadpoolctl",
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dir", type=Path, required=True, help="folder of the environment; 600 MB of disk")
    folder = parser.parse_args().dir.expanduser().resolve()
    python = folder / "bin" / "python"
    if not python.exists():
        venv.create(folder, with_pip=True)
    done = subprocess.run([python, "-m", "pip", "install", "--quiet", *PACKAGES], check=False)
    if done.returncode != 0:
        sys.exit("pip could not install the peers; its message stands above. Is the network up?")
    print(python)


if __name__ == "__main__":
    main()
