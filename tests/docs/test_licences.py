"""docs/licences.md: names everything that a plain install brings, and nothing of it is GPL or proprietary."""

import re
from importlib.metadata import requires
from pathlib import Path

from packaging.requirements import Requirement

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "licences.md").read_text()
PLAIN = PAGE.split("## Extras")[0]


def test_every_dependency_is_named():
    own = {Requirement(text).name.lower() for text in requires("palmfield") or [] if "extra ==" not in text}
    listed = set(re.findall(r"^\| ([a-z0-9-]+) \|", PLAIN, flags=re.MULTILINE))
    assert own <= listed


def test_none_is_gpl_proprietary_or_unknown():
    for line in PLAIN.splitlines():
        if line.startswith("| ") and not line.startswith("| package"):
            licence = line.split("|")[2]
            assert not re.search(r"(?<!L)GPL|General Public|Proprietary|not told", licence), line
