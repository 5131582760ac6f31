"""The repository's environment, for demo.py and test.py. Standard library only: nothing is installed when it runs."""

import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
VENV = ROOT / ".venv"
STAMP = VENV / "palmfield.json"
PYTHON = VENV / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
OLDEST = (3, 11)
LAST_LINES = 15


def environment(extra: str = "") -> Path:
    """Python of an up-to-date `.venv` with palmfield installed editable; makes or refreshes it where needed.

    extra: optional dependencies, "" or "test"
    Exits with a message that says how to mend it when that fails.
    """
    if sys.version_info < OLDEST:
        stop(f"palmfield needs Python {OLDEST[0]}.{OLDEST[1]} or newer; this is {version()}. Run the script with one.")
    # Sparse solves here are many small products: threads of the BLAS only get in each other's way.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    key = fingerprint()
    stamp = read_stamp()
    if stamp.get("key") == key and extra in stamp["extras"] and works(PYTHON):
        return PYTHON
    if stamp.get("key") != key or not works(PYTHON):
        stamp = {"key": key, "extras": []}
        make_venv()
    what = f"palmfield and its {extra} tools" if extra else "palmfield"
    say(f"installing {what} into .venv (1.2 GB of disk; the first time takes minutes)")
    run(
        [
            *installer(),
            "install",
            "--quiet",
            "--disable-pip-version-check",
            "--editable",
            f".[{extra}]" if extra else ".",
        ],
        "is the network up, and does pip reach its package index? Mend that and run this again.",
    )
    stamp["extras"] = sorted({*stamp["extras"], extra, ""})
    STAMP.write_text(json.dumps(stamp))
    return PYTHON


def fingerprint() -> str:
    """What an environment depends on: the project's declarations, the Python that made it, and where the clone lies."""
    digest = hashlib.sha256()
    for name in ("pyproject.toml", "setup.py"):
        digest.update((ROOT / name).read_bytes())
    digest.update(f"{version()} {sys.base_prefix} {ROOT}".encode())
    return digest.hexdigest()


def read_stamp() -> dict:
    try:
        return json.loads(STAMP.read_text())
    except (OSError, ValueError):
        return {}


def works(python: Path) -> bool:
    return python.exists() and subprocess.run([python, "-c", ""], check=False).returncode == 0


def make_venv() -> None:
    """Make `.venv` anew; without its own pip where the system has split that off (Debian's python3-venv)."""
    say(f"making .venv with Python {version()}")
    made = subprocess.run([sys.executable, "-m", "venv", "--clear", VENV], capture_output=True, text=True, check=False)
    if made.returncode == 0:
        return
    if not has_pip(Path(sys.executable)):
        tell(made.stdout + made.stderr)
        major, minor = sys.version_info[:2]
        stop(
            "Python cannot make an environment with pip in it. On Debian or Ubuntu:\n"
            f"  sudo apt-get install python{major}.{minor}-venv\nthen run this again."
        )
    say("ensurepip is missing here: making .venv without pip and installing with this Python's own")
    run([sys.executable, "-m", "venv", "--clear", "--without-pip", VENV], "Is the folder writable, the disk full?")


def has_pip(python: Path) -> bool:
    return subprocess.run([python, "-m", "pip", "--version"], capture_output=True, check=False).returncode == 0


def installer() -> list:
    """Command of a pip that installs into `.venv`."""
    if has_pip(PYTHON):
        return [PYTHON, "-m", "pip"]
    return [sys.executable, "-m", "pip", "--python", PYTHON]


def run(command: list, mend: str) -> None:
    """Run quietly in the repository; on failure show the last lines, how to mend it, and exit with 1."""
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
