#!/usr/bin/env python3
"""The licences of what palmfield needs, from the metadata of the installed packages.

python scripts/list_licences.py [--write docs/licences.md]

Lists what `pip install palmfield` brings, dependencies of dependencies included, and what each extra asks for.
"""

import argparse
import re
from importlib.metadata import PackageNotFoundError, distribution, requires
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[1]
HEAD = """# Licences of what palmfield needs

palmfield itself is under the Apache License 2.0. The table is made by `python scripts/list_licences.py` from the
metadata of the installed packages; *through* is the package that asks for it, where palmfield does not itself.

| package | licence | through |
|---|---|---|
"""
EXTRAS = """
## Extras

What is installed only when it is asked for by name (`pip install 'palmfield[sweep]'`). `mkl` brings Intel's libraries,
which are free of charge and not open source; no other package here is proprietary.

| extra | packages |
|---|---|
"""


def licence(name: str) -> str:
    """What a package says of its licence: the expression, else its classifiers, else the field's first line."""
    told = distribution(name).metadata
    if expression := told.get("License-Expression"):
        return str(expression)
    kinds = [line.rsplit(" :: ", 1)[1] for line in told.get_all("Classifier") or [] if line.startswith("License :: ")]
    kinds = [kind for kind in kinds if kind != "OSI Approved"]
    if kinds:
        return ", ".join(kinds)
    return str(told.get("License") or "not told").strip().splitlines()[0]


def needed() -> dict[str, str]:
    """Names of all packages that a plain install brings, and of each the one that asks for it, "" for palmfield."""
    found: dict[str, str] = {}
    waiting = [("palmfield", set[str]())]
    while waiting:
        asks, extras = waiting.pop()
        try:
            wanted = requires(asks) or []
        except PackageNotFoundError:
            continue
        for text in wanted:
            need = Requirement(text)
            places = [{"extra": extra} for extra in extras] or [{"extra": ""}]
            name = canonicalize_name(need.name)
            if name in found or (need.marker and not any(need.marker.evaluate(place) for place in places)):
                continue
            found[name] = "" if asks == "palmfield" else asks
            waiting.append((name, set(need.extras)))
    return found


def extras() -> dict[str, list[str]]:
    """What each extra of palmfield asks for, by its name."""
    found: dict[str, list[str]] = {}
    for text in requires("palmfield") or []:
        if extra := re.search(r"extra == ['\"](\w+)['\"]", text):
            found.setdefault(extra[1], []).append(Requirement(text).name)
    return found


def page() -> str:
    rows = [f"| {name} | {licence(name)} | {through} |" for name, through in sorted(needed().items())]
    more = [f"| {name} | {', '.join(sorted(set(packages)))} |" for name, packages in sorted(extras().items())]
    return HEAD + "\n".join(rows) + "\n" + EXTRAS + "\n".join(more) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", type=Path)
    given = parser.parse_args()
    text = page()
    if given.write:
        given.write.write_text(text, encoding="utf-8")
    else:
        print(text)


if __name__ == "__main__":
    main()
