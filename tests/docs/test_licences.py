"""docs/licences.md: names everything that a plain install brings, and nothing of it is GPL or proprietary."""

import re
from importlib.metadata import requires
from pathlib import Path

from packaging.requirements import Requirement

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "licences.md").read_text()
PLAIN, REST = PAGE.split("## What wheels bundle")
BUNDLED, EXTRAS = REST.split("## Extras")
RUN_TIME = "GPL-3.0-or-later WITH GCC-exception-3.1"


def rows(table: str) -> list[list[str]]:
    lines = [line for line in table.splitlines() if line.startswith("| ")]
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines[1:]]


def is_gpl(licence: str) -> bool:
    return bool(re.search(r"(?<![AL])GPL|General Public", licence.replace(RUN_TIME, "")))


def test_every_dependency_is_named():
    own = {Requirement(text).name.lower() for text in requires("palmfield") or [] if "extra ==" not in text}
    assert own <= {row[0] for row in rows(PLAIN)}


def test_every_package_of_an_extra_is_named():
    told = {(row[0], row[1]) for row in rows(EXTRAS)}
    for text in requires("palmfield") or []:
        extra = re.search(r"extra == ['\"](\w+)['\"]", text)
        name = Requirement(text).name
        if extra and name != "palmfield":
            assert (extra[1], name) in told, "write docs/licences.md again: scripts/list_licences.py --write"


def test_none_is_gpl_proprietary_or_unknown():
    for name, licence, _ in rows(PLAIN):
        assert not is_gpl(licence) and not re.search("Proprietary|not told", licence), name
    plain = {row[0] for row in rows(PLAIN)}
    libraries = [row for row in rows(BUNDLED) if row[0] in plain]
    assert {"numpy", "scipy", "usd-core"} <= {row[0] for row in libraries}
    for wheel, library, licence in libraries:
        # Dynamically linked, under the LGPL at most
        assert not is_gpl(licence) and licence, f"{wheel}: {library}"


def test_what_of_the_extra_video_is_gpl_is_said():
    assert {row[1] for row in rows(BUNDLED) if row[0] == "av" and is_gpl(row[2])} >= {"x264", "x265"}
    assert "x264" in EXTRAS and "GPL" in EXTRAS
