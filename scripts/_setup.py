"""Make the repository's environments, for demo.py and test.py. It uses the standard library only."""

import hashlib
import json
import os
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
VENV, LOWEST_VENV = ROOT / ".venv", ROOT / ".venv-lowest"
PAPERS = "papers"
"""Folder of the second distribution, palmfield-papers."""
OLDEST = (3, 11)
LAST_LINES = 15
LOWEST = re.compile(r"([A-Za-z0-9._-]+)\s*>=\s*([0-9][0-9A-Za-z.]*)\s*(,|$)")


def environment(extra: str = "", venv: Path = VENV) -> Path:
    """Return the Python of an up-to-date environment with both distributions installed as editable.

    The environment is made or refreshed if needed.
    extra: optional dependencies, "" or "test"
    venv: VENV, or LOWEST_VENV, in which each dependency of palmfield has the lowest version that pyproject.toml allows
    If that fails, the process exits with a message that describes the remedy.
    """
    if sys.version_info < OLDEST:
        stop(f"palmfield needs Python {OLDEST[0]}.{OLDEST[1]} or newer; this is {version()}. Run the script with one.")
    # Sparse solves here are many small products: threads of the BLAS only get in each other's way.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    key = fingerprint()
    stamp = read_stamp(venv)
    python = python_of(venv)
    if stamp.get("key") == key and extra in stamp["extras"] and works(python):
        return python
    if stamp.get("key") != key or not works(python):
        stamp = {"key": key, "extras": []}
        make_venv(venv)
    what = f"palmfield, palmfield-papers and {extra} tools" if extra else "palmfield and palmfield-papers"
    say(f"installing {what} into {venv.name} (1.2 GB of disk; the first time takes minutes)")
    mend = "is the network up, and does pip reach its package index? Mend that and run this again."
    options = []
    if venv == LOWEST_VENV:
        pins = venv / "lowest.txt"
        pins.write_text("\n".join(lowest()) + "\n")
        options = ["--constraint", pins]
        mend += "\nOr does a lowest version in pyproject.toml not exist, or not go with the others?"
    run(
        [
            *installer(python),
            "install",
            "--quiet",
            "--disable-pip-version-check",
            "--no-compile",  # Python compiles what it imports, when it does
            *options,
            "--editable",
            f".[{extra}]" if extra else ".",
            "--editable",
            f"./{PAPERS}",
        ],
        mend,
    )
    stamp["extras"] = sorted({*stamp["extras"], extra, ""})
    stamp_of(venv).write_text(json.dumps(stamp))
    return python


def lowest() -> list[str]:
    """Return each dependency of palmfield as pip's `name==version`, at the lowest version in pyproject.toml."""
    import tomllib

    dependencies = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    pins = []
    for dependency in dependencies:
        found = LOWEST.match(dependency)
        if found is None:
            stop(f"pyproject.toml: dependency '{dependency}' has no lowest version; write it as name>=version")
        pins.append(f"{found[1]}=={found[2]}")
    return pins


def stamp_of(venv: Path) -> Path:
    return venv / "palmfield.json"


def python_of(venv: Path) -> Path:
    return venv / ("Scripts/python.exe" if os.name == "nt" else "bin/python")


def fingerprint() -> str:
    """Return the inputs of an environment: the project's declarations, the Python that made it, the clone's path."""
    digest = hashlib.sha256()
    for name in ("pyproject.toml", "setup.py", f"{PAPERS}/pyproject.toml"):
        digest.update((ROOT / name).read_bytes())
    digest.update(f"{version()} {sys.base_prefix} {ROOT}".encode())
    return digest.hexdigest()


def read_stamp(venv: Path) -> dict:
    try:
        return json.loads(stamp_of(venv).read_text())
    except (OSError, ValueError):
        return {}


def works(python: Path) -> bool:
    return python.exists() and subprocess.run([python, "-c", ""], check=False).returncode == 0


def make_venv(venv: Path) -> None:
    """Make an environment anew, without its own pip on systems without ensurepip (Debian without python3-venv)."""
    say(f"making {venv.name} with Python {version()}")
    made = subprocess.run([sys.executable, "-m", "venv", "--clear", venv], capture_output=True, text=True, check=False)
    if made.returncode == 0:
        return
    if not has_pip(Path(sys.executable)):
        tell(made.stdout + made.stderr)
        major, minor = sys.version_info[:2]
        stop(
            "Python cannot make an environment with pip in it. On Debian or Ubuntu:\n"
            f"  sudo apt-get install python{major}.{minor}-venv\nthen run this again."
        )
    say(f"ensurepip is missing here: making {venv.name} without pip and installing with this Python's own")
    run([sys.executable, "-m", "venv", "--clear", "--without-pip", venv], "Is the folder writable, the disk full?")


def has_pip(python: Path) -> bool:
    return subprocess.run([python, "-m", "pip", "--version"], capture_output=True, check=False).returncode == 0


def installer(python: Path) -> list:
    """Return the command of a pip that installs into the environment of `python`."""
    if has_pip(python):
        return [python, "-m", "pip"]
    return [sys.executable, "-m", "pip", "--python", python]


def run(command: list, mend: str) -> None:
    """Run a command quietly in the repository.

    On failure it shows the last lines and the remedy, and exits with status 1.
    """
    done = subprocess.run(
        command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace", check=False
    )
    if done.returncode != 0:
        tell(done.stdout)
        stop(f"this failed: {' '.join(str(part) for part in command)}\n{mend}")


def version() -> str:
    return ".".join(str(part) for part in sys.version_info[:3])


def say(line: str) -> None:
    print(f"palmfield: {line}", flush=True)


def tell(output: str) -> None:
    print("\n".join(output.strip().splitlines()[-LAST_LINES:]), file=sys.stderr)


def stop(message: str) -> None:
    print(f"palmfield: {message}", file=sys.stderr)
    sys.exit(1)
